/** The box: points outside it are not drawn. */
import type { Matrix, Vector } from "../matrix";
import type { RangeFrame } from "../stream/frame";
import { type SensorTable, TEXELS } from "../stream/sensor";

/** Metres in the frame of the picture: forward, to the left, and above the road. */
export interface Box {
  least: Vector;
  greatest: Vector;
}

/** What the sliders reach, and the box that leaves nothing out. */
export const WIDEST: Readonly<Box> = { least: [-120, -120, -5], greatest: [120, 120, 30] };
/** Of a box along each axis. */
export const THINNEST_M = 0.5;
const AXES = [0, 1, 2] as const;
const FAR_TARGET_M = 25.04;

/** A box that was kept or sent by somebody, within what the sliders reach; null for anything else. */
export function checkedBox(value: unknown): Box | null {
  const { least, greatest } = (value ?? {}) as Partial<Record<keyof Box, unknown>>;
  const three = (one: unknown): one is Vector =>
    Array.isArray(one) && one.length === 3 && one.every((part) => typeof part === "number" && Number.isFinite(part));
  if (!three(least) || !three(greatest)) return null;
  const box: Box = { least: [0, 0, 0], greatest: [0, 0, 0] };
  for (const axis of AXES) {
    const [from, to] = [WIDEST.least[axis], WIDEST.greatest[axis]];
    box.least[axis] = Math.min(Math.max(least[axis], from), to - THINNEST_M);
    box.greatest[axis] = Math.min(Math.max(greatest[axis], box.least[axis] + THINNEST_M), to);
  }
  return box;
}

/** Whether a point is in the box. point: metres in the frame of the picture; ground: height of the road there */
export function isInside({ least, greatest }: Box, [x, y, z]: Readonly<Vector>, ground: number): boolean {
  const above = [x, y, z - ground];
  return AXES.every((axis) => (above[axis] as number) >= least[axis] && (above[axis] as number) <= greatest[axis]);
}

/** How many returns of a frame are in the box, those that were made up left out.
 *
 * place: from the sensor to the frame of the picture. It has the formula of `pointOf`, with all that a ring or a column
 * has in common taken out: 1 ms for 120,000 returns. */
export function countInside(frame: RangeFrame, table: SensorTable, place: Matrix, box: Box, ground: number): number {
  const { columns, rings, range, azimuth, filled, rangeStepM: step } = frame;
  const turns = new Float64Array(4 * columns);
  for (let at = 0; at < 2 * columns; at++) {
    const angle = (((azimuth[at] as number) % 36000) * Math.PI) / 18000;
    turns[2 * at] = Math.cos(angle);
    turns[2 * at + 1] = Math.sin(angle);
  }
  const m = Array.from(place);
  const [m0, m1, m2, m4, m5, m6, m8, m9, m10] = [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]] as number[];
  const [mx, my, mz] = [m[12], m[13], (m[14] as number) - ground] as [number, number, number];
  const [x0, y0, z0] = box.least;
  const [x1, y1, z1] = box.greatest;
  let count = 0;
  for (let ring = 0; ring < rings; ring++) {
    const row = ring * TEXELS * 4;
    const of = (at: number) => table.values[row + at] as number;
    const [c0, s0, flatOf, upOf, add, rise, aside] = [of(0), of(1), of(2), of(3), of(4), of(5), of(6)];
    const [along, across] = [of(8), of(9)];
    const first = of(7) > 0.5 ? 2 * columns : 0;
    const lower = table.ros ? rise * upOf : 0;
    const higher = rise * (table.ros ? flatOf : 1);
    for (let column = 0, cell = ring * columns; column < columns; column++, cell++) {
      const steps = range[cell] as number;
      if (steps === 0 || (filled && filled[cell] !== 0)) continue;
      const cosine = turns[first + 2 * column] as number;
      const sine = turns[first + 2 * column + 1] as number;
      const c = cosine * c0 + sine * s0;
      const s = sine * c0 - cosine * s0;
      const distance = steps * step + add;
      const flat = distance * flatOf - lower;
      let x = flat * c + aside * s;
      let y = aside * c - flat * s;
      let z = distance * upOf + higher;
      if (table.ros) {
        const nearX = along * Math.max(FAR_TARGET_M - Math.abs(x), 0);
        const nearY = across * Math.max(FAR_TARGET_M - Math.abs(y), 0);
        x += nearX * flatOf * c;
        y -= nearY * flatOf * s;
        z += nearX * upOf;
      }
      const px = (m0 as number) * x + (m4 as number) * y + (m8 as number) * z + mx;
      const py = (m1 as number) * x + (m5 as number) * y + (m9 as number) * z + my;
      const pz = (m2 as number) * x + (m6 as number) * y + (m10 as number) * z + mz;
      if (px >= x0 && px <= x1 && py >= y0 && py <= y1 && pz >= z0 && pz <= z1) count++;
    }
  }
  return count;
}
