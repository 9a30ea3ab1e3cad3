/** What a viewer in Foxglove would lose: points as they are, no false picture after a jump, and the reason where there is none. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { LogLevel, NumericType, type PointCloud } from "@foxglove/schemas";
import { crc32c } from "../../typescript/src/crc32c.js";
import { numbers } from "../../typescript/test/numbers.js";
import { cloudVectors, type Expected, otherVectors, type Vector, vectors } from "../../typescript/test/vectors.js";
import { quaternionOf } from "../src/cloud.js";
import { type Converted, coded, loaded } from "./extension.js";

const DECODED = /^(golden_v1_)?(raw|zstd|pcodec|predictive|riddle)/;
/** Vectors whose names fit this are decoded; without it all of them are. */
const WANTED = new RegExp(process.env.LIDARCODEC_VECTORS ?? "");
const ONE = await loaded();
const vector = (name: string): Vector => vectors(new RegExp(`^${name}$`))[0]!;

function numbersOf(cloud: PointCloud, at: number): number[] {
  const view = new DataView(cloud.data.buffer, cloud.data.byteOffset + at * cloud.point_stride);
  return cloud.fields.map(({ offset, type }) =>
    type === NumericType.FLOAT32 ? view.getFloat32(offset, true) : view.getUint8(offset),
  );
}

function check(cloud: PointCloud | undefined, { returns, points }: Expected): void {
  assert.ok(cloud);
  assert.deepEqual([cloud.timestamp, cloud.frame_id], [{ sec: 7, nsec: 9 }, "car-7/roof"]);
  assert.equal(cloud.data.length, returns * cloud.point_stride);
  const shown = returns ? [0, returns >> 1, returns - 1] : [];
  shown.forEach((at, i) => {
    const [x, y, z, intensity, ring] = numbersOf(cloud, at);
    for (const [axis, metres] of [x, y, z].entries())
      assert.ok(Math.abs(metres! - points[i]![axis]!) < 2e-4, `point ${at}: ${[x, y, z]}, wanted ${points[i]}`);
    assert.deepEqual([intensity, ring], points[i]!.slice(3));
  });
}

for (const { name, messages, expected } of vectors(DECODED).filter(({ name }) => WANTED.test(name)))
  test(`${name} comes out as from the Python decoder`, () => {
    messages.forEach((message, i) => {
      check(ONE.cloud(coded(message), name), expected[i]!);
      assert.equal(ONE.log(coded(message), name), undefined);
    });
  });

for (const { name, messages, expected } of otherVectors(DECODED).filter(({ name }) => WANTED.test(name)))
  test(`${name} of another sensor has all its returns`, () => {
    messages.forEach((message, i) => {
      const found = ONE.cloud(coded(message), name);
      assert.equal(found?.data.length, expected[i]!.returns * 14);
    });
  });

for (const { name, messages, expected } of cloudVectors(/./).filter(({ name }) => WANTED.test(`cloud_${name}`)))
  test(`point clouds of ${name} have all returns and fields`, () => {
    messages.forEach((message, i) => {
      const found = ONE.cloud(coded(message), `/clouds/${name}`)!;
      const { returns, points, fields } = expected[i]!;
      assert.equal(found.data.length, returns * found.point_stride);
      const shown = returns ? [0, returns >> 1, returns - 1] : [];
      const view = new DataView(found.data.buffer);
      shown.forEach((at, place) => {
        const xyz = [0, 4, 8].map((offset) => view.getFloat32(at * found.point_stride + offset, true));
        assert.deepEqual(xyz, points[place]);
      });
      const single = new Set(fields.filter(([, , count]) => count === 1).map(([field]) => field));
      assert.deepEqual(new Set(found.fields.map((field) => field.name)), fields.length ? single : new Set(["x", "y", "z"]));
    });
  });

test("after a jump nothing is shown until the next key message, and the log says so", async () => {
  const { messages, expected } = vector("golden_v1_predictive_coarse");
  const { cloud, log } = await loaded();
  check(cloud(coded(messages[0]!)), expected[0]!);
  assert.equal(cloud(coded(messages[2]!)), undefined);
  const said = log(coded(messages[2]!));
  assert.equal(said?.level, LogLevel.WARNING);
  assert.match(said.message, /points come with the next key message/);
  check(cloud(coded(messages[1]!)), expected[1]!); // back, and on
  check(cloud(coded(messages[2]!)), expected[2]!);
  assert.equal(log(coded(messages[2]!)), undefined);
  check(cloud(coded(messages[3]!)), expected[3]!); // a key message
  check(cloud(coded(messages[0]!)), expected[0]!); // a jump to the beginning
  check(cloud(coded(messages[1]!)), expected[1]!);
});

test("panels that ask for the same messages in turn get the same points", () => {
  const { messages, expected } = vector("golden_v1_riddle_lossless");
  for (const batch of [[0, 1, 2], [3, 4]])
    for (let panel = 0; panel < 3; panel++)
      for (const at of batch) check(ONE.cloud(coded(messages[at]!), "/panels"), expected[at]!);
});

