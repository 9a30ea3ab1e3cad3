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
import {
  asOf,
  type Clip,
  clipText,
  type Kept,
  lastOf,
  obstacle,
  partsOf,
  percentOf,
  recorded,
  stateText,
  type Told,
} from "./spans";
import { TimeLine } from "./timeline";

const KEPT_MS = 5000;
const CLIPS_MS = 1000;
/** Of a vehicle that keeps nothing, and of which nothing is here. */
const NOTHING_MS = 30_000;
const LAST_S = 30;
/** Most clips in the list that are over, the newest, and most whose progress is shown. */
const SHOWN = 5;
const STATES = "state=running&state=complete&state=failed";
const LENGTHS = [
  [600, "10 minutes"],
  [3600, "hour"],
  [43_200, "12 hours"],
] as const;

/** What the vehicle of the chosen stream keeps, what is here of it, and fetching the last seconds exactly. */
export function Past({ name }: { name: string }) {
  const told = useSignal<Told | null>(null);
  const clips = useSignal<Clip[]>([]);
  const recordings = useSignal<Recording[] | null>(null);
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
    told.value = { kept: body, toldMs: body.age_s === null ? null : Date.now() - 1000 * body.age_s };
  }

  async function askClips() {
    const whose = `vehicle=${encodeURIComponent(vehicle)}&sensor=${encodeURIComponent(sensor)}`;
    const { body } = await call<Clip[]>("GET", `api/v1/fetches?${whose}&${STATES}&limit=${SHOWN}`);
    const running = body.filter((one) => one.state === "running").slice(-SHOWN);
    const now = await Promise.all(running.map((one) => call<Clip>("GET", `api/v1/fetches/${one.id}`)));
    clips.value = body.map((one) => now.find((answer) => answer.body.id === one.id)?.body ?? one);
  }

  async function askRecordings() {
    try {
      recordings.value = (await call<Recording[]>("GET", "api/v1/recordings")).body;
    } catch (error) {
      recordings.value = null;
      throw error;
    }
  }

  function pause() {
    if (clips.value.some((one) => one.state === "running")) return CLIPS_MS;
    return keeps || clips.value.length > 0 ? KEPT_MS : NOTHING_MS;
  }

  useEffect(() => {
    const clipsAsked = poll(pause, askClips);
    asking.current = clipsAsked;
    return () => clipsAsked.stop();
  }, [name, keeps]);

  useEffect(() => {
    if (!keeps) return;
    const asked = [poll(KEPT_MS, askKept), poll(KEPT_MS, askRecordings)];
    return () => {
      for (const one of asked) one.stop();
    };
  }, [name, keeps]);

  async function act(what: () => Promise<unknown>) {
    busy.value = true;
    problem.value = null;
    try {
      await what();
    } catch (error) {
      problem.value = error instanceof Problem ? error.detail : error instanceof Error ? error.message : String(error);
    } finally {
      busy.value = false;
      asking.current?.now();
    }
  }

  async function fetchLast() {
    await askKept();
    const last = lastOf(told.value?.kept ?? null, LAST_S);
    const why = obstacle(told.value, Date.now());
    if (last === null || why !== null) throw new Error(why ?? "The vehicle has kept nothing yet.");
    const { status, body } = await call<Clip>("GET", `${path}/past?from=${last.from}&to=${last.to}&as=fetch`);
    if (status === 200 || clips.value.some((one) => one.id === body.id))
      throw new Error("All that the vehicle has kept is in clips that are here or on their way.");
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
        vehicle={told.value?.kept.vehicle ?? null}
        asOf={asOf(told.value, now)}
        here={told.value?.kept.here ?? null}
        coming={running.flatMap(partsOf)}
        recorded={recordings.value === null ? null : recorded(recordings.value, vehicle, sensor, now)}
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
        <progress aria-label={`Progress of ${name}`} max={100} {...(percent === null ? {} : { value: percent })} />
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
