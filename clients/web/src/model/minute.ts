/** The last minute of each stream's bitrate, for sparklines. The server sends it once; each later answer adds a value. */
import type { FleetRow } from "./wire";

export const LENGTH = 60;
export type Minutes = ReadonlyMap<string, readonly (number | null)[]>;

export function keyOf(stream: { vehicle: string; sensor: string }): string {
  return `${stream.vehicle}/${stream.sensor}`;
}

/** Whether a stream is new, so that its last minute must be requested. */
export function lacks(minutes: Minutes, rows: readonly FleetRow[]): boolean {
  return rows.some((row) => !minutes.has(keyOf(row)));
}

/** The minutes after another answer. Streams that are no longer in the list are removed. */
export function added(minutes: Minutes, rows: readonly FleetRow[]): Minutes {
  return new Map(
    rows.flatMap((row): [string, readonly (number | null)[]][] => {
      const key = keyOf(row);
      if (row.minute !== null) return [[key, row.minute]];
      const known = minutes.get(key);
      return known === undefined ? [] : [[key, [...known, row.kbps].slice(-LENGTH)]];
    }),
  );
}

/**
 * The path of a sparkline in a box, with gaps for unknown values. The top is the largest value or the target, whichever
 * is more, so that a line at its target does not look like one at its limit.
 */
export function path(values: readonly (number | null)[], width: number, height: number, target: number | null): string {
  const top = Math.max(1, target ?? 0, ...values.map((value) => value ?? 0)) * 1.08;
  const step = width / (LENGTH - 1);
  const first = LENGTH - values.length;
  let drawing = false;
  let text = "";
  values.forEach((value, index) => {
    if (value === null) {
      drawing = false;
      return;
    }
    const [x, y] = [(first + index) * step, height - (value / top) * height];
    text += `${drawing ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
    drawing = true;
  });
  return text;
}

/** Height of the target in the same box. */
export function targetLine(values: readonly (number | null)[], height: number, target: number): number {
  const top = Math.max(1, target, ...values.map((value) => value ?? 0)) * 1.08;
  return height - (target / top) * height;
}
