/** The return under the pointer: of those near it on the screen, the one nearest to the camera. */
import { type Matrix, type Pose, transformed, type Vector } from "../matrix";
import type { RangeFrame } from "../stream/frame";
import type { SensorTable } from "../stream/sensor";
import { azimuthOf, pointOf } from "./point";

/** A return with all that is known of it. */
export interface Picked {
  /** The other stream that it is of; null for the chosen one. */
  stream: string | null;
  /** Metres from the sensor of the chosen stream, at the time of the frame: x forward, y left, z up. */
  point: Vector;
  /** Of that sensor. */
  pose: Pose | null;
  /** Metres from its own sensor. */
  distance: number;
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

/** A frame in the picture. view: from metres at its sensor to the screen. place, pose: of another stream, to the sensor of
 * the chosen one, which stands at that pose */
export interface Seen {
  frame: RangeFrame;
  table: SensorTable;
  view: Matrix;
  stream?: { name: string; place: Matrix; pose: Pose | null };
}

/** Null if no return is near the spot. box: whether a point, in metres at the chosen sensor, is drawn at all */
export function pick(shown: Seen[], spot: Spot, box: (point: Vector) => boolean = () => true): Picked | null {
  let best: { seen: Seen; ring: number; column: number; depth: number } | null = null;
  const point: Vector = [0, 0, 0];
  const seen: [number, number, number, number] = [0, 0, 0, 0];
  for (const one of shown) {
    const { frame, table, view } = one;
    for (let ring = 0; ring < frame.rings; ring++) {
      for (let column = 0; column < frame.columns; column++) {
        if (frame.range[ring * frame.columns + column] === 0) continue;
        transformed(seen, view, pointOf(frame, table, ring, column, point));
        const [x, y, , depth] = seen;
        if (depth <= 0 || depth >= (best?.depth ?? Number.POSITIVE_INFINITY)) continue;
        const right = (x / depth - spot.x) / spot.reachX;
        const up = (y / depth - spot.y) / spot.reachY;
        if (right * right + up * up <= 1 && box(placed(one, point))) best = { seen: one, ring, column, depth };
      }
    }
  }
  if (best === null) return null;
  const { ring, column } = best;
  const { frame, table, stream } = best.seen;
  const own = pointOf(frame, table, ring, column, [0, 0, 0]);
  const cell = ring * frame.columns + column;
  return {
    stream: stream?.name ?? null,
    point: placed(best.seen, own),
    pose: stream ? stream.pose : frame.pose,
    distance: Math.hypot(...own),
    frameIndex: frame.index,
    intensity: frame.intensity?.[cell] ?? null,
    ring,
    column,
    azimuth: (azimuthOf(frame, table, ring, column) * 180) / Math.PI,
    madeUp: frame.filled?.[cell] === 1,
  };
}

/** A point of a frame, in metres at the sensor of the chosen stream. */
function placed({ stream }: Seen, point: Vector): Vector {
  if (!stream) return point;
  const out: [number, number, number, number] = [0, 0, 0, 0];
  transformed(out, stream.place, point);
  return [out[0], out[1], out[2]];
}
