/** How long to wait before a socket is opened again: longer each time, up to ten seconds, and never all at once. */

const WAITS_MS = [500, 1000, 2000, 5000, 10000] as const;
const SPREAD = 0.2;

export class Backoff {
  #failures = 0;

  /** Milliseconds until the next try. chance: 0..1, spreads those who lost the same server. */
  next(chance: number): number {
    const wait = WAITS_MS[Math.min(this.#failures, WAITS_MS.length - 1)] as number;
    this.#failures++;
    return wait * (1 + SPREAD * (2 * chance - 1));
  }

  /** It worked. */
  reset(): void {
    this.#failures = 0;
  }
}
