/** What a user would lose: the very messages of a driver, and no exception of another kind for damaged ones. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { CloudMessage, cloudPointsOf, Decoder, DecodeError, type ImageFrame, isImageFrame } from "../src/index.js";
import { crc32c } from "../src/crc32c.js";
import { numbers } from "./numbers.js";
import { cloudVectors, digest, type ExpectedCloud } from "./vectors.js";

const TYPES = ["", "i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"];
const OURS = cloudVectors(/^(raw|zstd)/);

function decoded(decoder: Decoder, message: Uint8Array): ImageFrame {
  const frame = decoder.decode(message);
  assert.ok(isImageFrame(frame));
  return frame;
}

function check(frame: ImageFrame, expected: ExpectedCloud): void {
  const { sensor, cloud } = frame;
  assert.ok(cloud);
  const message = CloudMessage.of(cloud.payload);
  const fields = message?.head.fields ?? [];
  assert.deepEqual(
    {
      stream: `${frame.streamId}`,
      index: `${frame.index}`,
      stamp_ns: `${frame.stampNs}`,
      sensor: [sensor.name, sensor.hash, sensor.convention, sensor.rangeStep],
      rows: frame.rows,
      message: digest(cloud.payload),
      bytes: cloud.payload.length,
      fields: fields.map(({ name, type, count }) => [name, TYPES[type], count]),
      returns: frame.returns,
    },
    omit(expected),
  );
  assert.deepEqual([frame.width, frame.planes.length, sensor.model], [0, 0, "pointcloud2"]);
  const points = cloudPointsOf(cloud.payload);
  assert.throws(() => points.values("no such field"), RangeError);
  assert.equal(points.count, expected.returns);
  const shown = points.count ? [0, points.count >> 1, points.count - 1] : [];
  shown.forEach((at, i) => assert.deepEqual([...points.xyz.subarray(3 * at, 3 * at + 3)], expected.points[i]));
  for (const name of points.names) {
    const values = points.values(name);
    assert.equal(values.length, points.count);
    const field = fields.find((one) => one.name === name)!;
    const all = message!.values(field);
    assert.deepEqual([...values], [...points.place].map((place) => all[place]));
  }
}

function omit({ points: _, shown: __, ...rest }: ExpectedCloud): Omit<ExpectedCloud, "points" | "shown"> {
  return rest;
}

test("there are vectors of point clouds of both codecs", () => {
  assert.ok(OURS.length >= 3);
});

for (const { name, messages, expected } of OURS)
  test(`point clouds of ${name} come out as from the Python decoder`, async () => {
    const decoder = await Decoder.create();
    messages.forEach((message, i) => check(decoded(decoder, message), expected[i]!));
  });

test("damaged clouds end with a DecodeError, and the next message is decoded", async () => {
  const { messages, expected } = cloudVectors(/^zstd$/)[0]!;
  const decoder = await Decoder.create();
  const random = numbers(9);
  let refused = 0;
  for (let number = 0; number < 600; number++) {
    const which = number % messages.length;
    const data = messages[which]!.slice();
    const at = 56 + random(data.length - 60);
    if (number % 3) data[at] = data[at]! ^ (1 << random(8));
    else data.copyWithin(at, at + 1);
    new DataView(data.buffer).setUint32(data.length - 4, crc32c(data.subarray(0, -4)), true);
    try {
      const frame = decoder.decode(data);
      if (isImageFrame(frame) && frame.cloud) cloudPointsOf(frame.cloud.payload);
    } catch (error) {
      assert.ok(error instanceof DecodeError, String(error));
      refused++;
    }
    if (number % 50 === 0) check(decoded(decoder, messages[which]!), expected[which]!);
  }
  assert.ok(refused > 100);
});
