import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Problem } from "../model/api";
import { type Poller, poll } from "../model/poll";
import type { Playing, Recording } from "../model/wire";
import { Button } from "../parts/button";
import { Download } from "../parts/download";
import { useNow } from "../parts/now";
import { call, choose, mayChange, nameOf, pathOf, refreshFleet, stream } from "../state";
import "./past.css";
import { type Clip, clipText, type Kept, lastOf, partsOf, percentOf, recorded, stateText } from "./spans";
import { TimeLine } from "./timeline";

const KEPT_MS = 5000;
const CLIPS_MS = 1000;
const LAST_S = 30;
/** Most clips in the list; the newest. */
const SHOWN = 5;
const LENGTHS = [
  [600, "10 minutes"],
  [3600, "hour"],
  [43_200, "12 hours"],
] as const;

/** What the vehicle of the chosen stream keeps, what is here of it, and fetching the last seconds exactly. */
export function Past({ name }: { name: string }) {
  const kept = useSignal<Kept | null>(null);
  const clips = useSignal<Clip[]>([]);
  const recordings = useSignal<Recording[]>([]);
  const problem = useSignal<string | null>(null);
  const busy = useSignal(false);
  const length = useSignal<number>(LENGTHS[0][0]);
  const asking = useRef<Poller | null>(null);
  const path = pathOf(nameOf(name));
  const { vehicle, sensor } = nameOf(name);
  const keeps = Boolean(stream.value?.status?.past);
  const now = useNow(keeps || clips.value.length > 0);

  async function askKept() {
    const { body } = await call<Kept>("GET", `${path}/past/spans`);
    kept.value = { ...body, vehicle: body.vehicle ?? kept.value?.vehicle ?? null };
  }

  async function askClips() {
    const all = (await call<Clip[]>("GET", "api/v1/fetches")).body;
    const mine = all.filter((one) => one.vehicle === vehicle && one.sensor === sensor);
    const shown = mine.filter((one) => one.state !== "cancelled").slice(0, SHOWN);
    const running = shown.filter((one) => one.state === "running");
    const told = await Promise.all(running.map((one) => call<Clip>("GET", `api/v1/fetches/${one.id}`)));
    clips.value = shown.map((one) => told.find(({ body }) => body.id === one.id)?.body ?? one);
  }

  useEffect(() => {
    const clipsAsked = poll(() => (clips.value.some((one) => one.state === "running") ? CLIPS_MS : KEPT_MS), askClips);
    asking.current = clipsAsked;
    return () => clipsAsked.stop();
  }, [name]);

  useEffect(() => {
    if (!keeps) return;
    const spans = poll(KEPT_MS, async () => {
      recordings.value = (await call<Recording[]>("GET", "api/v1/recordings")).body;
      await askKept();
    });
    return () => spans.stop();
  }, [name, keeps]);

  async function act(what: () => Promise<unknown>) {
    busy.value = true;
    problem.value = null;
    try {
      await what();
    } catch (error) {
      problem.value = error instanceof Problem ? error.detail : String(error);
    } finally {
      busy.value = false;
      asking.current?.now();
    }
  }

  async function fetchLast() {
    await askKept();
    const last = lastOf(kept.value, LAST_S);
    if (last === null) throw new Error("The vehicle does not answer: what it keeps is not known.");
    const there = clips.value.some((one) => one.from_ns === Number(last.from) && one.to_ns === Number(last.to));
    if (there) throw new Error("The vehicle has kept nothing newer than the newest clip.");
    await call("GET", `${path}/past?from=${last.from}&to=${last.to}`);
  }

  async function play(one: Clip) {
    const { body } = await call<Playing>("POST", `api/v1/fetches/${one.id}/play`, { loop: true });
    refreshFleet();
    choose(`${body.vehicle}/${body.sensor}`);
  }

  if (!keeps && clips.value.length === 0) return null;
  const running = clips.value.filter((one) => one.state === "running");
  const disabled = busy.value || !mayChange.value;
  return (
    <section class="past" aria-labelledby="past-title">
      <div class="line">
        <h2 id="past-title">Past</h2>
        <Button look="small" off={disabled || !keeps} press={() => void act(fetchLast)}>
          Fetch the last {LAST_S} s exactly
        </Button>
        <label>
          Time line of the last{" "}
          <select
            value={String(length.value)}
            onChange={(event) => {
              length.value = Number(event.currentTarget.value);
            }}
          >
            {LENGTHS.map(([seconds, text]) => (
              <option key={seconds} value={String(seconds)}>
                {text}
              </option>
            ))}
          </select>
        </label>
        {problem.value !== null && (
          <span class="problem" role="alert">
            {problem.value}
          </span>
        )}
      </div>
      <TimeLine
        beginMs={now - 1000 * length.value}
        endMs={now}
        vehicle={kept.value?.vehicle ?? null}
        here={kept.value?.here ?? []}
        coming={running.flatMap(partsOf)}
        recorded={recorded(recordings.value, vehicle, sensor, now)}
      />
      <ul aria-label="Clips of this stream, newest first">
        {clips.value.map((one) => (
          <li key={one.id} class="line">
            <Item
              one={one}
              off={disabled}
              cancel={() => void act(() => call("DELETE", `api/v1/fetches/${one.id}`))}
              play={() => void act(() => play(one))}
            />
          </li>
        ))}
      </ul>
    </section>
  );
}

interface ItemProps {
  one: Clip;
  off: boolean;
  cancel: () => void;
  play: () => void;
}

function Item({ one, off, cancel, play }: ItemProps) {
  const name = clipText(one);
  const percent = percentOf(one.progress);
  return (
    <>
      <b>{name}</b>
      {one.state === "running" && (
        <progress aria-label={`Fetched of ${name}`} max={100} {...(percent === null ? {} : { value: percent })} />
      )}
      <span class={one.state === "failed" ? "problem" : "quiet"}>{stateText(one)}</span>
      {one.state === "running" && (
        <Button look="small" off={off} label={`Cancel ${name}`} press={cancel}>
          Cancel
        </Button>
      )}
      {one.state === "complete" && one.clip !== null && (
        <>
          <Button look="small" off={off} label={`Play ${name}`} press={play}>
            Play
          </Button>
          <Download
            path={one.clip.slice(1)}
            file={`${one.vehicle}_${one.sensor}_${one.id}.mcap`}
            size={one.size_bytes}
            label={`Download ${name}`}
          />
        </>
      )}
    </>
  );
}
