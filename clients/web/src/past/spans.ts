/** What a vehicle keeps, what is here of it, and clips on their way; as text, and as places on a time line. */
import { bytes, clock, count, span as lengthText, moment } from "../model/format";
import type { Playing, Recording } from "../model/wire";

/** Begin and end in ns since the Unix epoch; a double is exact to a quarter of a microsecond there. */
export type Span = [number, number];

export interface Kept {
  /** As the vehicle told it last; null: the server does not know. */
  vehicle: Span[] | null;
  /** How long ago it told that. */
  age_s: number | null;
  here: Span[];
  marks: { name: string; from_ns: number; to_ns: number; reason: string }[];
}

export interface Progress {
  listed: boolean;
  bytes: number;
  bytes_done: number;
  gaps: Span[];
  waiting: string | null;
}

export interface Clip {
  id: string;
  vehicle: string;
  sensor: string;
  from_ns: number;
  to_ns: number;
  state: "running" | "complete" | "failed" | "cancelled";
  by: string;
  reason: string | null;
  size_bytes: number;
  clip: string | null;
  /** What it lacks, once it is complete, because the vehicle has nothing of it. */
  gaps: Span[];
  /** Frames that are missing between those of a complete clip; null: not known. */
  missing_frames: number | null;
  playing: Playing | null;
  progress: Progress | null;
}

/** A piece of a row of the time line: place and width in per cent. */
export interface Bar {
  left: number;
  width: number;
}

/** What is kept, and when the vehicle told that, in ms of this browser's clock; null: never. */
export interface Told {
  kept: Kept;
  toldMs: number | null;
}

const MS = 1e6;
/** The vehicle is asked every few seconds; an older answer is shown with its time. */
const OLD_MS = 20_000;
/** On older knowledge nothing is fetched as "the last seconds". */
const TOO_OLD_MS = 60_000;
/** Bars are at least so wide, in per cent, so that short clips are seen on a long line. */
const LEAST = 0.4;

/** The last seconds that a vehicle keeps without a gap, as `from` and `to` of a request. null: it keeps nothing that is known. */
export function lastOf(kept: Kept | null, seconds: number): { from: string; to: string } | null {
  const [first, ...rest] = kept?.vehicle ?? [];
  if (first === undefined) return null;
  const [begin, end] = rest.reduce((last, one) => (one[1] > last[1] ? one : last), first);
  const endMs = Math.ceil(end / MS);
  const beginMs = Math.min(Math.max(Math.floor(begin / MS), endMs - 1000 * seconds), endMs - 1);
  return { from: `${beginMs}000000`, to: `${endMs}000000` };
}

/** ` as of 12:00:05` for old knowledge of what the vehicle keeps; empty if it is fresh, or there is none. */
export function asOf(told: Told | null, nowMs: number): string {
  if (told === null || told.toldMs === null || nowMs - told.toldMs <= OLD_MS) return "";
  return ` as of ${moment(new Date(told.toldMs).toISOString())}`;
}

/** Why the last seconds cannot be fetched now; null if they can. */
export function obstacle(told: Told | null, nowMs: number): string | null {
  if (told === null || told.toldMs === null || told.kept.vehicle === null)
    return "The vehicle does not answer, so it is not known what it keeps.";
  if (told.kept.vehicle.length === 0) return "The vehicle has kept nothing yet.";
  if (nowMs - told.toldMs <= TOO_OLD_MS) return null;
  return `The vehicle does not answer: what is shown is what it kept${asOf(told, nowMs)}.`;
}

/** Spans on a line that begins and ends at these times in ms. What is outside is left out. */
export function barsOf(spans: Span[], beginMs: number, endMs: number): Bar[] {
  const whole = endMs - beginMs;
  return spans.flatMap(([from, to]) => {
    const begin = Math.max(from / MS, beginMs);
    const end = Math.min(to / MS, endMs);
    if (end <= begin) return [];
    const width = Math.max((100 * (end - begin)) / whole, LEAST);
    return [{ left: Math.min((100 * (begin - beginMs)) / whole, 100 - width), width }];
  });
}

/** Spans of the server's recordings of a stream. One that runs goes on until now. */
export function recorded(all: Recording[], vehicle: string, sensor: string, nowMs: number): Span[] {
  return all
    .filter((one) => one.vehicle === vehicle && one.sensor === sensor)
    .flatMap((one): Span[] => {
      const end = one.ended === null ? (one.state === "recording" ? nowMs : null) : Date.parse(one.ended);
      return end === null ? [] : [[MS * Date.parse(one.started), MS * end]];
    });
}

/** Total length of spans in seconds; where they overlap, it counts once. */
export function secondsOf(spans: Span[]): number {
  let total = 0;
  let at = Number.NEGATIVE_INFINITY;
  for (const [from, to] of [...spans].sort((a, b) => a[0] - b[0])) {
    total += Math.max(0, to - Math.max(from, at));
    at = Math.max(at, to);
  }
  return total / 1e9;
}

/** The parts of a clip that the vehicle kept, as far as that is known. */
export function partsOf(one: Clip): Span[] {
  const parts: Span[] = [];
  let at = one.from_ns;
  for (const [begin, end] of one.progress?.gaps ?? one.gaps) {
    if (begin > at) parts.push([at, begin]);
    at = end;
  }
  return one.to_ns > at ? [...parts, [at, one.to_ns]] : parts;
}

/** A row of the time line in words. */
export function rowText(spans: Span[]): string {
  const first = Math.min(...spans.map(([from]) => from));
  const last = Math.max(...spans.map(([, to]) => to));
  if (spans.length === 0) return "nothing";
  const when = `${moment(new Date(first / MS).toISOString())} to ${moment(new Date(last / MS).toISOString())}`;
  const parts = spans.length > 1 ? ` in ${spans.length} parts` : "";
  return `${lengthText(secondsOf(spans))}${parts}, ${when}`;
}

/** A clip's span in words: `12:00:05, 30 s`. */
export function clipText(one: Clip): string {
  const seconds = Math.round((one.to_ns - one.from_ns) / 1e9);
  return `${moment(new Date(one.from_ns / MS).toISOString())}, ${seconds < 90 ? `${seconds} s` : clock(seconds)}`;
}

/** How far a clip is: whole per cent, null while its size is not known. */
export function percentOf(progress: Progress | null): number | null {
  if (progress === null || !progress.listed || progress.bytes === 0) return null;
  return Math.min(100, Math.floor((100 * progress.bytes_done) / progress.bytes));
}

/** The state of a clip in a sentence. */
export function stateText(one: Clip): string {
  if (one.state === "complete") {
    const missing = one.missing_frames
      ? ` ${count(one.missing_frames)} frames in between are missing: the vehicle did not keep them.`
      : "";
    if (one.gaps.length === 0) return `Here, exactly: ${bytes(one.size_bytes)}.${missing}`;
    const [has, of] = [secondsOf(partsOf(one)), (one.to_ns - one.from_ns) / 1e9];
    return `${has.toFixed(1)} of ${of.toFixed(1)} s are here, exactly: ${bytes(one.size_bytes)}. The vehicle has nothing of the rest.${missing}`;
  }
  if (one.state === "failed") return `Failed: ${one.reason ?? "no reason was given"}`;
  if (one.state === "cancelled") return "Cancelled.";
  const percent = percentOf(one.progress);
  if (one.progress?.waiting)
    return `Waiting ${one.progress.waiting}${percent === null ? "" : `, ${percent} % are here`}.`;
  if (percent === null) return "Asking the vehicle what it kept …";
  return `Fetching: ${percent} % of ${bytes(one.progress?.bytes ?? 0)}.`;
}
