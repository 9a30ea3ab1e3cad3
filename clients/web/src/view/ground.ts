/** Height of the road in the sensor's frame: the median of the lower beams' hits. */
import type { RangeFrame } from "./stream/frame";
import { MAX_COLUMNS } from "./stream/frame";
import { type SensorTable, TEXELS } from "./stream/sensor";

const STRIDE = 16;
const LOWEST = 16;
const EVERY = 10;
export const USUAL_M = -1.73;

export class Ground {
  z = USUAL_M;
  #count = 0;
  readonly #heights = new Float32Array((LOWEST * MAX_COLUMNS) / STRIDE);

  /** Take every tenth frame into account. */
  update({ range, columns, rangeStepM }: RangeFrame, { rings, values }: SensorTable): void {
    if (this.#count++ % EVERY !== 0) return;
    let found = 0;
    for (let ring = Math.max(rings - LOWEST, 0); ring < rings; ring++) {
      const row = ring * TEXELS * 4;
      const sine = values[row + 3] as number;
      if (sine > -0.15) continue;
      for (let column = 0; column < columns; column += STRIDE) {
        const steps = range[ring * columns + column] as number;
        if (steps === 0) continue;
        const distance = steps * rangeStepM + (values[row + 4] as number);
        this.#heights[found++] = distance * sine + (values[row + 5] as number) * (values[row + 2] as number);
      }
    }
    if (found < 64) return;
    const middle = this.#heights.subarray(0, found).sort()[found >> 1] as number;
    if (middle > -0.3 || middle < -6) return;
    this.z = this.#count === 1 ? middle : this.z + 0.2 * (middle - this.z);
  }

  reset(): void {
    this.#count = 0;
    this.z = USUAL_M;
  }
}
