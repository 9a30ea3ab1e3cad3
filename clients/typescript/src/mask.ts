/** The MASK section, and KEEP sections of the same form: which cells are returns. */

import type { Columns } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { BitModels, Mixer, RangeDecoder } from "./rangecoder.js";
import { Rows, spread } from "./rows.js";
import { ROWS, type Sensor } from "./sensor.js";

const STARTS = [10000, 24000, 42000, 61000];
const RUN_CLASS = [0, 1, 2, 3, 4, 4, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7];
const REACH = 6;
/** A model with at least this confidence decides alone. */
const SURE_BELOW = 512;
const SURE_ABOVE = 65024;

/** 64 x W of 1 and 0. earlier: 64 x W, the mask last sent in the direction of each cell */
export function readMask(data: Uint8Array, columns: Columns, sensor: Sensor, earlier: Uint8Array | null): Uint8Array {
  const mask = new Uint8Array(ROWS * columns.width);
  const kind = data.length > 0 ? data[0] : -1;
  if (kind === 0 || kind === 1) {
    if (data.length > 1) throw damaged("bytes after a mask that is all the same");
    if (kind === 1)
      for (let row = 0; row < ROWS; row++) {
        const begin = sensor.half[row] * columns.width;
        mask.set(columns.fired.subarray(begin, begin + columns.width), row * columns.width);
      }
    return mask;
  }
  if (kind === 2 || kind === 3) {
    const head = kind === 2 ? 3 : 5;
    if (data.length < head) throw new DecodeError("truncated", "a mask ends within its head");
    if (kind === 3 && (earlier === null || columns.width === 0)) throw damaged("a mask that refers to none");
    const turn = data[1] | (data[2] << 8);
    const shift = kind === 2 ? 0 : ((data[3] | (data[4] << 8)) << 16) >> 16;
    const coder = new RangeDecoder(data.subarray(head));
    readRows(coder, mask, new Rows(sensor, columns), turn, kind === 3 ? earlier : null, shift);
    coder.end();
    return mask;
  }
  throw kind < 0 ? damaged("a mask without bytes") : new DecodeError("version", `a mask of kind ${kind}`);
}

function startedModels(contexts: number): BitModels {
  const models = new BitModels(contexts);
  for (let context = 0; context < contexts; context++) models.start(context, STARTS[((context >> 6) & 2) | (context & 1)]);
  return models;
}

/** 3: all ones; 2: nearly all; 1: some; 0: none. */
function many(ones: number, of: number): number {
  return ones === of ? 3 : ones >= of - (of >> 2) ? 2 : ones > 0 ? 1 : 0;
}

function readRows(
  coder: RangeDecoder,
  mask: Uint8Array,
  rows: Rows,
  turn: number,
  earlier: Uint8Array | null,
  shift: number,
): void {
  const width = mask.length / ROWS;
  const first = startedModels(256);
  const second = startedModels(2048);
  const both = [first, second];
  const mixers = STARTS.map(() => new Mixer(2, 39322, 16));
  const done: Uint8Array[] = [];
  const contexts = [0, 0];
  for (let row = 0; row < ROWS; row++) {
    const columns = rows.columns(row);
    const n = columns.length;
    const u = rows.seen(done[row - 1] ?? null, row - 1, row, turn, REACH);
    const v = rows.seen(done[row - 2] ?? null, row - 2, row, turn, REACH);
    const p = earlier === null ? v : seenEarlier(earlier, row, width, columns, shift);
    // Number of ones around a cell, updated from cell to cell.
    const wide = earlier === null ? 6 : 3;
    const around = earlier === null ? v : p;
    let ones = 0;
    for (let i = REACH - wide; i < REACH + wide; i++) ones += around[i] ?? 0;
    const cells = new Uint8Array(n);
    let [left, left2, run] = [1, 1, 0];
    for (let k = 0; k < n; k++) {
      const i = k + REACH;
      ones += around[i + wide];
      const share = many(ones, 2 * wide + 1);
      ones -= around[i - wide];
      if (earlier === null) {
        contexts[0] = u[i] | (share << 1) | (RUN_CLASS[run] << 3) | (left << 7);
        contexts[1] =
          u[i] | (u[i - 2] << 1) | (u[i - 1] << 2) | (u[i + 1] << 3) | (u[i + 2] << 4) |
          (v[i] << 5) | (v[i + 1] << 6) | (left << 7) | (left2 << 8); // prettier-ignore
      } else {
        contexts[0] = u[i] | (v[i + 1] << 1) | (p[i] << 2) | (share << 3) | (left2 << 5) | (left << 7);
        contexts[1] =
          u[i] | (u[i - 1] << 1) | (u[i + 1] << 2) | (p[i] << 3) | (p[i - 3] << 4) |
          (p[i - 1] << 5) | (p[i + 1] << 6) | (left << 7) | (RUN_CLASS[run] << 8); // prettier-ignore
      }
      const alone = first.chance(contexts[0]);
      const bit =
        alone < SURE_BELOW || alone > SURE_ABOVE
          ? coder.bit(first, contexts[0])
          : mixers[2 * left + u[i]].decide(coder, both, contexts);
      run = bit === left ? Math.min(run + 1, 15) : 0;
      left2 = left;
      left = bit;
      cells[k] = bit;
    }
    done.push(cells);
    spread(mask, row, columns, cells);
  }
}

function seenEarlier(earlier: Uint8Array, row: number, width: number, columns: Int32Array, shift: number): Uint8Array {
  const n = columns.length;
  return Uint8Array.from({ length: n + 2 * REACH }, (_, i) => {
    if (n === 0) return 1;
    const column = columns[Math.min(Math.max(i - REACH, 0), n - 1)] + shift;
    return earlier[row * width + Math.min(Math.max(column, 0), width - 1)];
  });
}
