/** The notice over a picture that is not live. */
import type { ViewStats } from "../view";
import { span } from "./format";
import type { FleetRow } from "./wire";

type Told = Pick<ViewStats, "connection" | "problem" | "silent_s" | "stale">;
type Row = Pick<FleetRow, "alive" | "ended">;

/** The problem in a few words, and the same with its duration. Empty if there is no problem.
 *
 * rows: all streams, null while they are asked for;  row: the chosen one, null if it is not among them */
export function noticeOf(
  told: Told | null,
  key: string | null,
  rows: readonly unknown[] | null,
  row: Row | null,
): [short: string, long: string] {
  const said = withoutPicture(told, key, rows, row);
  if (said !== null) return [said, said];
  if (!told?.stale || told.silent_s === null) return ["", ""];
  const why = reasonOf(told, row);
  const short = why ? `The picture is old: ${why}.` : "The picture is old.";
  return [short, `last frame ${span(told.silent_s)} ago${why ? ` · ${why}` : ""}`];
}

/** Why there is no picture; null if there is one. */
function withoutPicture(
  told: Told | null,
  key: string | null,
  rows: readonly unknown[] | null,
  row: Row | null,
): string | null {
  if (key === null) return rows?.length === 0 ? "There is no vehicle yet." : "No stream is chosen.";
  if (told === null) return null;
  if (told.connection === "unable") return told.problem;
  if (told.connection === "refused") {
    return `The server does not show this stream: ${told.problem ?? "it gave no reason"}`;
  }
  if (told.silent_s !== null) return null;
  if (told.connection === "waiting") {
    if (rows !== null && row === null) return `The server does not know ${key}. It appears here as soon as it starts.`;
    return `No connection${told.problem ? `: ${told.problem}` : ""}. Trying again …`;
  }
  if (row?.alive === false) {
    return row.ended
      ? "This stream has ended."
      : "The vehicle is not connected. Its picture appears as soon as it returns.";
  }
  return "Waiting for the first frame …";
}

function reasonOf(told: Told, row: Row | null): string {
  if (told.connection !== "open") return "no connection";
  if (row?.ended) return "it has ended";
  return row?.alive === false ? "the vehicle is not connected" : "";
}
