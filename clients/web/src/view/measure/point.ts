/** A return as a point in metres: the formula of docs/live-sockets.md, the same as in the vertex shader. */
import type { Vector } from "../matrix";
import type { RangeFrame } from "../stream/frame";
import { type SensorTable, TEXELS } from "../stream/sensor";

/** Metres at which the two-point correction of a near return ends. */
const FAR_TARGET_M = 25.04;

/** The azimuth of a return, in radians, clockwise seen from above, without the beam's own correction. */
export function azimuthOf({ azimuth, columns }: RangeFrame, { values }: SensorTable, ring: number, column: number) {
  const block = (values[ring * TEXELS * 4 + 7] as number) > 0.5 ? 1 : 0;
  return (((azimuth[block * columns + column] as number) % 36000) * Math.PI) / 18000;
}

/** x forward, y left, z up, from the sensor. Written into `out`. */
export function pointOf(frame: RangeFrame, table: SensorTable, ring: number, column: number, out: Vector): Vector {
  const row = ring * TEXELS * 4;
  const of = (at: number) => table.values[row + at] as number;
  const angle = azimuthOf(frame, table, ring, column);
  const c = Math.cos(angle) * of(0) + Math.sin(angle) * of(1);
  const s = Math.sin(angle) * of(0) - Math.cos(angle) * of(1);
  const distance = (frame.range[ring * frame.columns + column] as number) * frame.rangeStepM + of(4);
  const flat = distance * of(2) - (table.ros ? of(5) * of(3) : 0);
  out[0] = flat * c + of(6) * s;
  out[1] = of(6) * c - flat * s;
  out[2] = distance * of(3) + of(5) * (table.ros ? of(2) : 1);
  if (table.ros) {
    const along = of(8) * Math.max(FAR_TARGET_M - Math.abs(out[0]), 0);
    const across = of(9) * Math.max(FAR_TARGET_M - Math.abs(out[1]), 0);
    out[0] += along * of(2) * c;
    out[1] -= across * of(2) * s;
    out[2] += along * of(3);
  }
  return out;
}
