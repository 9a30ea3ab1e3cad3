/** Thinned frames: puts the sent columns back into the whole frame (docs/wire-format-sections.md, "Lattice"). */

import { TURN } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { inflated } from "./inflate.js";
import { LARGEST_WIDTH, type Message, Section } from "./message.js";

const HEAD_BYTES = 11;
const MOST_PACKETS = 2048;

export interface Lattice {
  /** Columns of the whole frame. */
  readonly width: number;
  /** The sent columns, ascending. */
  readonly columns: Uint16Array;
}

/** Which columns of the whole frame were sent; null for a frame that is not thinned. Skips the side information. */
export function latticeOf(message: Message): Lattice | null {
  const data = message.section(Section.LATTICE);
  return data === null ? null : readLattice(data, message.planes ? null : message.width);
}

/** narrow: the width of the frame that was sent; null where planes are as wide as this list */
export function readLattice(data: Uint8Array, narrow: number | null): Lattice {
  if (data.length < HEAD_BYTES) throw new DecodeError("truncated", `a lattice section of ${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [kind, width, packets, listed] = [data[0], view.getUint16(1, true), view.getUint16(3, true), view.getUint16(5, true)];
  const side = view.getUint32(7, true);
  const behind = HEAD_BYTES + listed;
  if (width > LARGEST_WIDTH || packets > MOST_PACKETS) throw damaged(`a lattice of ${width} columns and ${packets} packets`);
  if (behind + side > data.length) throw new DecodeError("truncated", "a lattice section ends within what it announces");
  if (side === 0 && (packets > 0 || data.length > behind)) throw damaged("a lattice of packets without side information");
  const columns = columnsOf(kind, width, data.subarray(HEAD_BYTES, behind));
  if ((narrow !== null && columns.length !== narrow) || (width > 0 && columns.length === 0))
    throw damaged(`a lattice of ${columns.length} columns for a frame of ${narrow}`);
  return { width, columns };
}

function columnsOf(kind: number, width: number, data: Uint8Array): Uint16Array {
  if (kind === 0 && data.length === 4) {
    const [step, phase] = [data[0] | (data[1] << 8), data[2] | (data[3] << 8)];
    if (phase >= step) throw damaged(`a lattice of every ${step}. column from ${phase} on`);
    const found: number[] = [];
    for (let at = 0; at < width; at++)
      if (at === 0 || at === width - 1 || (at >= phase && (at - phase) % step === 0)) found.push(at);
    return Uint16Array.from(found);
  }
  if (kind !== 1) throw damaged(`a lattice of kind ${kind} with ${data.length} bytes of columns`);
  const gaps = inflated(data, 2 * width);
  if (gaps.length % 2) throw damaged("a list of columns that ends within one");
  const columns = new Uint16Array(gaps.length / 2);
  let column = 0;
  for (let i = 0; i < columns.length; i++) {
    const gap = gaps[2 * i] | (gaps[2 * i + 1] << 8);
    column += gap;
    if (column >= width || (i > 0 && gap === 0)) throw damaged(`columns beyond the ${width} of their frame, or twice`);
    columns[i] = column;
  }
  return columns;
}

/** Rows of a narrow image in the frame's own columns, with zeros between them. */
export function widened<T extends Uint8Array | Uint16Array | Uint32Array>(narrow: T, rows: number, { width, columns }: Lattice): T {
  const wide = new (narrow.constructor as new (length: number) => T)(rows * width);
  for (let row = 0, from = 0; row < rows; row++)
    for (let i = 0; i < columns.length; i++) wide[row * width + columns[i]] = narrow[from++];
  return wide;
}

/** Azimuths of all columns, 2 x W, by linear interpolation between the sent ones, the short way round. */
export function widenedAzimuth(narrow: Uint16Array, { width, columns }: Lattice): Uint16Array {
  const count = columns.length;
  const wide = new Uint16Array(2 * width);
  for (let half = 0; half < 2; half++)
    for (let i = 0; i < count; i++) {
      const here = narrow[half * count + i];
      const more = i + 1 < count;
      const gap = (more ? columns[i + 1] : width) - columns[i];
      const way = more ? ((narrow[half * count + i + 1] - here + TURN + TURN / 2) % TURN) - TURN / 2 : 0;
      for (let place = 0; place < gap; place++) wide[half * width + columns[i] + place] = interpolated(here, way * place, gap);
      if (i === 0) wide.fill(here, half * width, half * width + columns[0]);
    }
  return wide;
}

/** here + way / gap as an angle, rounded half to even. */
function interpolated(here: number, way: number, gap: number): number {
  const twice = 2 * way + gap;
  let value = here + Math.floor(twice / (2 * gap));
  if (twice % (2 * gap) === 0 && value % 2 !== 0) value--;
  return (value + TURN) % TURN;
}
