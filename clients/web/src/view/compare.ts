/** Errors of decoded ranges relative to the original ranges. */
import type { RangeFrame } from "./stream/frame";

export interface Comparison {
  /** Returns that are in both. */
  returns: number;
  rmse_mm: number;
  max_mm: number;
  /** Share of `returns` with a different range, 0..1. */
  changed: number;
  /** Original returns that were not sent or lost; some of them may be interpolated. */
  dropped: number;
  /** Returns that the original does not have. */
  invented: number;
}

/** Errors along the ray, over returns in both frames, without interpolated ones; null if there is no original. 0.2 ms for
 * a turn. */
export function compared(
  frame: Pick<RangeFrame, "range" | "original" | "rangeStepM"> & Partial<Pick<RangeFrame, "filled">>,
): Comparison | null {
  const { range, original, filled } = frame;
  if (!original) return null;
  let returns = 0;
  let changed = 0;
  let dropped = 0;
  let invented = 0;
  let squares = 0;
  let most = 0;
  for (let cell = 0; cell < range.length; cell++) {
    const decoded = filled?.[cell] ? 0 : (range[cell] as number);
    const before = original[cell] as number;
    if (decoded !== 0 && before !== 0) {
      returns++;
      if (decoded !== before) {
        const error = decoded > before ? decoded - before : before - decoded;
        changed++;
        squares += error * error;
        if (error > most) most = error;
      }
    } else if (before !== 0) dropped++;
    else if (decoded !== 0) invented++;
  }
  const step = 1000 * frame.rangeStepM;
  const some = Math.max(returns, 1);
  return {
    returns,
    rmse_mm: step * Math.sqrt(squares / some),
    max_mm: step * most,
    changed: changed / some,
    dropped,
    invented,
  };
}

/** The sensor's accuracy: smaller errors are not highlighted. */
const SCALES_MM = [20, 40, 100, 200, 400, 1000, 2000, 4000, 10000, 20000, 40000, 100000, 200000] as const;
const PATIENCE = 20;

/** The error at the end of the colour scale: it increases at once for a larger error, and decreases after a while.
 *
 * It is the largest error, or three times the RMSE if a few errors are so large that all others would look alike. */
export class ErrorScale {
  mm: number = SCALES_MM[0];
  #calm = 0;

  take({ max_mm, rmse_mm }: Pick<Comparison, "max_mm" | "rmse_mm">): boolean {
    return this.update(Math.min(max_mm, 3 * rmse_mm));
  }

  /** True if it has changed. */
  update(max_mm: number): boolean {
    const wanted = SCALES_MM.find((scale) => scale >= max_mm - 1e-6) ?? 200000;
    this.#calm = wanted < this.mm ? this.#calm + 1 : 0;
    if (wanted <= this.mm && this.#calm < PATIENCE) return false;
    this.#calm = 0;
    const changed = wanted !== this.mm;
    this.mm = wanted;
    return changed;
  }
}

/** How long a comparison stays without a new original. */
const PATIENCE_MS = 3000;
const WAIT_FOR_ORIGINALS_MS = 3000;

/** The comparison that a view shows, frame by frame. Times are of one clock that runs on. */
export class Comparing {
  /** Of the last frame; null if it is not compared. */
  now: Comparison | null = null;
  readonly scale = new ErrorScale();
  #pairedAt = 0;
  #opened = 0;

  opened(now: number): void {
    this.#opened = now;
  }

  /** Whether to show this frame: without its original the picture would jump between two views and one. */
  passes(frame: RangeFrame, now: number): boolean {
    if (this.now && !frame.original && now - this.#pairedAt < PATIENCE_MS) return false;
    if (frame.original) this.#pairedAt = now;
    return true;
  }

  /** Compare this frame; null if none is to be compared. */
  take(frame: RangeFrame | null): void {
    this.now = frame && compared(frame);
    if (this.now) this.scale.take(this.now);
  }

  /** Whether frames come, but no original with them. */
  lacksOriginals(now: number): boolean {
    return !this.now && now - this.#opened > WAIT_FOR_ORIGINALS_MS;
  }
}

/** Millimetres for people: `0.84 mm`, `12 mm`, `1.3 m`. */
export function millimetres(value: number): string {
  if (value >= 1000) return `${(value / 1000).toFixed(1)} m`;
  if (value === 0) return "0 mm";
  return value < 10 ? `${value.toFixed(2).replace(/\.?0+$/, "")} mm` : `${value.toFixed(0)} mm`;
}
