/** The sensor's pose between two frames, if frames have poses. So the world moves smoothly at the screen's rate while
 * clouds come ten times a second. */

import { headingOf, type Pose } from "./matrix";
import type { RangeFrame } from "./stream/frame";

/** After this time the pose is unknown. */
const LONGEST_S = 0.15;
const SMOOTH = 0.1;

export class Motion {
  /** The present pose of the sensor; null while unknown. */
  readonly pose: Pose = new Float64Array(12);
  known = false;
  readonly #last: Pose = new Float64Array(12);
  #stampMs = 0;
  #velocity: [number, number, number] = [0, 0, 0];
  #turning = 0;
  #delayMs = Number.NaN;
  #heading: number | null = null;

  /** A frame is shown at `now` (ms, any clock that runs on). */
  take(frame: RangeFrame, now: number): void {
    if (!frame.pose) {
      this.known = false;
      return;
    }
    const seconds = (frame.stampMs - this.#stampMs) / 1000;
    if (this.known && seconds > 0.005 && seconds < 1) {
      for (let axis = 0; axis < 3; axis++) {
        const way = (frame.pose[4 * axis + 3] as number) - (this.#last[4 * axis + 3] as number);
        this.#velocity[axis] = way / seconds;
      }
      const turned = headingOf(frame.pose) - headingOf(this.#last);
      this.#turning = (turned - 2 * Math.PI * Math.round(turned / (2 * Math.PI))) / seconds;
    } else {
      this.#velocity = [0, 0, 0];
      this.#turning = 0;
      this.#delayMs = Number.NaN;
    }
    this.known = true;
    this.#last.set(frame.pose);
    this.#stampMs = frame.stampMs;
    const delay = now - frame.stampMs;
    const known = Number.isFinite(this.#delayMs) && Math.abs(delay - this.#delayMs) < 1000;
    this.#delayMs = known ? this.#delayMs + SMOOTH * (delay - this.#delayMs) : delay;
    this.pose.set(frame.pose);
  }

  /** Extrapolate the motion of the last two frames. True while it is visible. */
  predict(now: number): boolean {
    if (!this.known) return false;
    const [vx, vy, vz] = this.#velocity;
    const seconds = Math.min(Math.max((now - this.#stampMs - this.#delayMs) / 1000, 0), LONGEST_S);
    const angle = this.#turning * seconds;
    const c = Math.cos(angle);
    const s = Math.sin(angle);
    for (let row = 0; row < 3; row++) {
      const a = this.#last[4 * row] as number;
      const b = this.#last[4 * row + 1] as number;
      this.pose[4 * row] = a * c + b * s;
      this.pose[4 * row + 1] = b * c - a * s;
      this.pose[4 * row + 2] = this.#last[4 * row + 2] as number;
    }
    this.pose[3] = (this.#last[3] as number) + vx * seconds;
    this.pose[7] = (this.#last[7] as number) + vy * seconds;
    this.pose[11] = (this.#last[11] as number) + vz * seconds;
    return seconds < LONGEST_S && Math.hypot(vx, vy) + Math.abs(this.#turning) > 0.1;
  }

  /** How far the vehicle has turned since it was seen first, radians; 0 while no poses are known. */
  turned(): number {
    if (!this.known) return 0;
    const heading = headingOf(this.pose);
    this.#heading ??= heading;
    return heading - this.#heading;
  }

  reset(): void {
    this.known = false;
    this.#delayMs = Number.NaN;
    this.#heading = null;
  }
}
