/** Values as text. A dash means unknown. */
import type { PathStatus } from "./wire";

export const NONE = "–";

/** Kilobits a second, without the unit. */
export function kbps(value: number | null | undefined): string {
  return count(value);
}

export function ms(value: number | null | undefined): string {
  if (value == null) return NONE;
  return value < 10 ? `${value.toFixed(1)} ms` : `${Math.round(value).toLocaleString("en")} ms`;
}

export function count(value: number | null | undefined): string {
  return value == null ? NONE : Math.round(value).toLocaleString("en");
}

export function bytes(value: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let size = value;
  let unit = 0;
  while (size >= 1000 && unit < units.length - 1) {
    size /= 1000;
    unit += 1;
  }
  return `${unit === 0 || size >= 100 ? Math.round(size) : size.toFixed(1)} ${units[unit]}`;
}

/** `4 s`, `3 min`, `2 h`, `5 d`. */
export function span(seconds: number): string {
  if (seconds < 90) return `${Math.floor(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 129_600) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86_400)} d`;
}

/** `0:42`, `1:02:03`: a position on a time line. */
export function clock(seconds: number): string {
  const whole = Math.max(0, Math.floor(seconds));
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const two = (value: number) => String(value).padStart(2, "0");
  return h > 0 ? `${h}:${two(m)}:${two(s)}` : `${m}:${two(s)}`;
}

/** A time in the reader's time zone; with the date if it is not today. */
export function moment(iso: string, now: Date = new Date()): string {
  const at = new Date(iso);
  const time = at.toLocaleTimeString("en-GB");
  return at.toDateString() === now.toDateString() ? time : `${at.toLocaleDateString("en-CA")} ${time}`;
}

/** A setting's value as text. */
export function plain(value: unknown): string {
  if (value === null || value === undefined) return NONE;
  if (typeof value === "object") {
    const entries = Object.entries(value);
    return entries.length === 0 ? "defaults" : entries.map(([name, one]) => `${name}=${plain(one)}`).join(", ");
  }
  return String(value);
}

/** A setting's name as a label: `max_error_m` is "Max error (m)". */
export function label(name: string): string {
  const units: Record<string, string> = { m: "m", kbps: "kbit/s", ms: "ms", s: "s" };
  const words = name.split("_");
  const unit = words.length > 1 ? units[words.at(-1) ?? ""] : undefined;
  const text = (unit === undefined ? words : words.slice(0, -1)).join(" ");
  return text.charAt(0).toUpperCase() + text.slice(1) + (unit === undefined ? "" : ` (${unit})`);
}

/** Settings as text: `purpose = look, target_kbps = 800`. */
export function listOf(settings: Record<string, unknown>): string {
  return Object.entries(settings)
    .map(([name, value]) => `${name} = ${value === null ? "not set" : plain(value)}`)
    .join(", ");
}

/** `2nd`, `3rd`, `4th`, as in "every 4th column". */
export function ordinal(value: number): string {
  const last = value % 100 > 10 && value % 100 < 14 ? 0 : value % 10;
  return `${value}${["th", "st", "nd", "rd"][last] ?? "th"}`;
}

/** What a path carries, in a sentence; nothing while it is not known. */
export function carried(path: PathStatus | undefined): string {
  const { capacity_kbps: burst, sustained_kbps: sustained } = path ?? {};
  if (sustained != null) return `The path carries ${kbps(sustained)} kbit/s for long; bursts pass at ${kbps(burst)}.`;
  return burst == null ? "" : `The path carries ${kbps(burst)} kbit/s.`;
}
