/** Counts of frames and pictures, for the page. */

import type { ViewStats } from "../types";
import type { RangeFrame } from "./frame";

const WINDOW_MS = 1000;
const STALE_MS = 2000;
const SLOTS = 256;

/** Times within the last second, without allocations. */
class Rate {
  readonly #times = new Float64Array(SLOTS).fill(Number.NEGATIVE_INFINITY);
  #next = 0;

  add(now: number): void {
    this.#times[this.#next] = now;
    this.#next = (this.#next + 1) % SLOTS;
  }

  count(now: number): number {
    let found = 0;
    for (const time of this.#times) if (now - time < WINDOW_MS) found++;
    return found;
  }
}

export class Tally {
  /** Frames shown, and pictures drawn, since the view was made. */
  frames = 0;
  pictures = 0;
  #points = 0;
  #madeUp = 0;
  #index: number | null = null;
  #ageMs: number | null = null;
  #at = 0;
  readonly #frames = new Rate();
  readonly #pictures = new Rate();

  /** A frame is shown; hostNow: milliseconds since 1970 by the clock of the decoding machine. */
  shown(frame: RangeFrame, { points, madeUp }: { points: number; madeUp: number }, now: number, hostNow: number): void {
    this.#points = points;
    this.#madeUp = madeUp;
    this.#index = frame.index;
    this.#at = now;
    this.#ageMs = Number.isFinite(frame.latencyMs) ? frame.latencyMs + Math.max(hostNow - frame.decodedMs, 0) : null;
    this.#frames.add(now);
    this.frames++;
  }

  drawn(now: number): void {
    this.#pictures.add(now);
    this.pictures++;
  }

  reset(): void {
    this.#points = this.#madeUp = 0;
    this.#index = this.#ageMs = null;
  }

  stats(
    now: number,
  ): Pick<ViewStats, "points" | "madeUp" | "fps" | "drawn" | "age_ms" | "frameIndex" | "stale" | "silent_s"> {
    const silentMs = this.#index === null ? null : Math.max(now - this.#at, 0);
    return {
      points: this.#points,
      madeUp: this.#madeUp,
      fps: this.#frames.count(now),
      drawn: this.#pictures.count(now),
      age_ms: this.#ageMs,
      frameIndex: this.#index,
      stale: silentMs !== null && silentMs > STALE_MS,
      silent_s: silentMs === null ? null : silentMs / 1000,
    };
  }
}
