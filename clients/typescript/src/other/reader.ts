/** Fields of sections of other sensors than an HDL-64E: bytes, whole numbers of 7 bits a byte, names. */

import { DecodeError, damaged } from "../errors.js";

export class Reader {
  readonly #data: Uint8Array;
  #at = 0;

  constructor(data: Uint8Array) {
    this.#data = data;
  }

  get left(): number {
    return this.#data.length - this.#at;
  }

  byte(): number {
    return this.take(1)[0]!;
  }

  take(size: number): Uint8Array {
    if (size > this.left) throw new DecodeError("truncated", "a section ends too early");
    this.#at += size;
    return this.#data.subarray(this.#at - size, this.#at);
  }

  /** A whole number from `least` to `limit`, which is up to 2^53. */
  varint(limit: number, least = 0): number {
    return Number(this.long(BigInt(limit), BigInt(least)));
  }

  /** The same of larger ones. */
  long(limit: bigint, least = 0n): bigint {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = this.byte();
      value |= BigInt(byte & 0x7f) << shift;
      if (value > limit || shift > 63n) throw damaged(`a number over ${limit}`);
      if (byte >= 0x80) continue;
      if (value < least || (byte === 0 && shift > 0n)) throw damaged(`a number below ${least}, or longer than needed`);
      return value;
    }
  }

  /** From -limit to limit. */
  signed(limit: bigint): bigint {
    const number = this.long(2n * limit);
    return number & 1n ? -(number >> 1n) - 1n : number >> 1n;
  }

  /** As many bytes as the number before them says. */
  sized(): Uint8Array {
    return this.take(this.varint(this.left));
  }

  name(most: number, least = 0): string {
    const bytes = this.take(this.varint(most, least));
    const name = String.fromCharCode(...bytes);
    if (!/^[0-9A-Za-z_]*$/.test(name)) throw damaged("a name that is not of letters, digits and underscores");
    return name;
  }

  rest(): Uint8Array {
    return this.take(this.left);
  }

  end(): void {
    if (this.left) throw damaged("bytes after the end of a section");
  }
}