test("streams on two topics do not disturb each other", () => {
  const [one, other] = [vector("golden_v1_predictive_motion"), vector("golden_v1_predictive_coarse")];
  const { cloud } = ONE;
  for (const at of [0, 1, 2]) {
    check(cloud(coded(one.messages[at]!), "/a"), one.expected[at]!);
    check(cloud(coded(other.messages[at]!), "/b"), other.expected[at]!);
  }
});

test("other codecs are refused by name, without points", () => {
  const { cloud, log } = ONE;
  const png = vectors(/^golden_v1_png/)[0]!.messages[0]!;
  const h264 = repaired(vector("zstd").messages[0]!, (bytes) => bytes.set([8, 0], 12));
  for (const [data, name] of [[png, "png"], [h264, "h264"]] as const) {
    assert.equal(cloud(coded(data)), undefined);
    const said = log(coded(data));
    assert.equal(said?.level, LogLevel.ERROR);
    assert.match(said.message, new RegExp(`codec ${name} is not decoded here`));
  }
});

test("messages of other formats are left to other extensions", () => {
  const { cloud, transform, log } = ONE;
  const draco = coded(new Uint8Array(99), "draco");
  assert.deepEqual([cloud(draco), transform(draco), log(draco)], [undefined, undefined, undefined]);
});

test("until the decoder is loaded there are no points, and the log says why", async () => {
  const message = coded(vector("zstd").messages[0]!);
  const { cloud } = await loaded((early: Converted) => {
    assert.equal(early.cloud(message), undefined);
    assert.match(early.log(message)!.message, /is being loaded/);
  });
  assert.ok(cloud(message));
});

test("a pose becomes a transform, whether or not its points can be decoded", () => {
  const { transform } = ONE;
  let posed = 0;
  for (const { messages, expected } of vectors(DECODED))
    for (const [i, message] of messages.entries()) {
      const [pose, found] = [expected[i]!.pose, transform(coded(message))];
      assert.equal(found === undefined, pose === null);
      if (!found || !pose) continue;
      posed++;
      assert.deepEqual([found.parent_frame_id, found.child_frame_id], ["map", "car-7/roof"]);
      assert.deepEqual(Object.values(found.translation), [pose[3], pose[7], pose[11]]);
    }
  assert.ok(posed > 0);
});

test("a sensor that is mounted on a vehicle has no transform of its own", async () => {
  const { transform } = await loaded();
  const [key, posed] = vector("golden_v1_predictive_coarse").messages as [Uint8Array, Uint8Array];
  const mounted = new Uint8Array(key.length + 7);
  mounted.set(key.subarray(0, -4));
  mounted.set([17, 0, 1, 0, 0, 0, 0], key.length - 4);
  const view = new DataView(mounted.buffer);
  view.setUint32(8, mounted.length, true);
  view.setUint16(54, view.getUint16(54, true) + 1, true);
  view.setUint32(mounted.length - 4, crc32c(mounted.subarray(0, -4)), true);
  assert.equal(transform(coded(posed)), undefined, "its key message was not seen");
  assert.equal(transform(coded(mounted)), undefined);
  assert.equal(transform(coded(posed)), undefined);
  transform(coded(key));
  assert.ok(transform(coded(posed)));
});

test("rotations by any angle about any axis come out as their quaternions", () => {
  const random = numbers(20261126);
  for (let i = 0; i < 300; i++) {
    const q = [0, 1, 2, 3].map(() => random(2001) / 1000 - 1);
    const length = Math.hypot(...q) * (q[3]! < 0 ? -1 : 1);
    if (Math.abs(length) < 1e-3 || Math.abs(q[3]!) < 1e-3) continue;
    const [x, y, z, w] = q.map((part) => part / length) as [number, number, number, number];
    const rows = Float64Array.of(
      1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), 0,
      2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), 0,
      2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), 0,
    );
    const found = Object.values(quaternionOf(rows));
    [x, y, z, w].forEach((part, at) => assert.ok(Math.abs(part - found[at]!) < 1e-9));
  }
});

/** A copy with changed bytes, and a checksum that fits them. */
function repaired(message: Uint8Array, change: (bytes: Uint8Array) => void): Uint8Array {
  const bytes = message.slice();
  change(bytes);
  new DataView(bytes.buffer).setUint32(bytes.length - 4, crc32c(bytes.subarray(0, -4)), true);
  return bytes;
}

for (const name of ["zstd_modelled", "golden_v1_predictive_slabs_motion", "golden_v1_riddle_coarse"])
  test(`damaged messages of ${name} throw nothing, and whole ones are shown after them`, () => {
    const { messages, expected } = vector(name);
    const converted = ONE;
    const random = numbers(7);
    for (let i = 0; i < 20; i++) {
      const hostile = repaired(messages[random(messages.length)]!, (bytes) => {
        for (let times = 1 + random(3); times > 0; times--) bytes[56 + random(bytes.length - 60)] = random(256);
      });
      const cut = hostile.slice(0, random(hostile.length));
      for (const data of [hostile, cut, new Uint8Array(0)]) {
        converted.cloud(coded(data));
        converted.transform(coded(data));
        converted.log(coded(data));
      }
      if (i % 10 === 0) check(converted.cloud(coded(messages[0]!)), expected[0]!);
    }
  });
