import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Archive } from "../archive/archive";
import { Problem } from "../model/api";
import { bytes, clock, count, moment } from "../model/format";
import { type Poller, poll } from "../model/poll";
import type { Playing, Recording } from "../model/wire";
import { call, choose, chosen, chosenRow, mayChange, nameOf, pathOf, refreshFleet, rows, session } from "../state";
import { Button } from "./button";
import { Download } from "./download";

const EVERY_MS = 2000;

/** Recordings of the server: start and stop one of the chosen stream, play them, delete them. */
export function Recordings() {
  const all = useSignal<Recording[] | null>(null);
  const problem = useSignal<string | null>(null);
  const busy = useSignal(false);
  const asking = useRef<Poller | null>(null);

  useEffect(() => {
    asking.current = poll(EVERY_MS, async () => {
      all.value = (await call<Recording[]>("GET", "api/v1/recordings")).body;
    });
    return () => asking.current?.stop();
  }, []);

  // The list of streams has newer data about recordings.
  const told = rows.value?.map((row) => `${row.recording ?? ""} ${row.playback ?? ""}`).join();
  useEffect(() => asking.current?.now(), [told]);

  async function act(method: string, path: string, body?: unknown): Promise<unknown> {
    busy.value = true;
    problem.value = null;
    try {
      return (await call(method, path, body)).body;
    } catch (error) {
      problem.value = error instanceof Problem ? error.detail : String(error);
      return null;
    } finally {
      busy.value = false;
      asking.current?.now();
      refreshFleet();
    }
  }

  const path = chosen.value === null ? null : `${pathOf(nameOf(chosen.value))}/recording`;
  const runs = chosenRow.value?.recording ?? null;
  const disabled = busy.value || !mayChange.value;
  return (
    <div class="recordings">
      {path !== null && (
        <div class="actions">
          <Button
            look={runs === null ? "primary" : "danger"}
            off={disabled}
            press={() => void act(runs === null ? "POST" : "DELETE", path)}
          >
            {runs === null ? "Record" : "Stop recording"} {chosen.value}
          </Button>
        </div>
      )}
      {problem.value !== null && (
        <p class="problem pad" role="alert">
          {problem.value}
        </p>
      )}
      {all.value === null && (
        <p class="quiet pad" role="status">
          Loading recordings …
        </p>
      )}
      {all.value?.length === 0 && <p class="quiet pad">There are no recordings yet. They are kept on the server.</p>}
      <ul>
        {all.value?.map((one) => (
          <li key={one.id}>
            <Item
              one={one}
              disabled={disabled}
              play={async () => {
                const playing = (await act("POST", `api/v1/recordings/${one.id}/play`, {
                  loop: true,
                })) as Playing | null;
                if (playing) choose(`${playing.vehicle}/${playing.sensor}`);
              }}
              stop={() => act("DELETE", `api/v1/recordings/${one.id}/play`)}
              remove={() => act("DELETE", `api/v1/recordings/${one.id}`)}
            />
          </li>
        ))}
      </ul>
      {session.value?.archive && <Archive />}
    </div>
  );
}

/** Outside the component, so that it is called only once, when the button appears. */
function focused(button: HTMLButtonElement | null) {
  button?.focus();
}

interface ItemProps {
  one: Recording;
  disabled: boolean;
  play: () => Promise<unknown>;
  stop: () => Promise<unknown>;
  remove: () => Promise<unknown>;
}

function Item({ one, disabled, play, stop, remove }: ItemProps) {
  const sure = useSignal(false);
  const ask = (on: boolean) => {
    sure.value = on;
  };
  const name = `${one.vehicle}/${one.sensor}`;
  const end = one.ended === null ? Date.now() : Date.parse(one.ended);
  const length = one.state === "recording" || one.ended ? clock((end - Date.parse(one.started)) / 1000) : "";
  return (
    <>
      <p class="line">
        <b>{name}</b>
        <span class={`chip ${one.state}`}>{one.state}</span>
        <span class="quiet">
          <time dateTime={one.started}>{moment(one.started)}</time>
          {one.by && ` by ${one.by}`}
        </span>
      </p>
      <p class="line quiet">
        {[length, bytes(one.size_bytes), one.frames === null ? "" : `${count(one.frames)} frames`]
          .filter(Boolean)
          .join(" · ")}
      </p>
      {one.reason && <p class="warn">{one.reason}</p>}
      <p class="line">
        {one.playing ? (
          <>
            <Button look="small" press={() => choose(`${one.playing?.vehicle}/${one.playing?.sensor}`)}>
              Show
            </Button>
            <Button look="small" off={disabled} press={() => void stop()}>
              Stop playing
            </Button>
          </>
        ) : (
          <Button
            look="small"
            off={disabled || one.state === "recording"}
            label={`Play ${name} of ${moment(one.started)}`}
            press={() => void play()}
          >
            Play
          </Button>
        )}
        <Download
          path={`api/v1/recordings/${one.id}/download`}
          file={`${one.vehicle}_${one.sensor}_${one.id}.mcap`}
          size={one.size_bytes}
          off={one.state === "recording" || one.size_bytes === 0}
          label={`Download ${name} of ${moment(one.started)}`}
        />
        <span class="grow" />
        {sure.value ? (
          <>
            <span>Delete for good?</span>
            <Button look="small danger" off={disabled} press={() => void remove()}>
              Delete
            </Button>
            <Button look="small" focus={focused} press={() => ask(false)}>
              Keep
            </Button>
          </>
        ) : (
          <Button
            look="small"
            off={disabled || one.state === "recording" || one.playing !== null}
            label={`Delete ${name} of ${moment(one.started)}`}
            press={() => ask(true)}
          >
            Delete
          </Button>
        )}
      </p>
    </>
  );
}
