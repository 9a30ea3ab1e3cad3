/** What stands below a picture that is saved: without it nobody could tell later what it shows, and how true it is. */
import type { ViewStats } from "../view";
import { count } from "./format";

type Told = Pick<ViewStats, "points" | "madeUp" | "frameIndex" | "inBox" | "allPoints" | "streams">;

/** notice: why the picture is not live; empty if it is. stampMs: of the frame, milliseconds since 1970 */
export function captionOf(stream: string, told: Told, codec: string | null, stampMs: number, notice: string): string {
  const [own, ...others] = told.streams;
  const parts = [stream];
  if (notice) parts.push(notice);
  if (own?.note) parts.push(own.note);
  parts.push(new Date(stampMs).toISOString().replace("T", " "), `frame ${told.frameIndex ?? "–"}`);
  if (codec) parts.push(codec);
  parts.push(`${count(told.points)} points measured`);
  if (told.madeUp > 0) parts.push(`${count(told.madeUp)} filled in`);
  for (const { name, points, note } of others) {
    parts.push(`with ${name}: ${count(points)} points${note ? `, ${note}` : ""}`);
  }
  if (told.inBox !== null) parts.push(`box: ${count(told.inBox)} of ${count(told.allPoints)} points`);
  return parts.join(" · ");
}

/** The name of the file of a saved picture or clip. */
export function pictureName(stream: string, frameIndex: number | null, ending = "png"): string {
  return `${stream.replace("/", "_")}_${frameIndex ?? 0}.${ending}`;
}
