import { count, kbps, ms, span } from "../model/format";
import { keyOf } from "../model/minute";
import type { FleetRow } from "../model/wire";
import { choose, chosen, minutes, rows } from "../state";
import { Spark } from "./spark";

/** All streams, one row each. */
export function FleetList() {
  const all = rows.value;
  return (
    <nav class="fleet" aria-label="Streams">
      <h2>Fleet</h2>
      {all === null && (
        <p class="quiet pad" role="status">
          Loading streams …
        </p>
      )}
      {all?.length === 0 && <Empty />}
      <ul>
        {all?.map((row) => (
          <li key={keyOf(row)}>
            <Row row={row} />
          </li>
        ))}
      </ul>
    </nav>
  );
}

function Empty() {
  return (
    <div class="empty">
      <p>There is no stream yet.</p>
      <p class="quiet">Start one on this machine:</p>
      <pre>lidarcodec publish sim:city</pre>
    </div>
  );
}

/** The state of a stream in one word. */
export function stateOf(row: FleetRow): { name: "alive" | "away" | "ended"; text: string } {
  if (row.alive) return { name: "alive", text: "alive" };
  if (row.ended) return { name: "ended", text: "ended" };
  return { name: "away", text: row.silent_s === null ? "never seen" : `away for ${span(row.silent_s)}` };
}

function Row({ row }: { row: FleetRow }) {
  const key = keyOf(row);
  const state = stateOf(row);
  const values = minutes.value.get(key) ?? [];
  const target = row.target_kbps ?? (typeof row.target === "number" ? row.target : null);
  const missed = row.alive && row.reached === false;
  return (
    <button
      type="button"
      class={`row ${state.name}`}
      aria-current={chosen.value === key ? "true" : undefined}
      onClick={() => choose(key)}
    >
      <span class="line">
        <span class="dot" aria-hidden="true" />
        <span class="name">
          {row.vehicle}
          <span class="quiet">/{row.sensor}</span>
        </span>
        {row.recording && (
          <span class="rec" title="Being recorded">
            REC
          </span>
        )}
        {row.left_out > 0 && (
          <span class="chip" title="Streams of this vehicle above the server's limit">
            {row.left_out} left out
          </span>
        )}
        {row.playback && <span class="chip">playback</span>}
        <span class="chip">{row.codec ?? "?"}</span>
      </span>
      <span class="line figures">
        {row.alive ? (
          <>
            <span class={missed ? "missed" : ""} title="Bitrate over the last five seconds, and the target">
              {row.kbps === null ? "no receiver" : `${kbps(row.kbps)}${target === null ? "" : ` / ${kbps(target)}`}`}
              {row.kbps !== null && <span class="unit"> kbit/s</span>}
            </span>
            <span title="Median time from a frame's last packet until the receiver that is followed, often the server, has decoded it. The way to this page and drawing are not in it">
              {ms(row.latency_ms)}
              <span class="unit"> until decoded</span>
            </span>
            <span title="Frames replaced by newer ones before they were sent">
              {count(row.replaced)}
              <span class="unit"> replaced</span>
            </span>
          </>
        ) : (
          <span>{state.text}</span>
        )}
        <Spark values={values} target={target} />
      </span>
      {row.alive && <span class="hidden">, alive</span>}
    </button>
  );
}
