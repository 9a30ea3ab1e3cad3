/** What a user would lose: a program that goes on, whatever comes over the network. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { crc32c } from "../src/crc32c.js";
import { Decoder, DecodeError, filled, isImageFrame, pointsOf } from "../src/index.js";
import { readMessage, Section } from "../src/message.js";
import { examples, numbers } from "./numbers.js";
import { otherVectors, vectors } from "./vectors.js";

const OURS = [...vectors(/^(raw|zstd)/), ...otherVectors(/^(raw|zstd)/)];

/** Some frame, or DecodeError; anything else fails the test. */
function decode(decoder: Decoder, data: Uint8Array): boolean {
  try {
    const frame = decoder.decode(data);
    if (!isImageFrame(frame)) pointsOf(filled(frame));
    return true;
  } catch (error) {
    assert.ok(error instanceof DecodeError, `${error}`);
    return false;
  }
}

function repaired(data: Uint8Array): Uint8Array {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  view.setUint32(8, data.length, true);
  view.setUint32(data.length - 4, crc32c(data.subarray(0, -4)), true);
  return data;
}

test("the checksum is CRC-32C", () => {
  assert.equal(crc32c(new TextEncoder().encode("123456789")), 0xe3069283);
});

test("a message that was cut is an error wherever it was cut", async () => {
  const decoder = await Decoder.create();
  for (const { messages } of OURS) {
    const message = messages[0];
    const random = numbers(7);
    for (let i = 0; i < 60; i++) {
      const cut = message.slice(0, random(message.length));
      assert.equal(decode(decoder, cut), false);
      if (cut.length > 60) decode(decoder, repaired(cut));
    }
  }
});

test("a flipped bit is an error by its checksum", async () => {
  const decoder = await Decoder.create();
  const random = numbers(99);
  for (const { messages } of OURS)
    for (let i = 0; i < 60; i++) {
      const flipped = messages[0].slice();
      flipped[random(flipped.length)] ^= 1 << random(8);
      assert.equal(decode(decoder, flipped), false);
    }
});

test("what lies behind the checksum is looked at too, and the next message is decoded", async () => {
  const random = numbers(2026);
  let refused = 0;
  for (const { messages } of OURS) {
    const decoder = await Decoder.create();
    for (let i = 0; i < examples(400); i++) {
      const message = messages[random(messages.length)].slice();
      for (let times = 1 + random(3); times > 0; times--) {
        const at = 4 + random(message.length - 8);
        message[at] = random(2) ? random(256) : message[at] ^ (1 << random(8));
      }
      const view = new DataView(message.buffer);
      view.setUint32(8, message.length, true);
      view.setUint32(message.length - 4, crc32c(message.subarray(0, -4)), true);
      refused += decode(decoder, message) ? 0 : 1;
      if (i % 25 === 0) assert.ok(decode(decoder, messages[0]));
    }
  }
  assert.ok(refused > examples(400));
});

test("rubbish is an error", async () => {
  const decoder = await Decoder.create();
  const random = numbers(5);
  for (let length = 0; length < 300; length++)
    assert.equal(decode(decoder, Uint8Array.from({ length }, () => random(256))), false);
});

test("a pose that is no rotation and shift is an error", async () => {
  const posed = (data: Uint8Array): boolean => readMessage(data).section(Section.POSE) !== null;
  const messages = OURS.map((one) => one.messages).find((some) => some.some(posed));
  assert.ok(messages, "no vector has a pose");
  const place = messages.findIndex(posed);
  const turnedOver = [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 0];
  const sheared = [1, 5, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  const far = [1, 0, 0, 1e12, 0, 1, 0, 0, 0, 0, 1, 0];
  for (const pose of [Array<number>(12).fill(1e308), Array<number>(12).fill(0), turnedOver, sheared, far]) {
    const decoder = await Decoder.create();
    for (const before of messages.slice(0, place)) decoder.decode(before);
    const data = messages[place]!.slice();
    const at = readMessage(data).section(Section.POSE)!.byteOffset;
    pose.forEach((value, i) => new DataView(data.buffer).setFloat64(at + 8 * i, value, true));
    assert.throws(() => decoder.decode(repaired(data)), /no rigid transform/);
  }
});
