import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { Problem } from "../model/api";
import { bytes, count, moment } from "../model/format";
import { keyOf } from "../model/minute";
import type { Playing, Segment, Segments } from "../model/wire";
import { Button } from "../parts/button";
import { Download } from "../parts/download";
import { call, choose, mayChange, refreshFleet, rows } from "../state";
import { coded, missing, NOTHING, type Search, searchPath } from "./search";

const FIELDS: [keyof Search, string][] = [
  ["vehicle", "Vehicle"],
  ["from", "From"],
  ["to", "To"],
  ["x", "Place X, m"],
  ["y", "Place Y, m"],
  ["radius", "Radius, m"],
];

/** The server fetches a segment from the store before it plays it, and takes up to 135 s. */
const COPY_MS = 150_000;

/** The archive of the server: segments by vehicle, time and place, to be downloaded and played. */
export function Archive() {
  const search = useSignal<Search>(NOTHING);
  const asked = useSignal<Search>(NOTHING);
  const found = useSignal<Segments | null>(null);
  const problem = useSignal<string | null>(null);
  const busy = useSignal(false);
  const turn = useRef(0);
  useEffect(() => {
    void ask(null);
    return () => {
      turn.current = -1;
    };
  }, []);

  /** Asks for the first segments, or for those after others. An answer that a later search overtook is not used. */
  async function ask(after: string | null) {
    turn.current += 1;
    const mine = turn.current;
    busy.value = true;
    problem.value = null;
    if (after === null) {
      asked.value = search.value;
      found.value = null;
    }
    try {
      const { body } = await call<Segments>("GET", searchPath(asked.value, after));
      if (mine !== turn.current) return;
      const before = after === null ? [] : (found.value?.segments ?? []);
      found.value = { segments: [...before, ...body.segments], next: body.next, lost: body.lost };
    } catch (error) {
      if (mine === turn.current) problem.value = said(error);
    } finally {
      if (mine === turn.current) busy.value = false;
    }
  }

  return (
    <section class="archive" aria-labelledby="archive-title">
      <h2 id="archive-title">Archive</h2>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void ask(null);
        }}
      >
        {FIELDS.map(([name, label]) => {
          const control = {
            id: `archive-${name}`,
            value: search.value[name],
            onInput: (event: { currentTarget: HTMLInputElement }) => {
              search.value = { ...search.value, [name]: event.currentTarget.value };
            },
          };
          const isTime = name === "from" || name === "to";
          return (
            <div class="field" key={name}>
              <label for={control.id}>{label}</label>
              {isTime ? <input type="datetime-local" step={1} {...control} /> : <input type="text" {...control} />}
            </div>
          );
        })}
        <p class="pad">
          <Button off={busy.value}>Search</Button>
        </p>
      </form>
      {problem.value !== null && (
        <p class="problem pad" role="alert">
          {problem.value}
        </p>
      )}
      {busy.value && (
        <p class="quiet pad" role="status">
          Searching the archive …
        </p>
      )}
      {found.value !== null && found.value.lost > 0 && (
        <p class="problem pad" role="status">
          {missing(found.value.lost)}
        </p>
      )}
      {found.value?.segments.length === 0 && <p class="quiet pad">No segment fits this search.</p>}
      <ul aria-label="Segments of the archive, newest first">
        {found.value?.segments.map((one) => (
          <li key={one.segment}>
            <Item one={one} />
          </li>
        ))}
      </ul>
      {found.value?.next && (
        <p class="pad">
          <Button off={busy.value} press={() => void ask(found.value?.next ?? null)}>
            Older
          </Button>
        </p>
      )}
    </section>
  );
}

function Item({ one }: { one: Segment }) {
  const busy = useSignal(false);
  const problem = useSignal<string | null>(null);
  const name = `${one.vehicle}/${one.sensor}`;
  const played = rows.value?.find((row) => row.playback === one.segment);
  const disabled = busy.value || !mayChange.value;

  async function act(method: string, path: string, body?: unknown) {
    busy.value = true;
    problem.value = null;
    try {
      const playing = (await call<Playing | null>(method, path, body, COPY_MS)).body;
      if (playing) choose(`${playing.vehicle}/${playing.sensor}`);
    } catch (error) {
      problem.value = said(error);
    } finally {
      busy.value = false;
      refreshFleet();
    }
  }

  return (
    <>
      <p class="line">
        <b>{name}</b>
        <time class="quiet" dateTime={one.begin}>
          {moment(one.begin)}
        </time>
      </p>
      <p class="line quiet">{`${count(one.frames)} frames · ${bytes(one.bytes)} · ${coded(one.codec, one.bound_m)}`}</p>
      <p class="line">
        {played ? (
          <>
            <Button look="small" press={() => choose(keyOf(played))}>
              Show
            </Button>
            <Button
              look="small"
              off={disabled}
              press={() => void act("DELETE", `api/v1/recordings/${one.segment}/play`)}
            >
              Stop playing
            </Button>
          </>
        ) : (
          <Button
            look="small"
            off={disabled}
            label={`Play ${name} of ${moment(one.begin)}`}
            press={() => void act("POST", `api/v1/archive/${one.segment}/play`, { loop: true })}
          >
            {busy.value ? "Fetching …" : "Play"}
          </Button>
        )}
        <Download
          path={`api/v1/archive/${one.segment}/download`}
          file={`${one.vehicle}_${one.sensor}_${one.segment}.mcap`}
          label={`Download ${name} of ${moment(one.begin)}`}
        />
      </p>
      {problem.value !== null && (
        <p class="problem" role="alert">
          {problem.value}
        </p>
      )}
    </>
  );
}

function said(error: unknown): string {
  return error instanceof Problem ? error.detail : error instanceof Error ? error.message : String(error);
}
