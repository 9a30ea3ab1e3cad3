import { differences } from "../model/draft";
import { carried, count, kbps, ordinal, plain } from "../model/format";
import type { Settings, SettingsState, Stream } from "../model/wire";

/** The settings in force, the target bitrate, and differences from the wanted settings. */
export function InForce({ state, stream }: { state: SettingsState | null; stream: Stream | null }) {
  const applied = state?.applied ?? stream?.settings ?? null;
  const bound = applied?.base_error_m ?? applied?.max_error_m; // the page takes no refinements
  const rate = stream?.status?.rate;
  const reduction = stream?.status?.reduction;
  const path = carried(stream?.status?.path);
  const preparing = stream?.status?.preparing;
  const wanted = state?.desired && state.applied ? differences(state.applied, state.desired) : [];
  return (
    <section class="inforce" aria-label="In force">
      <p>
        <b>{stream?.alive === false ? "Last in force" : "In force"}</b> {applied ? codecOf(applied, stream) : "–"}
        {applied?.purpose !== undefined && applied.purpose !== "look" && `, purpose ${plain(applied.purpose)}`}
        {bound != null && `, error up to ${plain(bound)} m`}
        {applied?.reduction !== undefined &&
          applied.reduction !== "all" &&
          applied.reduction !== "auto" &&
          `, ${plain(applied.reduction)}`}
      </p>
      {stream?.status?.codec_choice?.because && applied?.codec === "auto" && (
        <p>Chosen: {stream.status.codec_choice.because}</p>
      )}
      {rate && (
        <p>
          {rate.auto ? "Automatic" : "Target"} {kbps(rate.target_kbps)} kbit/s
          {rate.reached === false ? `, not reached: limited by the ${rate.limited_by ?? "codec"}` : ""}
          {rate.max_error_m !== undefined && `, error up to ${rate.max_error_m.toFixed(3)} m`}
          {rate.quality !== undefined && `, quality ${rate.quality.toFixed(1)}`}
          {rate.reachable_kbps &&
            `; this scene allows ${kbps(rate.reachable_kbps[0])} to ${kbps(rate.reachable_kbps[1])}`}
        </p>
      )}
      {stream?.alive !== false && path !== "" && <p>{path}</p>}
      {rate?.step !== undefined && rate.step > 1 && (
        <p>
          Only every {ordinal(rate.step)} column is sent. Where a surface continues, the points between are
          interpolated; they are not counted.
        </p>
      )}
      {rate?.intensity !== undefined && rate.intensity !== "lossless" && <p>Intensity: {plain(rate.intensity)}</p>}
      {rate && stream?.status?.left_out ? (
        <p class="warn">
          {count(stream.status.left_out)} {stream.status.left_out === 1 ? "frame was" : "frames were"} left out to keep
          the target bitrate.
        </p>
      ) : null}
      {reduction?.kept != null && (
        <p>
          {count(reduction.kept)} of {count(reduction.returns)} returns are sent
        </p>
      )}
      {reduction?.note && <p class="warn">{reduction.note}</p>}
      {stream?.status?.sensor_model?.note && <p class="warn">{stream.status.sensor_model.note}</p>}
      {preparing && <p role="status">The vehicle is preparing {preparing} …</p>}
      {stream?.alive === false && (
        <p class="warn">The vehicle is not connected. Changes are stored and sent to it when it returns.</p>
      )}
      {state?.refused && (
        <p class="warn" role="alert">
          The vehicle does not accept the settings: {state.refused}
        </p>
      )}
      {wanted.length > 0 && !state?.refused && (
        <p class="warn">
          Set, but not in force yet:{" "}
          {wanted.map(([name, old, value]) => `${name} ${plain(value)} instead of ${plain(old)}`).join(", ")}
        </p>
      )}
    </section>
  );
}

/** The codec in force, and whether `auto` chose it. */
function codecOf(applied: Settings, stream: Stream | null): string {
  const asked = plain(applied.codec);
  const found = stream?.status?.codec;
  return asked === "auto" && found ? `${found} (auto)` : asked;
}
