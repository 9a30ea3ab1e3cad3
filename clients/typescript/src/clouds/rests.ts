/** Rests of numbers of points, and their tables (docs/wire-format-clouds.md, "Rests"). */

import { DecodeError, damaged } from "../errors.js";
import { Reader } from "../other/reader.js";

const SLOT_BITS = 11;
const SLOTS = 1 << SLOT_BITS;
const LANES = 4;
const LEAST = 65_536;
const DIRECT = 16;
const MOST_TOKENS = 40;
const CONTEXTS = 64;

export function unzigzag(value: number): number {
  return (value >>> 1) ^ -(value & 1);
}

/** What is known of the tokens of one context. */
class Table {
  readonly frequency: Uint16Array;
  readonly start: Uint16Array;
  readonly tokenAt = new Uint8Array(SLOTS);
  readonly #counts: Uint32Array;
  #period = 16;
  #left = 16;

  constructor(tokens: number) {
    this.frequency = new Uint16Array(tokens);
    this.start = new Uint16Array(tokens);
    this.#counts = Uint32Array.from({ length: tokens }, (_, token) => 32 >> Math.min(token, 5));
    this.#build();
  }

  take(token: number): void {
    this.#counts[token]!++;
    if (--this.#left > 0) return;
    this.#period = Math.min(2 * this.#period, 128);
    this.#build();
  }

  #build(): void {
    const counts = this.#counts;
    const tokens = counts.length;
    this.#left = this.#period;
    let [total, best, used] = [0, 0, 0];
    for (let token = 0; token < tokens; token++) {
      total += counts[token]!;
      if (counts[token]! > counts[best]!) best = token;
    }
    for (let token = 0; token < tokens; token++) {
      this.frequency[token] = 1 + Math.floor((counts[token]! * (SLOTS - tokens)) / total);
      used += this.frequency[token]!;
    }
    this.frequency[best]! += SLOTS - used;
    let start = 0;
    for (let token = 0; token < tokens; token++) {
      this.start[token] = start;
      this.tokenAt.fill(token, start, (start += this.frequency[token]!));
    }
    if (total > 1024) for (let token = 0; token < tokens; token++) counts[token] = (counts[token]! + 1) >> 1;
  }
}

/** The rests of a stream, one after the other. */
export class RestReader {
  readonly #tokens: number;
  readonly #states = new Uint32Array(LANES);
  readonly #tables: (Table | undefined)[] = new Array(CONTEXTS);
  #words: Uint8Array = new Uint8Array();
  #bits: Uint8Array = new Uint8Array();
  #at = 0;
  #word = 0;
  #bit = 0;
  #held = 0;
  #heldBits = 0;

  constructor(data: Uint8Array) {
    const reader = new Reader(data);
    this.#tokens = reader.byte();
    if (this.#tokens > MOST_TOKENS) throw damaged(`rests of ${this.#tokens} tokens`);
    if (this.#tokens === 0) {
      reader.end();
      return;
    }
    for (let lane = 0; lane < LANES; lane++) {
      const [a, b, c, d] = reader.take(4) as unknown as [number, number, number, number];
      this.#states[lane] = a + b * 256 + c * 65_536 + d * 16_777_216;
    }
    this.#words = reader.take(2 * reader.varint(Math.floor(reader.left / 2)));
    this.#bits = reader.rest();
  }

  next(context: number): number {
    if (this.#tokens === 0) return 0;
    const table = (this.#tables[context] ??= new Table(this.#tokens));
    const lane = this.#at++ & (LANES - 1);
    const before = this.#states[lane]!;
    const slot = before & (SLOTS - 1);
    const token = table.tokenAt[slot]!;
    let state = table.frequency[token]! * (before >>> SLOT_BITS) + slot - table.start[token]!;
    if (state < LEAST) {
      if (this.#word >= this.#words.length) throw ends();
      state = state * 65_536 + this.#words[this.#word]! + this.#words[this.#word + 1]! * 256;
      this.#word += 2;
    }
    this.#states[lane] = state;
    table.take(token);
    return token < DIRECT ? token : this.#beside(token - 12);
  }

  #beside(bits: number): number {
    for (; this.#heldBits < bits; this.#heldBits += 8) {
      if (this.#bit >= this.#bits.length) throw ends();
      this.#held += this.#bits[this.#bit++]! * 2 ** this.#heldBits;
    }
    const highest = 2 ** bits;
    const low = this.#held % highest;
    this.#held = (this.#held - low) / highest;
    this.#heldBits -= bits;
    return highest + low;
  }

  /** All must have been used as an encoder uses it. */
  end(): void {
    if (this.#tokens === 0) return;
    const used = this.#word === this.#words.length && this.#bit === this.#bits.length && this.#held === 0;
    if (!used || this.#states.some((state) => state !== LEAST)) throw damaged("the end of rests does not fit what was read");
  }
}

function ends(): DecodeError {
  return new DecodeError("truncated", "rests that end too early");
}
