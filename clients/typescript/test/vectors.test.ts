/** What a user would lose: that this decoder gives what the others give, frame for frame. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { Decoder, DecodeError, type Frame, type ImageFrame, filled, imagePointsOf, isImageFrame, pointsOf } from "../src/index.js";
import { type Expected, type ExpectedOther, digest, otherVectors, vectors } from "./vectors.js";

function check(frame: Frame | ImageFrame, expected: Expected): void {
  assert.ok(!isImageFrame(frame));
  const { sensor } = frame;
  const { points: corners, lattice, made_up: madeUp, filled: images, ...arrays } = expected;
  assert.deepEqual(
    {
      stream: `${frame.streamId}`,
      index: `${frame.index}`,
      stamp_ns: `${frame.stampNs}`,
      sensor: [sensor.name, sensor.hash, sensor.convention, sensor.rangeStep],
      width: frame.width,
      returns: frame.returns,
      range: digest(frame.range),
      intensity: digest(frame.intensity),
      azimuth: digest(frame.azimuth),
      fired: digest(frame.fired),
      pose: frame.pose && [...frame.pose],
      ...(frame.mount && { mount: [...frame.mount] }),
    },
    arrays,
  );
  assert.equal(frame.lattice ? digest(frame.lattice) : undefined, lattice);
  assert.deepEqual([frame.filled, frame.madeUp], [null, 0], "nothing is made up unasked");
  if (images) {
    const wide = filled(frame);
    assert.deepEqual([wide.returns, wide.madeUp], [expected.returns, madeUp]);
    assert.deepEqual([wide.filled ?? new Uint8Array(), wide.range, wide.intensity].map(digest), images);
    const all = pointsOf(wide);
    assert.equal(all.count, expected.returns + wide.madeUp);
    assert.equal(all.filled.reduce((sum, one) => sum + one, 0), wide.madeUp);
    assert.deepEqual(digest(frame.range), expected.range, "the frame itself stays as it was measured");
  } else assert.equal(filled(frame), frame);
  const points = pointsOf(frame);
  assert.equal(points.count, expected.returns);
  const shown = points.count ? [0, points.count >> 1, points.count - 1] : [];
  shown.forEach((at, i) => {
    const [x, y, z, intensity, ring] = corners[i];
    for (const [axis, metres] of [x, y, z].entries())
      assert.ok(Math.abs(points.xyz[3 * at + axis] - metres) < 2e-4, `point ${at}: ${points.xyz[3 * at + axis]}, ${metres}`);
    assert.deepEqual([points.intensity[at], points.ring[at]], [intensity, ring]);
  });
}

const OURS = vectors(/^(golden_v1_)?(raw|zstd)/);

test("there are vectors of both codecs, of this format's first version and of what no encoder writes", () => {
  assert.ok(OURS.length >= 10);
});

for (const { name, messages, expected } of OURS)
  test(`${name} comes out as from the Python decoder`, async () => {
    const decoder = await Decoder.create();
    messages.forEach((message, i) => check(decoder.decode(message), expected[i]));
  });

function checkOther(frame: Frame | ImageFrame, expected: ExpectedOther): void {
  assert.ok(isImageFrame(frame));
  const { sensor, rest, planes } = frame;
  const { azimuth: _, shown: __, ...wanted } = { ...expected, points: undefined, cloud: undefined };
  const sorted = (pairs: [string, string][]) => Object.fromEntries(pairs.sort(([a], [b]) => (a < b ? -1 : 1)));
  assert.deepEqual(
    {
      stream: `${frame.streamId}`,
      index: `${frame.index}`,
      stamp_ns: `${frame.stampNs}`,
      sensor: [sensor.name, sensor.hash, sensor.convention, sensor.rangeStep],
      model: sensor.model,
      rows: frame.rows,
      width: frame.width,
      returns: frame.returns,
      planes: sorted(planes.map(({ name, values }) => [name, digest(values)])),
      lattice: frame.lattice && digest(frame.lattice),
      layout: rest.layout,
      packet_ns: digest(rest.packetNs),
      odd: [...rest.odd],
      series: sorted([...rest.series].map(([name, values]) => [name, digest(values)])),
      pose: frame.pose && [...frame.pose],
      points: undefined,
      cloud: undefined,
    },
    wanted,
  );
  const points = imagePointsOf(frame, true);
  assert.equal(points.count, expected.cloud);
  const shown = points.count ? [0, points.count >> 1, points.count - 1] : [];
  shown.forEach((at, i) => {
    const [x, y, z, intensity, ring, returnNumber] = expected.points[i]!;
    for (const [axis, metres] of [x, y, z].entries())
      assert.ok(Math.abs(points.xyz[3 * at + axis]! - Number(metres)) < 1.1e-4, `point ${at}: ${points.xyz[3 * at + axis]}, ${metres}`);
    assert.deepEqual([points.ring[at], points.returnNumber[at]], [ring, returnNumber]);
    assert.equal(points.fields.get("intensity")?.[at] ?? 0, intensity);
  });
}

for (const { name, messages, expected } of otherVectors(/^(raw|zstd)/))
  test(`${name} of another sensor comes out as from the Python decoder`, async () => {
    const decoder = await Decoder.create();
    messages.forEach((message, i) => checkOther(decoder.decode(message), expected[i]!));
  });

test("a message of another codec is refused by its number", async () => {
  const decoder = await Decoder.create();
  for (const { messages } of [...vectors(/predictive_lossless|riddle_lossless/), ...otherVectors(/predictive|pcodec/)])
    assert.throws(() => decoder.decode(messages[0]), { name: "DecodeError", code: "version" });
});

test("what builds on a message that was lost says so, and a key message mends it", async () => {
  const decoder = await Decoder.create();
  const [{ messages, expected }] = vectors(/^zstd_modelled$/);
  assert.throws(() => decoder.decode(messages[1]), { name: "DecodeError", code: "reference" });
  decoder.decode(messages[0]);
  assert.throws(() => decoder.decode(messages[2]), (error) => error instanceof DecodeError && error.code === "reference");
  check(decoder.decode(messages[1]), expected[1]);
  check(decoder.decode(messages[2]), expected[2]);
});
