/** What a user would lose: an error where points of another sensor cannot be computed, and no exception of another kind. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Decoder, type ImageFrame, imagePointsOf, isImageFrame } from "../src/index.js";
import { otherVectors } from "./vectors.js";

async function frameOf(fits: RegExp): Promise<ImageFrame> {
  const decoder = await Decoder.create();
  const frame = decoder.decode(otherVectors(fits)[0]!.messages[0]!);
  assert.ok(isImageFrame(frame));
  return frame;
}

const REFUSED = { name: "DecodeError" };

test("a model that is not known, and an Ouster with metadata that says nothing, are errors", async () => {
  const vlp16 = await frameOf(/^raw_vlp16/);
  assert.throws(() => imagePointsOf({ ...vlp16, sensor: { ...vlp16.sensor, model: "toString" } }), REFUSED);
  const os1 = await frameOf(/^zstd_os1-128/);
  const texts = ["", "{", "[]", "{}", '{"beam_altitude_angles": [1e999]}', '{"beam_intrinsics": 3, "lidar_mode": {}}'];
  for (const text of texts) {
    const description = new TextEncoder().encode(text);
    assert.throws(() => imagePointsOf({ ...os1, sensor: { ...os1.sensor, description } }), REFUSED);
  }
});

test("series that do not fit the planes are errors", async () => {
  for (const fits of [/^raw_vlp16/, /^zstd_vls128/, /^zstd_pandar64/, /^zstd_os1-128/]) {
    const frame = await frameOf(fits);
    for (const series of [new Map(), new Map([...frame.rest.series].map(([name]) => [name, new BigUint64Array(1)]))])
      assert.throws(() => imagePointsOf({ ...frame, rest: { ...frame.rest, series } }), REFUSED);
  }
});

test("first returns alone are the first part of both", async () => {
  const frame = await frameOf(/^zstd_pandar64/);
  const [first, both] = [imagePointsOf(frame), imagePointsOf(frame, true)];
  assert.equal(first.count, frame.returns);
  assert.deepEqual(both.xyz.subarray(0, first.xyz.length), first.xyz);
  assert.ok(both.returnNumber.subarray(first.count).every((one) => one === 2));
});
