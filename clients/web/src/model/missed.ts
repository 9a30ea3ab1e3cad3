/** What is wrong with a stream, such as a missed target bitrate: the notice over the picture, and the change that frees
 * the settings that prevent the target. */
import { label } from "./format";
import type { Schema, Settings, TargetWarning, Value } from "./wire";

const STEADY_MS = 3000;
/** Problems that follow from the settings alone, so that they are shown at once. */
const EXPECTED = "target_out_of_reach";
export const TWO = "two_publishers";

const HEADS: Record<string, string> = {
  target_missed: "Target missed",
  frames_left_out: "Frames are left out",
  columns_left_out: "Most columns are left out",
  target_out_of_reach: "Target out of reach",
  [TWO]: "Two publishers have one name",
};

/** Decides what to show of the server's warnings, which come every second. Short problems are not shown, and short
 * recoveries do not remove a notice. */
export class Steady {
  #shown: TargetWarning | null = null;
  #changesAt: number | null = null;

  /** told: the warning, null without one;  nowMs: time of any clock */
  take(told: TargetWarning | null, nowMs: number): TargetWarning | null {
    if (told !== null && (this.#shown !== null || told.code === EXPECTED)) {
      this.#shown = told;
      this.#changesAt = null;
    } else if (told === null && this.#shown === null) {
      this.#changesAt = null;
    } else {
      this.#changesAt ??= nowMs + STEADY_MS;
      if (nowMs >= this.#changesAt) {
        this.#shown = told;
        this.#changesAt = null;
      }
    }
    return this.#shown;
  }
}

/** The headline, which stays the same for the same problem. */
export function headOf({ code, settings }: TargetWarning): string {
  const head = HEADS[code] ?? "Target not kept";
  if (settings.length === 0) return head;
  const names = settings.map((name) => label(name.replace("codec_settings.", "")));
  const last = names.pop();
  const listed = names.length === 0 ? last : `${names.join(", ")} and ${last}`;
  return `${head}: ${listed} ${settings.length === 1 ? "is" : "are"} in the way`;
}

/** A text with a capital first letter. */
export function sentence(text: string): string {
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}`;
}

/** The change that leaves these settings to the target: as they are by default. */
export function freed(names: string[], settings: Settings, schema: Schema | null): Settings {
  const change: Settings = {};
  for (const name of names) {
    const own = /^codec_settings\.(.*)$/.exec(name)?.[1];
    if (own === undefined) change[name] = schema?.properties?.[name]?.default ?? null;
    else {
      const before = (change.codec_settings ?? settings.codec_settings ?? {}) as Record<string, Value>;
      change.codec_settings = Object.fromEntries(Object.entries(before).filter(([key]) => key !== own));
    }
  }
  if ("reduction" in change) {
    for (const budget of ["keep_points", "keep_fraction"]) if (settings[budget] != null) change[budget] = null;
  }
  return change;
}
