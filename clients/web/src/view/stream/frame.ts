/** A decoded frame as a range image: what the cloud socket sends with `form=range` (docs/live-sockets.md).
 *
 * The arrays are views into the message: nothing is copied between the socket and the graphics card. */
import type { Pose } from "../matrix";

/** Most rows of any sensor's image. */
export const MAX_RINGS = 128;
/** Most columns: a frame of 2048 packets, the longest one. */
export const MAX_COLUMNS = 12_288;

export interface RangeFrame {
  /** 16 hex digits: another one at each start of the publisher. */
  streamId: string;
  index: number;
  /** Milliseconds since 1970 at the vehicle: the frame's first packet. */
  stampMs: number;
  /** Milliseconds since 1970 at which it was decoded, by the clock of the decoding machine. */
  decodedMs: number;
  /** Time from the frame's last packet to its decoding; NaN if the clocks differ. */
  latencyMs: number;
  codec: number;
  /** Rows. */
  rings: number;
  columns: number;
  /** Number of measured returns. */
  returns: number;
  /** Number of interpolated returns. */
  madeUp: number;
  /** Metres of a step of `range`. */
  rangeStepM: number;
  /** (rings, columns), row by row; 0 = no return. */
  range: Uint16Array;
  /** (2, columns) in 0.01 degree: of each column's block 0, then of its block 1. */
  azimuth: Uint16Array;
  /** (rings, columns). */
  intensity: Uint8Array | null;
  /** (rings, columns): the range image before it was coded, in the same steps. */
  original: Uint16Array | null;
  /** (rings, columns): 1 for an interpolated return; null if there is none. */
  filled: Uint8Array | null;
  /** T_world_sensor at the stamp. */
  pose: Pose | null;
}

const MAGIC = 0x5243444c; // LDCR, little endian
const HEADER_BYTES = 96;
const INTENSITY = 1;
const ORIGINAL = 16;
const POSE = 32;
const FILLED = 64;
const POSE_BYTES = 96;

export class FrameError extends Error {}

const padded = (bytes: number) => (bytes + 3) & ~3;

function u64(view: DataView, at: number): number {
  return view.getUint32(at + 4, true) * 0x100000000 + view.getUint32(at, true);
}

/** Milliseconds of a time in ns, i64; to a quarter of a microsecond, as exact as a number can be. */
function milliseconds(view: DataView, at: number): number {
  return view.getInt32(at + 4, true) * (0x100000000 / 1e6) + view.getUint32(at, true) / 1e6;
}

const hex = (value: number) => value.toString(16).padStart(8, "0");

/** The frame of a binary message of form range. Throws FrameError for an invalid message. */
export function parseFrame(data: ArrayBuffer): RangeFrame {
  const view = new DataView(data);
  if (data.byteLength < HEADER_BYTES || view.getUint32(0, true) !== MAGIC) {
    throw new FrameError("the message is not a range image");
  }
  if (view.getUint16(4, true) !== 1) throw new FrameError(`format version ${view.getUint16(4, true)} is not known`);
  if (view.getUint32(80, true) !== data.byteLength)
    throw new FrameError("the message does not have the length in its header");
  const header = view.getUint16(6, true);
  const flags = view.getUint16(42, true);
  const columns = view.getUint16(76, true);
  const rings = view.getUint16(78, true);
  const hollow = columns === 0 && view.getUint32(44, true) > 0;
  if (rings === 0 || rings > MAX_RINGS || columns > MAX_COLUMNS || hollow) {
    throw new FrameError(`an image of ${rings} x ${columns} cannot be shown`);
  }
  const hasPose = (flags & POSE) !== 0;
  const cells = rings * columns;
  const wanted =
    header +
    padded(2 * cells) +
    padded(4 * columns) +
    (flags & INTENSITY ? padded(cells) : 0) +
    (flags & ORIGINAL ? padded(2 * cells) : 0) +
    (flags & FILLED ? padded(cells) : 0);
  if (header < HEADER_BYTES + (hasPose ? POSE_BYTES : 0) || header % 4 !== 0 || wanted > data.byteLength) {
    throw new FrameError("the message is shorter than its arrays");
  }
  let at = header;
  const range = new Uint16Array(data, at, cells);
  at += padded(2 * cells);
  const azimuth = new Uint16Array(data, at, 2 * columns);
  at += padded(4 * columns);
  let intensity: Uint8Array | null = null;
  if (flags & INTENSITY) {
    intensity = new Uint8Array(data, at, cells);
    at += padded(cells);
  }
  let original: Uint16Array | null = null;
  if (flags & ORIGINAL) {
    original = new Uint16Array(data, at, cells);
    at += 2 * cells;
  }
  const returns = view.getUint32(48, true);
  const told = {
    streamId: hex(view.getUint32(12, true)) + hex(view.getUint32(8, true)),
    index: u64(view, 16),
    stampMs: milliseconds(view, 24),
    decodedMs: milliseconds(view, 32),
    latencyMs: view.getFloat32(56, true),
    codec: view.getUint16(40, true),
    rings,
    columns,
    returns,
    madeUp: Math.max(view.getUint32(44, true) - returns, 0),
    rangeStepM: view.getFloat32(60, true),
    range,
    azimuth,
    intensity,
    original,
    filled: flags & FILLED ? new Uint8Array(data, at, cells) : null,
    pose: hasPose ? new Float64Array(data, HEADER_BYTES, 12) : null,
  };
  return columns > 0 ? told : { ...told, ...withoutColumns(rings) };
}

/** A frame without columns, as one column without returns: a picture has at least one. */
function withoutColumns(rings: number): Partial<RangeFrame> {
  return {
    columns: 1,
    range: new Uint16Array(rings),
    azimuth: new Uint16Array(2),
    intensity: null,
    original: null,
    filled: null,
  };
}

/** Whether nothing came back in a frame of at most one column: then it does not tell which part of a turn it is. */
export function isEmpty({ columns, returns, madeUp }: Pick<RangeFrame, "columns" | "returns" | "madeUp">): boolean {
  return columns < 2 && returns + madeUp === 0;
}

/** Share of a turn in a frame: its columns times the usual step between two columns. */
export function coverageOf({ azimuth, columns }: Pick<RangeFrame, "azimuth" | "columns">): number {
  if (columns < 2) return 0;
  // over several columns, because single steps are only 17 or 18 hundredths of a degree
  const over = Math.max(1, Math.min(16, columns >> 2));
  const stride = Math.max(1, Math.floor((columns - over) / 31));
  const ways: number[] = [];
  for (let column = 0; column + over < columns; column += stride) {
    ways.push(((azimuth[column + over] as number) - (azimuth[column] as number) + 36000) % 36000);
  }
  ways.sort((a, b) => a - b); // lost packets make some of them longer
  return (columns * (ways[ways.length >> 1] ?? 0)) / (36000 * over);
}
