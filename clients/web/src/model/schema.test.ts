import { expect, test } from "vitest";
import {
  codecsOfClouds,
  type Field,
  fieldOf,
  fieldsOf,
  hindranceOfCloud,
  isCloud,
  limitsOf,
  numberIn,
  same,
} from "./schema";
import type { Codec, Stream } from "./wire";

test("a schema gets the control that its values need", () => {
  expect(fieldOf({ type: "boolean" }).kind).toBe("switch");
  expect(fieldOf({ type: "integer", enum: [8, 12] })).toEqual({ kind: "choice", values: [8, 12], open: false });
  expect(fieldOf({ type: "string", examples: ["all", "voxel"] })).toEqual({
    kind: "choice",
    values: ["all", "voxel"],
    open: true,
  });
  expect(fieldOf({ anyOf: [{ type: "string" }, { type: "null" }] })).toEqual({ kind: "text", nullable: true });
  expect(fieldOf({ type: "integer", minimum: 1, maximum: 19 })).toMatchObject({ whole: true, minimum: 1, maximum: 19 });
});

const target = fieldOf({ anyOf: [{ type: "number" }, { const: "auto", type: "string" }, { type: "null" }] });

test("a number may be a word or nothing where the schema says so", () => {
  const field = target as Field & { kind: "number" };
  expect(numberIn("4000", field)).toBe(4000);
  expect(numberIn(" 0,05 ", field)).toBe(0.05);
  expect(numberIn("auto", field)).toBe("auto");
  expect(numberIn("", field)).toBe(null);
  expect(numberIn("fast", field)).toBe(undefined);
  expect(numberIn("", fieldOf({ type: "integer" }) as Field & { kind: "number" })).toBe(undefined);
});

test("limits are told in words", () => {
  expect(limitsOf(fieldOf({ type: "integer", minimum: 1, maximum: 100000 }))).toBe("1 to 100,000");
  expect(limitsOf(fieldOf({ anyOf: [{ type: "integer", minimum: 1 }, { type: "null" }] }))).toBe("1 or more");
  expect(limitsOf(target)).toBe("");
});

test("values are compared by what they hold", () => {
  expect(same({ level: 3 }, { level: 3 })).toBe(true);
  expect(same({ level: 3 }, { level: 3, more: null })).toBe(false);
  expect(same(null, {})).toBe(false);
});

test("a setting that is new is shown, and a codec has its own place", () => {
  const properties = { codec: {}, codec_settings: {}, target_kbps: {}, framing: { more: true }, brand_new: {} };
  expect(fieldsOf({ properties })).toEqual({ first: ["target_kbps", "brand_new"], more: ["framing"] });
  expect(fieldsOf(null)).toEqual({ first: [], more: [] });
});

const stream = (model: string) => ({ status: { sensor_model: { model } } }) as Stream;
const codec = (name: string, clouds: boolean) => ({ name, clouds }) as Codec;

test("streams of point clouds are known by their model", () => {
  expect([isCloud(stream("pointcloud2")), isCloud(stream("vlp16")), isCloud(null)]).toEqual([true, false, false]);
});

test("what the vehicle would refuse cannot be set, but what is set can be taken back", () => {
  expect(hindranceOfCloud("target_kbps", null, { free: null })).toMatch("cannot keep a target bitrate");
  expect(hindranceOfCloud("reduction", "auto", { free: "auto" })).toMatch("All points");
  expect(hindranceOfCloud("reduction", "voxel", { free: "auto" })).toBeUndefined();
  expect(hindranceOfCloud("target_kbps", 800, { free: null })).toBeUndefined();
  expect(hindranceOfCloud("max_error_m", null, { free: null })).toBeUndefined();
});

test("codecs that take no point clouds are not offered", () => {
  const all = [codec("pcodec", true), codec("jpeg", false)];
  expect(codecsOfClouds({ enum: ["auto", "pcodec", "jpeg"] }, all).enum).toEqual(["auto", "pcodec"]);
  expect(codecsOfClouds({ examples: ["auto", "jpeg"] }, all).examples).toEqual(["auto"]);
});
