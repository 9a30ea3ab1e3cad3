/** Rows of an image without cells that were not fired, and the offset between two rows. */

import type { Columns } from "./azimuth.js";
import { Field, ROWS, type Sensor, rowValues } from "./sensor.js";

const TURN = 628_318_531; // in 1e-8 rad
const HALF_TURN = 314_159_265;

export class Rows {
  readonly half: Uint8Array;
  readonly rotation: Int32Array;
  readonly #width: number;
  /** For each half: the fired columns, and for each column the number of fired ones before it. */
  readonly #columns: readonly Int32Array[];
  readonly #before: readonly Int32Array[];

  constructor(sensor: Sensor, { width, fired }: Columns) {
    this.half = sensor.half;
    this.rotation = rowValues(sensor, Field.rotation);
    this.#width = width;
    const halves = [fired.subarray(0, width), fired.subarray(width)];
    this.#columns = halves.map((half) => Int32Array.from(indicesOfOnes(half)));
    this.#before = halves.map((half) => {
      let count = 0;
      return Int32Array.from(half, (on) => (on ? count++ : count));
    });
  }

  /** Columns of the cells of a row. */
  columns(row: number): Int32Array {
    return this.#columns[this.half[row]];
  }

  /** Columns by which row `above` is shifted when seen from `row`. turn: columns in a full turn */
  shift(above: number, row: number, turn: number): number {
    const cells = this.columns(above).length;
    const around = Math.floor((turn * cells + Math.floor(this.#width / 2)) / this.#width);
    let apart = (this.rotation[above] - this.rotation[row]) % TURN;
    if (apart < -HALF_TURN) apart += TURN;
    else if (apart > HALF_TURN) apart -= TURN;
    return Math.floor((2 * apart * around + TURN) / (2 * TURN));
  }

  /**
   * Row `above` as seen from `row`, cells -reach to n + reach - 1 of it; ones where there is none.
   * cells: those of row `above`
   */
  seen(cells: Uint8Array | null, above: number, row: number, turn: number, reach: number): Uint8Array {
    const own = this.columns(row);
    const out = new Uint8Array(own.length + 2 * reach).fill(1);
    if (cells === null || cells.length === 0 || own.length === 0) return out;
    const shift = this.shift(above, row, turn);
    const last = cells.length - 1;
    const apart = this.half[above] !== this.half[row];
    const before = this.#before[this.half[above]];
    for (let i = 0; i < out.length; i++) {
      let k = i - reach;
      if (apart) k = before[own[k < 0 ? 0 : k >= own.length ? own.length - 1 : k]];
      k += shift;
      out[i] = cells[k < 0 ? 0 : k > last ? last : k];
    }
    return out;
  }
}

function* indicesOfOnes(flags: Uint8Array): Generator<number> {
  for (let at = 0; at < flags.length; at++) if (flags[at]) yield at;
}

/** Spreads the cells of a row over an image, 64 x W. */
export function spread(image: Uint8Array, row: number, columns: Int32Array, cells: Uint8Array): void {
  const begin = row * (image.length / ROWS);
  for (let k = 0; k < columns.length; k++) image[begin + columns[k]] = cells[k];
}

/** 64 x W, whether the half of each cell was fired. */
export function firedCells({ width, fired }: Columns, sensor: Sensor): Uint8Array {
  const cells = new Uint8Array(ROWS * width);
  for (let row = 0; row < ROWS; row++) {
    const begin = sensor.half[row] * width;
    cells.set(fired.subarray(begin, begin + width), row * width);
  }
  return cells;
}
