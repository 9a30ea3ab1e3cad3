/** The mask that was last sent in each of 2000 directions. Masks of inter frames refer to it. */

import type { Columns } from "./azimuth.js";
import { ROWS, type Sensor } from "./sensor.js";

const STEP = 18;
const DIRECTIONS = 2000;

export class MaskHistory {
  readonly #sent = new Uint8Array(ROWS * DIRECTIONS);

  forget(): void {
    this.#sent.fill(0);
  }

  /** 64 x W: the bit of the direction of each cell. */
  before({ width, azimuth }: Columns, sensor: Sensor): Uint8Array {
    const seen = new Uint8Array(ROWS * width);
    for (let row = 0; row < ROWS; row++)
      for (let column = 0; column < width; column++)
        seen[row * width + column] = this.#sent[row * DIRECTIONS + direction(azimuth[sensor.half[row] * width + column])];
    return seen;
  }

  remember(mask: Uint8Array, { width, azimuth }: Columns, sensor: Sensor): void {
    for (let row = 0; row < ROWS; row++)
      for (let column = 0; column < width; column++)
        this.#sent[row * DIRECTIONS + direction(azimuth[sensor.half[row] * width + column])] = mask[row * width + column];
  }
}

function direction(azimuth: number): number {
  return Math.floor(azimuth / STEP);
}
