/** Wait before a socket is reopened: longer each time, up to ten seconds, with a random part. */

const WAITS_MS = [500, 1000, 2000, 5000, 10000] as const;
const SPREAD = 0.2;

export class Backoff {
  #failures = 0;

  /** Milliseconds until the next try. chance: random, 0..1, so that many clients do not return at the same moment. */
  next(chance: number): number {
    const wait = WAITS_MS[Math.min(this.#failures, WAITS_MS.length - 1)] as number;
    this.#failures++;
    return wait * (1 + SPREAD * (2 * chance - 1));
  }

  /** A try succeeded. */
  reset(): void {
    this.#failures = 0;
  }
}
