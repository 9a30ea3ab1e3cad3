/** Polling: one request at a time, rarely while the page is hidden, and with a longer pause after a failure. */

export const HIDDEN_MS = 10_000;
const FAILED_MS = [1000, 1000, 2000, 4000];

/** Time until the next request. failures: number of consecutive failures */
export function waitOf(everyMs: number, failures: number, hidden: boolean): number {
  const wait = failures === 0 ? everyMs : (FAILED_MS[Math.min(failures, FAILED_MS.length) - 1] ?? everyMs);
  return hidden ? Math.max(wait, HIDDEN_MS) : wait;
}

export interface Poller {
  /** Ask at once. */
  now(): void;
  stop(): void;
}

/** Calls `ask` every so often until stopped; a rejection counts as a failure. */
export function poll(everyMs: number | (() => number), ask: () => Promise<void>): Poller {
  let timer: ReturnType<typeof setTimeout> | undefined;
  let failures = 0;
  let busy = false;
  let again = false;
  let stopped = false;

  async function run(): Promise<void> {
    if (stopped) return;
    if (busy) {
      again = true;
      return;
    }
    busy = true;
    clearTimeout(timer);
    try {
      await ask();
      failures = 0;
    } catch {
      failures += 1;
    }
    busy = false;
    if (stopped) return;
    const every = typeof everyMs === "number" ? everyMs : everyMs();
    const wait = again ? 0 : waitOf(every, failures, document.visibilityState === "hidden");
    again = false;
    timer = setTimeout(() => void run(), wait);
  }

  const seen = () => {
    if (document.visibilityState === "visible") void run();
  };
  document.addEventListener("visibilitychange", seen);
  void run();
  return {
    now: () => void run(),
    stop: () => {
      stopped = true;
      clearTimeout(timer);
      document.removeEventListener("visibilitychange", seen);
    },
  };
}
