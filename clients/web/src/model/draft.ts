/**
 * A draft of settings: an operator's edits on top of the wanted or present settings. Edits stay when somebody else
 * changes the stream; edits that are in force now disappear.
 */
import { same } from "./schema";
import type { Codec, Schema, Settings, SettingsState, Value } from "./wire";

/** Initial values of a form: the wanted settings, otherwise those in force, otherwise the last reported ones. */
export function baseOf(state: SettingsState | null, told: Settings | null): Settings {
  return state?.desired ?? state?.applied ?? told ?? {};
}

/** A value with the draft's edits on top of the base. */
export function shown(base: Settings, edits: Settings, name: string): Value {
  return name in edits ? (edits[name] as Value) : (base[name] ?? null);
}

/** Settings of the codec that would be sent; if the draft has another codec, none of the base's. */
function own(base: Settings, edits: Settings): Settings {
  const kept = "codec" in edits && edits.codec !== base.codec ? {} : base.codec_settings;
  const all = { ...((kept ?? {}) as Settings), ...((edits.codec_settings ?? {}) as Settings) };
  return Object.fromEntries(Object.entries(all).filter(([, value]) => value !== undefined));
}

/** Whether a setting is kept beside a target bitrate, or left to it; null for one that a target never moves. */
export function pinnedIn(schema: Schema | null, name: string, value: Value): boolean | null {
  const about = schema?.properties?.[name];
  return about === undefined || about.free === undefined ? null : !same(value, about.free);
}

/** Whether the draft has the codec's own setting set. */
export function ownSet(base: Settings, edits: Settings, name: string): boolean {
  return name in own(base, edits);
}

/** Settings of the codec after the change. A new codec starts with its defaults. */
export function ownSettings(base: Settings, edits: Settings, schema: Schema | undefined): Settings {
  const defaults = Object.fromEntries(
    Object.entries(schema?.properties ?? {}).map(([name, about]) => [name, about.default ?? null]),
  );
  return { ...defaults, ...own(base, edits) };
}

/** Edits with one more. An edit back to the base is removed. Another codec removes edits of the old codec's settings. */
export function edited(
  base: Settings,
  edits: Settings,
  name: string,
  value: Value,
  codecs: Codec[],
  schema: Schema | null = null,
): Settings {
  const next: Settings = { ...edits, [name]: value };
  if (name === "reduction" && !budgeted(schema, value)) {
    for (const budget of ["keep_points", "keep_fraction"]) if (shown(base, next, budget) !== null) next[budget] = null;
  }
  if (name === "codec") {
    delete next.codec_settings;
    const about = codecs.find((one) => one.name === value);
    // The server would refuse the whole change if the new codec refuses one setting.
    if (about && !about.bound && shown(base, next, "max_error_m") !== null) next.max_error_m = null;
    if (about && !about.target && shown(base, next, "target_kbps") !== null) next.target_kbps = null;
    if (about?.bound && next.max_error_m === null && "max_error_m" in edits) delete next.max_error_m;
    if (about?.target && next.target_kbps === null && "target_kbps" in edits) delete next.target_kbps;
  }
  if (name === "keep_points" && value !== null && shown(base, next, "keep_fraction") !== null)
    next.keep_fraction = null;
  if (name === "keep_fraction" && value !== null && shown(base, next, "keep_points") !== null) next.keep_points = null;
  return settled(base, next);
}

/** Edits with a change of a codec's own setting. undefined: it is no longer set. */
export function editedOwn(base: Settings, edits: Settings, name: string, value: Value | undefined): Settings {
  const all = { ...((edits.codec_settings ?? {}) as Settings), [name]: value } as Settings;
  return settled(base, { ...edits, codec_settings: all });
}

/** Edits with all settings of a preset. */
export function preset(
  base: Settings,
  edits: Settings,
  wanted: Settings,
  codecs: Codec[],
  schema: Schema | null = null,
): Settings {
  let next = edits;
  for (const [name, value] of Object.entries(wanted)) next = edited(base, next, name, value, codecs, schema);
  return next;
}

/** Edits without those that equal the base. */
export function settled(base: Settings, edits: Settings): Settings {
  const kept: Settings = {};
  for (const [name, value] of Object.entries(edits)) {
    if (name === "codec_settings") {
      if ("codec" in edits && edits.codec !== base.codec) kept[name] = value;
      else {
        const before = (base.codec_settings ?? {}) as Settings;
        const changed = Object.entries(value as Settings).filter(([key, one]) => !same(before[key], one));
        if (changed.length > 0) kept[name] = Object.fromEntries(changed);
      }
    } else if (!same(base[name] ?? null, value)) kept[name] = value;
  }
  return kept;
}

/** The body of the request: the edits, with all settings of the codec, because they replace the earlier ones. */
export function changeOf(base: Settings, edits: Settings): Settings {
  return edits.codec_settings ? { ...edits, codec_settings: own(base, edits) } : { ...edits };
}

/** Whether a reduction has a budget (`keep_points`, `keep_fraction`). */
export function budgeted(schema: Schema | null, reduction: Value): boolean {
  const names = schema?.properties?.reduction?.budgeted ?? [];
  return typeof reduction === "string" && names.includes(reduction.split(":")[0] ?? "");
}

/** What changed between two settings, for people: `codec: pcodec → jxl`. */
export function differences(old: Settings | null, now: Settings): [string, Value | undefined, Value][] {
  return Object.entries(now)
    .filter(([name, value]) => old === null || !same(old[name], value))
    .map(([name, value]) => [name, old?.[name], value]);
}
