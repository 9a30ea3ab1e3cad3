/** The ruler: up to two returns that were picked, where they are now, and what lies between them. */
import { between, identity, type Matrix, type Pose, transformed, type Vector } from "../matrix";
import type { Picked } from "./pick";

export interface Between {
  /** Metres: straight, over the ground, and up. */
  distance: number;
  flat: number;
  up: number;
  /** The two returns are of two frames without poses: if the vehicle moved between them, the figures are wrong. */
  uncertain: boolean;
}

export class Ruler {
  readonly picked: Picked[] = [];
  readonly #place = identity();

  /** Take one more return. After two, a new measurement begins with it. */
  take(one: Picked): void {
    if (this.picked.length === 2) this.picked.length = 0;
    this.picked.push(one);
  }

  clear(): void {
    this.picked.length = 0;
  }

  /** Where a return is, from a sensor that stands at `pose`: it stays where it was while the vehicle drives. */
  placed({ point, pose: then }: Picked, pose: Pose | null, out: Vector = [0, 0, 0]): Vector {
    const [x, y, z] = point;
    out[0] = x;
    out[1] = y;
    out[2] = z;
    if (!then || !pose) return out;
    const moved: [number, number, number, number] = [0, 0, 0, 0];
    transformed(moved, between(this.#place, pose, then), point);
    [out[0], out[1], out[2]] = moved;
    return out;
  }

  /** Null before two returns were picked. */
  get between(): Between | null {
    const [a, b] = this.picked;
    if (!a || !b) return null;
    const [x, y, z] = this.placed(a, b.pose);
    const [dx, dy, up] = [b.point[0] - x, b.point[1] - y, b.point[2] - z];
    const uncertain = a.frameIndex !== b.frameIndex && !(a.pose && b.pose);
    return { distance: Math.hypot(dx, dy, up), flat: Math.hypot(dx, dy), up, uncertain };
  }
}

/** Where a point is on the screen, in normalised device coordinates; null behind the camera. */
export function onScreen(view: Matrix, point: Vector): [number, number] | null {
  const seen: [number, number, number, number] = [0, 0, 0, 0];
  transformed(seen, view, point);
  return seen[3] > 0 ? [seen[0] / seen[3], seen[1] / seen[3]] : null;
}
