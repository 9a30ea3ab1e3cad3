/** Decompresses a zlib stream (RFC 1950, RFC 1951) with a limit of bytes. For small lists: the code is short, not fast.
 *
 * `Decoder.decode` is synchronous, in Node and in browsers. Browsers do not have Node's zlib, and their
  * DecompressionStream is asynchronous. */

import { damaged } from "./errors.js";

const LENGTHS: readonly number[] = [3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258];
const LENGTH_BITS: readonly number[] = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0];
const DISTANCES: readonly number[] = [1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577];
const ORDER: readonly number[] = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
const LONGEST_CODE = 15;

const broken = () => damaged("a zlib stream that is damaged");

/** Reads bits, the lowest of each byte first. */
class Bits {
  readonly data: Uint8Array;
  at = 0;
  #held = 0;
  #count = 0;

  constructor(data: Uint8Array) {
    this.data = data;
  }

  take(bits: number): number {
    while (this.#count < bits) {
      if (this.at >= this.data.length) throw broken();
      this.#held |= this.data[this.at++] << this.#count;
      this.#count += 8;
    }
    const value = this.#held & ((1 << bits) - 1);
    this.#held >>>= bits;
    this.#count -= bits;
    return value;
  }

  /** Skip the rest of this byte. */
  align(): void {
    this.#held = this.#count = 0;
  }
}

/** A Huffman code, from the lengths of its words. */
class Code {
  readonly #counts = new Uint16Array(LONGEST_CODE + 1);
  readonly #symbols: Uint16Array;

  /** lengths: length of each symbol's word, 0 for a symbol without a word */
  constructor(lengths: Uint8Array) {
    for (const length of lengths) this.#counts[length]++;
    this.#counts[0] = 0;
    let left = 1;
    const begins = new Uint16Array(LONGEST_CODE + 2);
    for (let length = 1; length <= LONGEST_CODE; length++) {
      left = 2 * left - this.#counts[length];
      if (left < 0) throw broken();
      begins[length + 1] = begins[length] + this.#counts[length];
    }
    const words = begins[LONGEST_CODE + 1];
    // An incomplete code is allowed only if it has a single word.
    if (left > 0 && words > 1) throw broken();
    this.#symbols = new Uint16Array(words);
    lengths.forEach((length, symbol) => {
      if (length) this.#symbols[begins[length]++] = symbol;
    });
  }

  next(bits: Bits): number {
    let code = 0;
    let first = 0;
    let index = 0;
    for (let length = 1; length <= LONGEST_CODE; length++) {
      code |= bits.take(1);
      const count = this.#counts[length];
      if (code - first < count) return this.#symbols[index + code - first];
      index += count;
      first = (first + count) << 1;
      code <<= 1;
    }
    throw broken();
  }
}

function fixedCodes(): [Code, Code] {
  const lengths = new Uint8Array(288).fill(8, 0, 144).fill(9, 144, 256).fill(7, 256, 280).fill(8, 280);
  return [new Code(lengths), new Code(new Uint8Array(32).fill(5))];
}

function ownCodes(bits: Bits): [Code, Code] {
  const [literals, distances, count] = [bits.take(5) + 257, bits.take(5) + 1, bits.take(4) + 4];
  if (literals > 286 || distances > 30) throw broken();
  const short = new Uint8Array(19);
  for (let i = 0; i < count; i++) short[ORDER[i]] = bits.take(3);
  const code = new Code(short);
  const lengths = new Uint8Array(literals + distances);
  for (let at = 0; at < lengths.length; ) {
    const symbol = code.next(bits);
    if (symbol < 16) {
      lengths[at++] = symbol;
      continue;
    }
    if (symbol === 16 && at === 0) throw broken();
    const value = symbol === 16 ? lengths[at - 1] : 0;
    const times = symbol === 16 ? 3 + bits.take(2) : symbol === 17 ? 3 + bits.take(3) : 11 + bits.take(7);
    if (times > lengths.length - at) throw broken();
    lengths.fill(value, at, at + times);
    at += times;
  }
  if (lengths[256] === 0) throw broken();
  return [new Code(lengths.subarray(0, literals)), new Code(lengths.subarray(literals))];
}

/** The bytes of the stream `data`. Throws DecodeError for more than `most` bytes, or a damaged stream. */
export function inflated(data: Uint8Array, most: number): Uint8Array {
  if (data.length < 6 || (data[0] & 15) !== 8 || data[0] >> 4 > 7 || (256 * data[0] + data[1]) % 31 !== 0) throw broken();
  if (data[1] & 32) throw broken(); // a dictionary that nobody has
  const bits = new Bits(data.subarray(2, -4));
  const out = new Uint8Array(most);
  let size = 0;
  for (let last = 0; !last; ) {
    last = bits.take(1);
    const kind = bits.take(2);
    if (kind === 3) throw broken();
    if (kind === 0) {
      bits.align();
      const length = bits.take(16);
      bits.align();
      if (length !== (~bits.take(16) & 0xffff)) throw broken();
      bits.align();
      if (length > most - size || length > bits.data.length - bits.at) throw broken();
      out.set(bits.data.subarray(bits.at, bits.at + length), size);
      bits.at += length;
      size += length;
      continue;
    }
    const [literals, distances] = kind === 1 ? fixedCodes() : ownCodes(bits);
    for (;;) {
      const symbol = literals.next(bits);
      if (symbol === 256) break;
      if (symbol < 256) {
        if (size >= most) throw broken();
        out[size++] = symbol;
        continue;
      }
      if (symbol > 285) throw broken();
      const length = LENGTHS[symbol - 257] + bits.take(LENGTH_BITS[symbol - 257]);
      const far = distances.next(bits);
      if (far > 29) throw broken();
      const distance = DISTANCES[far] + bits.take(far < 2 ? 0 : (far >> 1) - 1);
      if (distance > size || length > most - size) throw broken();
      for (let i = 0; i < length; i++, size++) out[size] = out[size - distance];
    }
  }
  if (bits.at !== bits.data.length || checksum(out.subarray(0, size)) !== new DataView(data.buffer, data.byteOffset).getUint32(data.length - 4))
    throw broken();
  return out.subarray(0, size);
}

/** Adler-32. */
function checksum(data: Uint8Array): number {
  let [a, b] = [1, 0];
  for (const byte of data) {
    a = (a + byte) % 65521;
    b = (b + a) % 65521;
  }
  return b * 65536 + a;
}
