import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { clock } from "../model/format";
import { type Poller, poll } from "../model/poll";
import type { Playing } from "../model/wire";
import { call, mayChange, refreshFleet } from "../state";

const EVERY_MS = 500;
const RATES = [2.5, 5, 10, 20, 40];

/** The time line of a playback: its position, and a control to move it. */
export function Playback({ id }: { id: string }) {
  const path = `api/v1/recordings/${id}/play`;
  const playing = useSignal<Playing | null>(null);
  const held = useSignal<number | null>(null); // position of the thumb while the user moves it
  const asking = useRef<Poller | null>(null);

  useEffect(() => {
    asking.current = poll(EVERY_MS, async () => {
      playing.value = (await call<Playing | null>("GET", path)).body;
      if (playing.value === null) refreshFleet();
    });
    return () => asking.current?.stop();
  }, [path]);

  async function change(body: Partial<Playing>) {
    try {
      playing.value = (await call<Playing>("PATCH", path, body)).body;
    } catch {
      asking.current?.now(); // the playback may have ended: ask for its state
    }
    held.value = null;
  }

  const now = playing.value;
  if (now === null) return null;
  const position = held.value ?? now.position_s;
  const disabled = !mayChange.value;
  return (
    <fieldset class="playback" aria-label="Playback">
      <button
        type="button"
        disabled={disabled}
        aria-pressed={now.paused}
        onClick={() => change({ paused: !now.paused })}
      >
        {now.paused ? "Play" : "Pause"}
      </button>
      <span class="time">{clock(position)}</span>
      <input
        type="range"
        aria-label="Position in the recording"
        aria-valuetext={`${clock(position)} of ${clock(now.duration_s)}`}
        min="0"
        max={now.duration_s}
        step="0.1"
        disabled={disabled}
        value={position}
        onInput={(event) => {
          held.value = event.currentTarget.valueAsNumber;
        }}
        onChange={(event) => change({ position_s: event.currentTarget.valueAsNumber })}
      />
      <span class="time">{clock(now.duration_s)}</span>
      <label>
        Speed
        <select
          disabled={disabled}
          value={String(now.rate)}
          onChange={(event) => change({ rate: Number(event.currentTarget.value) })}
        >
          {[...new Set([...RATES, now.rate])]
            .sort((a, b) => a - b)
            .map((rate) => (
              <option key={rate} value={String(rate)}>
                {rate / 10} ×
              </option>
            ))}
        </select>
      </label>
      <label class="check">
        <input
          type="checkbox"
          disabled={disabled}
          checked={now.loop}
          onChange={(event) => change({ loop: event.currentTarget.checked })}
        />
        Loop
      </label>
      <button type="button" disabled={disabled} onClick={() => void call("DELETE", path).finally(refreshFleet)}>
        Stop
      </button>
    </fieldset>
  );
}
