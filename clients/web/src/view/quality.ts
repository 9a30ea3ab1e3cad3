/** Drawing quality, reduced so that the picture moves smoothly even without a graphics card. */

/** If the browser asks for the next picture later than this, the last one was too slow. */
const SLOW_MS = 45;
const VERY_SLOW_MS = 200;
const ENOUGH = 10;

/** 2: everything;  1: without shaded edges;  0: and one pixel for four of a fine screen. */
export class Quality {
  level: 0 | 1 | 2 = 2;
  #slow = 0;

  /** Report the time of a picture. True if the quality is reduced from now on. */
  took(ms: number): boolean {
    if (ms > SLOW_MS) this.#slow += ms > VERY_SLOW_MS ? 4 : 1;
    else this.#slow = Math.max(this.#slow - 2, 0);
    if (this.#slow < ENOUGH || this.level === 0) return false;
    this.#slow = 0;
    this.level = this.level === 2 ? 1 : 0;
    return true;
  }

  /** Device pixels of a CSS pixel that are drawn. */
  ratio(screen: number): number {
    return Math.min(screen, this.level === 0 ? Math.max(screen / 2, 1) : 2);
  }
}
