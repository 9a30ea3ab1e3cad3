/** What a user would lose: lists of columns as the vehicle sent them, and a program that goes on with hostile ones. */

import assert from "node:assert/strict";
import { test } from "node:test";
import { constants, deflateSync, inflateSync } from "node:zlib";
import { DecodeError } from "../src/index.js";
import { inflated } from "../src/inflate.js";
import { examples, numbers } from "./numbers.js";

function samples(): Uint8Array[] {
  const random = numbers(11);
  const found = [0, 1, 2, 300, 5000].map((length) => Uint8Array.from({ length }, () => random(256)));
  found.push(...[7, 4000, 40_000].map((length) => Uint8Array.from({ length }, (_, i) => (i % 2 ? 0 : 3 + random(2)))));
  found.push(new Uint8Array(20_000), Uint8Array.from({ length: 600 }, (_, i) => i >> 2));
  return found;
}

const STRATEGIES = [constants.Z_DEFAULT_STRATEGY, constants.Z_FIXED, constants.Z_HUFFMAN_ONLY, constants.Z_RLE];

test("what zlib packs comes out, at every level and by every kind of block", () => {
  for (const plain of samples())
    for (const strategy of STRATEGIES)
      for (const level of [0, 1, 6, 9]) {
        const packed = new Uint8Array(deflateSync(plain, { level, strategy }));
        assert.deepEqual(inflated(packed, plain.length), plain);
        if (plain.length) assert.throws(() => inflated(packed, plain.length - 1), DecodeError);
        assert.throws(() => inflated(Uint8Array.from([...packed, 0]), plain.length), DecodeError);
      }
});

test("a damaged stream is an error, or what zlib makes of it, and soon", () => {
  const random = numbers(12);
  for (const plain of samples()) {
    const packed = new Uint8Array(deflateSync(plain));
    for (let i = 0; i < examples(400); i++) {
      const damaged = packed.slice(0, random(4) ? packed.length : random(packed.length + 1));
      if (damaged.length) damaged[random(damaged.length)] ^= 1 << random(8);
      try {
        assert.deepEqual(inflated(damaged, plain.length + 100), new Uint8Array(inflateSync(damaged)));
      } catch (error) {
        assert.ok(error instanceof DecodeError, `${error}`);
      }
    }
  }
  for (let i = 0; i < examples(20_000); i++) {
    const rubbish = Uint8Array.from({ length: random(60) }, () => random(256));
    rubbish.set([0x78, 0x9c].slice(0, rubbish.length));
    assert.throws(() => inflated(rubbish, 1000), DecodeError);
  }
});
