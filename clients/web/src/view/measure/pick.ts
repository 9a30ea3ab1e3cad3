/** The return under the pointer: of those near it on the screen, the one nearest to the camera. */
import { type Matrix, type Pose, transformed, type Vector } from "../matrix";
import type { RangeFrame } from "../stream/frame";
import type { SensorTable } from "../stream/sensor";
import { azimuthOf, pointOf } from "./point";

/** A return with all that is known of it. */
export interface Picked {
  /** Metres from the sensor, at the time of its frame: x forward, y left, z up. */
  point: Vector;
  /** Of its frame. */
  pose: Pose | null;
  frameIndex: number;
  intensity: number | null;
  ring: number;
  column: number;
  /** Degrees, clockwise. */
  azimuth: number;
  /** Made up between columns that were sent. */
  madeUp: boolean;
}

/** A place on the screen, and how near to it a return must be, all in normalised device coordinates. */
export interface Spot {
  x: number;
  y: number;
  reachX: number;
  reachY: number;
}

/** view: from metres to the screen, for each frame. Null if no return is near the spot. */
export function pick(shown: { frame: RangeFrame; view: Matrix }[], table: SensorTable, spot: Spot): Picked | null {
  let best: { frame: RangeFrame; ring: number; column: number; depth: number } | null = null;
  const point: Vector = [0, 0, 0];
  const seen: [number, number, number, number] = [0, 0, 0, 0];
  for (const { frame, view } of shown) {
    for (let ring = 0; ring < frame.rings; ring++) {
      for (let column = 0; column < frame.columns; column++) {
        if (frame.range[ring * frame.columns + column] === 0) continue;
        transformed(seen, view, pointOf(frame, table, ring, column, point));
        const [x, y, , depth] = seen;
        if (depth <= 0 || depth >= (best?.depth ?? Number.POSITIVE_INFINITY)) continue;
        const right = (x / depth - spot.x) / spot.reachX;
        const up = (y / depth - spot.y) / spot.reachY;
        if (right * right + up * up <= 1) best = { frame, ring, column, depth };
      }
    }
  }
  if (best === null) return null;
  const { frame, ring, column } = best;
  const cell = ring * frame.columns + column;
  return {
    point: pointOf(frame, table, ring, column, [0, 0, 0]),
    pose: frame.pose,
    frameIndex: frame.index,
    intensity: frame.intensity?.[cell] ?? null,
    ring,
    column,
    azimuth: (azimuthOf(frame, table, ring, column) * 180) / Math.PI,
    madeUp: frame.filled?.[cell] === 1,
  };
}
