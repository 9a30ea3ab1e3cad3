import { describe, expect, test } from "vitest";
import {
  baseOf,
  changeOf,
  differences,
  edited,
  editedOwn,
  ownSet,
  ownSettings,
  pinnedIn,
  preset,
  settled,
  shown,
} from "./draft";
import type { Codec, Schema, Settings } from "./wire";

const codec = (name: string, bound: boolean, target: boolean): Codec => ({
  name,
  bound,
  target,
  clouds: false,
  settings_schema: {},
  reach: null,
});
const codecs = [codec("pcodec", true, true), codec("jpeg", false, true), codec("raw", true, false)];
const base: Settings = {
  codec: "pcodec",
  codec_settings: { level: 9 },
  max_error_m: 0.01,
  target_kbps: null,
  reduction: "voxel",
  keep_points: 5000,
  keep_fraction: null,
};
const schema: Schema = { properties: { reduction: { budgeted: ["voxel"] } } };

test("a form begins with what operators want, else with what is in force, else with what was told", () => {
  expect(baseOf({ applied: { a: 1 }, desired: { a: 2 }, operator: {}, refused: null }, { a: 3 })).toEqual({ a: 2 });
  expect(baseOf({ applied: { a: 1 }, desired: null, operator: {}, refused: null }, { a: 3 })).toEqual({ a: 1 });
  expect(baseOf(null, { a: 3 })).toEqual({ a: 3 });
});

test("an edit back to what was is no edit", () => {
  const one = edited(base, {}, "target_kbps", 4000, codecs);
  expect(one).toEqual({ target_kbps: 4000 });
  expect(edited(base, one, "target_kbps", null, codecs)).toEqual({});
});

test("a codec that keeps no bound takes the bound away, and one that does gives it back", () => {
  const jpeg = edited(base, {}, "codec", "jpeg", codecs);
  expect(jpeg).toEqual({ codec: "jpeg", max_error_m: null });
  expect(edited(base, jpeg, "codec", "pcodec", codecs)).toEqual({});
});

test("a codec that cannot be steered takes the target away", () => {
  const steered = { ...base, target_kbps: 4000 };
  expect(edited(steered, {}, "codec", "raw", codecs)).toEqual({ codec: "raw", target_kbps: null });
});

test("a reduction without a budget takes the budget away", () => {
  expect(edited(base, {}, "reduction", "all", codecs, schema)).toEqual({ reduction: "all", keep_points: null });
  expect(edited(base, {}, "keep_fraction", 0.1, codecs, schema)).toEqual({ keep_fraction: 0.1, keep_points: null });
});

test("the codec's own settings are sent whole, because they replace those before", () => {
  const edits = editedOwn(base, {}, "mask_history", true);
  expect(edits).toEqual({ codec_settings: { mask_history: true } });
  expect(changeOf(base, edits)).toEqual({ codec_settings: { level: 9, mask_history: true } });
  expect(editedOwn(base, edits, "level", 9)).toEqual(edits);
});

test("another codec starts with its own defaults, and its edits go with it", () => {
  const own: Schema = { properties: { quality: { default: 90 } } };
  const jpeg = edited(base, editedOwn(base, {}, "level", 3), "codec", "jpeg", codecs);
  expect(ownSettings(base, jpeg, own)).toEqual({ quality: 90 });
  const finer = editedOwn(base, jpeg, "quality", 95);
  expect(changeOf(base, finer)).toMatchObject({ codec: "jpeg", codec_settings: { quality: 95 } });
});

test("edits that came true by somebody else vanish, others stay", () => {
  expect(settled({ ...base, target_kbps: 4000 }, { target_kbps: 4000, reduction: "all" })).toEqual({
    reduction: "all",
  });
  expect(shown(base, { reduction: "all" }, "reduction")).toBe("all");
});

test("an audit entry shows what changed, not all that is", () => {
  expect(differences(base, { ...base, codec: "jpeg" })).toEqual([["codec", "pcodec", "jpeg"]]);
});

describe("what a target moves, and what is pinned beside it", () => {
  const schema = { properties: { intensity: { free: "auto" }, max_error_m: { free: null }, framing: {} } };

  test("tells lossless from not set", () => {
    expect(pinnedIn(schema, "intensity", "auto")).toBe(false);
    expect(pinnedIn(schema, "intensity", "lossless")).toBe(true);
    expect(pinnedIn(schema, "max_error_m", null)).toBe(false);
    expect(pinnedIn(schema, "max_error_m", 0)).toBe(true);
    expect(pinnedIn(schema, "framing", "packets")).toBeNull();
  });

  test("a codec's own setting is set once it was, until it is taken out again", () => {
    const base = { codec: "jpeg", codec_settings: { quality: 90, effort: 1 } };
    const unset = editedOwn(base, {}, "quality", undefined);
    expect([ownSet(base, {}, "quality"), ownSet(base, unset, "quality")]).toEqual([true, false]);
    expect(changeOf(base, unset)).toEqual({ codec_settings: { effort: 1 } });
    expect(ownSettings(base, unset, { properties: { quality: { default: 75 } } })).toEqual({ quality: 75, effort: 1 });
    expect(editedOwn({ codec: "jpeg" }, {}, "quality", undefined)).toEqual({});
    expect(ownSet(base, { codec: "h264" }, "quality")).toBe(false);
  });

  test("a preset edits its own settings and leaves all others as they are", () => {
    const base = { codec: "riddle", purpose: "look", target_kbps: null, intensity: "lossless", max_error_m: 0.02 };
    const wanted = { purpose: "look", codec: "auto", target_kbps: 800 };
    expect(preset(base, {}, wanted, [])).toEqual({ codec: "auto", target_kbps: 800 });
    expect(preset(base, { intensity: "off" }, wanted, [])).toEqual({
      intensity: "off",
      codec: "auto",
      target_kbps: 800,
    });
  });
});
