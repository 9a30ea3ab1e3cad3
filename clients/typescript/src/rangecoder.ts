/** The range coder, and the models of its decisions (docs/wire-format-sections.md). Whole numbers below 2^53 only. */

import { DecodeError, damaged } from "./errors.js";

const UNDERSTOOD_ZEROS = 4;
const WEIGHT_LIMIT = 2 ** 20;
const RATE = Uint16Array.from({ length: 254 }, (_, n) => Math.floor(65536 / (n + 2)));
const SQUASH = squashTable();
const STRETCH = stretchTable();

function squashTable(): Int32Array {
  const table = new Int32Array(4096);
  let power = 1n << 31n;
  for (let d = 0; d <= 2048; d++) {
    const up = Number((1n << 47n) / ((1n << 31n) + power));
    if (d < 2048) table[2048 + d] = up;
    if (d > 0) table[2048 - d] = 65536 - up;
    power = (power * 2139111403n + (1n << 30n)) >> 31n;
  }
  return table;
}

function stretchTable(): Int32Array {
  const table = new Int32Array(4096);
  let t = 0;
  for (let i = 0; i < 4096; i++) {
    while (t < 4095 && SQUASH[t] < 16 * i + 8) t++;
    table[i] = t - 2048;
  }
  return table;
}

function chance(p: number): number {
  return p < 16 ? 16 : p > 65520 ? 65520 : p;
}

function limited(value: number, low: number, high: number): number {
  return value < low ? low : value > high ? high : value;
}

/** Bit models of many contexts: for each the probability of a one in 22 bits, and a count of decisions. */
export class BitModels {
  readonly p: Uint32Array;
  readonly n: Uint8Array;

  constructor(contexts: number) {
    this.p = new Uint32Array(contexts).fill(2 ** 21);
    this.n = new Uint8Array(contexts);
  }

  start(context: number, p16: number): void {
    this.p[context] = p16 * 64;
    this.n[context] = 2;
  }

  chance(context: number): number {
    return chance(this.p[context] >>> 6);
  }

  learn(context: number, bit: number): void {
    const p = this.p[context];
    const n = this.n[context];
    this.p[context] = bit ? p + Math.floor(((4194303 - p) * RATE[n]) / 65536) : p - Math.floor((p * RATE[n]) / 65536);
    if (n < 253) this.n[context] = n + 1;
  }

  stretched(context: number): number {
    return STRETCH[this.p[context] >>> 10];
  }
}

/** Mixes several models by weights. `shift`: learning rate of the weights, 16 slow, 14 fast. */
export class Mixer {
  readonly #weights: number[];
  readonly #shift: number;
  readonly #half: number;

  constructor(models: number, weight: number, shift: number) {
    this.#weights = new Array<number>(models).fill(weight);
    this.#shift = shift;
    this.#half = 2 ** (shift - 1);
  }

  /** Decodes a decision with all models; then mixer and models learn it. */
  decide(coder: RangeDecoder, models: readonly BitModels[], contexts: ArrayLike<number>): number {
    let sum = 0;
    for (let i = 0; i < models.length; i++) sum += this.#weights[i] * models[i].stretched(contexts[i]);
    const mixed = SQUASH[limited(Math.floor(sum / 65536), -2048, 2047) + 2048];
    const bit = coder.decision(chance(mixed));
    const error = (bit ? 65536 : 0) - mixed;
    for (let i = 0; i < models.length; i++) {
      const moved = this.#weights[i] + ((error * models[i].stretched(contexts[i]) + this.#half) >> this.#shift);
      this.#weights[i] = limited(moved, -WEIGHT_LIMIT, WEIGHT_LIMIT);
    }
    for (let i = 0; i < models.length; i++) models[i].learn(contexts[i], bit);
    return bit;
  }
}

export class RangeDecoder {
  readonly #data: Uint8Array;
  #read = 0;
  #range = 0xffffffff;
  #code = 0;

  constructor(data: Uint8Array) {
    this.#data = data;
    for (let i = 0; i < 4; i++) this.#code = this.#code * 256 + this.#next();
    if (this.#code === 0xffffffff) throw damaged("a stream that begins where none can");
  }

  #next(): number {
    const at = this.#read++;
    if (at < this.#data.length) return this.#data[at];
    if (at >= this.#data.length + UNDERSTOOD_ZEROS) throw new DecodeError("truncated", "a stream of decisions is cut");
    return 0;
  }

  /** p: probability of a one, 1 to 65535. */
  decision(p: number): number {
    const bound = Math.floor((this.#range * p) / 65536);
    const bit = this.#code < bound ? 1 : 0;
    if (bit) {
      this.#range = bound;
    } else {
      this.#code -= bound;
      this.#range -= bound;
    }
    while (this.#range < 0x1000000) {
      this.#range *= 256;
      this.#code = this.#code * 256 + this.#next();
    }
    return bit;
  }

  /** Decodes a decision with one model, which then learns it. */
  bit(models: BitModels, context: number): number {
    const bit = this.decision(models.chance(context));
    models.learn(context, bit);
    return bit;
  }

  /** Up to 32 bits with probability 1/2, the highest first. */
  bits(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++) value = value * 2 + this.decision(32768);
    return value;
  }

  /** After the last decision: checks that the stream ends here, exactly as an encoder ends it. */
  end(): void {
    const moved = this.#read - UNDERSTOOD_ZEROS;
    if (this.#data.length === moved) return;
    let window = 0;
    for (let at = moved; at < this.#read; at++) window = window * 256 + (this.#data[at] ?? 0);
    const low = (window - this.#code + 2 ** 32) % 2 ** 32;
    const whole = low > 0 && low + this.#range <= 2 ** 32 && this.#code < 2 ** 24;
    if (this.#data.length !== moved + 1 || !whole) throw damaged("a stream of decisions that does not end where it should");
  }
}

/** Whole numbers: the length in unary, its highest bits by models, the rest as they are. */
export class NumberModel {
  readonly #longer = new BitModels(3 * 64);
  readonly #high = new BitModels(64 * 4);
  #recent = 0;
  #last = 0;

  decode(coder: RangeDecoder, mostBits: number): number {
    let length = 0;
    while (coder.bit(this.#longer, this.#recent * 64 + length))
      if (++length > mostBits) throw damaged(`a number of more than ${mostBits} bits`);
    let value = length > 0 ? 1 : 0;
    let left = length - 1;
    for (let node = 1; left > 0 && node < 4; left--) {
      const bit = coder.bit(this.#high, (length - 1) * 4 + node);
      node = 2 * node + bit;
      value = 2 * value + bit;
    }
    if (left > 0) value = value * 2 ** left + coder.bits(left);
    this.#remember(length);
    return value;
  }

  /** The same of numbers up to 64 bits. */
  decodeLong(coder: RangeDecoder): bigint {
    let length = 0;
    while (length < 64 && coder.bit(this.#longer, this.#recent * 64 + length)) length++;
    let value = length > 0 ? 1n : 0n;
    let left = length - 1;
    for (let node = 1; left > 0 && node < 4; left--) {
      const bit = coder.bit(this.#high, (length - 1) * 4 + node);
      node = 2 * node + bit;
      value = 2n * value + BigInt(bit);
    }
    for (; left > 0; left -= Math.min(left, 32))
      value = (value << BigInt(Math.min(left, 32))) | BigInt(coder.bits(Math.min(left, 32)));
    this.#remember(length);
    return value;
  }

  #remember(length: number): void {
    const now = length > 0 ? 1 : 0;
    this.#recent = now + this.#last;
    this.#last = now;
  }
}
