/** The range coder of modelled intensities: 64 bits, here as two halves of 32, each a whole number below 2^53. */

import { DecodeError, damaged } from "./errors.js";

const WORD = 2 ** 32;
/** Zero bytes that are read behind the end of a stream: an encoder leaves them out. */
const UNDERSTOOD_ZEROS = 8;

export class WideDecoder {
  readonly #data: Uint8Array;
  #read = 0;
  #rangeHigh = WORD - 1;
  #rangeLow = WORD - 1;
  #codeHigh: number;
  #codeLow: number;
  #windowHigh: number;
  #windowLow: number;

  constructor(data: Uint8Array) {
    this.#data = data;
    this.#codeHigh = this.#windowHigh = this.#word();
    this.#codeLow = this.#windowLow = this.#word();
    if (this.#codeHigh === WORD - 1 && this.#codeLow === WORD - 1) throw damaged("a stream that begins where none can");
  }

  #word(): number {
    if (this.#read >= this.#data.length + UNDERSTOOD_ZEROS)
      throw new DecodeError("truncated", "a stream of decisions is cut");
    let word = 0;
    for (let i = 0; i < 4; i++) word = word * 256 + (this.#data[this.#read++] ?? 0);
    return word;
  }

  /** p: probability of a one in steps of 2^-15 */
  decision(p: number): number {
    // bound = (range >> 15) * p: 49 bits times 15, in parts of 24 and 25.
    const shifted = this.#rangeHigh * 2 ** 17 + (this.#rangeLow >>> 15);
    const top = Math.floor(shifted / 2 ** 25);
    const bottom = (shifted - top * 2 ** 25) * p;
    const middle = top * p + Math.floor(bottom / 2 ** 25); // in units of 2^25
    const boundHigh = Math.floor(middle / 2 ** 7);
    const boundLow = (middle - boundHigh * 2 ** 7) * 2 ** 25 + (bottom % 2 ** 25);
    const bit = this.#codeHigh < boundHigh || (this.#codeHigh === boundHigh && this.#codeLow < boundLow) ? 1 : 0;
    if (bit) {
      this.#rangeHigh = boundHigh;
      this.#rangeLow = boundLow;
    } else {
      [this.#codeHigh, this.#codeLow] = minus(this.#codeHigh, this.#codeLow, boundHigh, boundLow);
      [this.#rangeHigh, this.#rangeLow] = minus(this.#rangeHigh, this.#rangeLow, boundHigh, boundLow);
    }
    if (this.#rangeHigh === 0) {
      this.#rangeHigh = this.#rangeLow;
      this.#rangeLow = 0;
      this.#codeHigh = this.#codeLow;
      this.#windowHigh = this.#windowLow;
      this.#codeLow = this.#windowLow = this.#word();
    }
    return bit;
  }

  /** After the last decision: checks that the stream ends here, exactly as an encoder ends it. */
  end(): void {
    const big = (high: number, low: number) => (BigInt(high) << 32n) | BigInt(low);
    const whole = 1n << 64n;
    const window = big(this.#windowHigh, this.#windowLow);
    const low = (window - big(this.#codeHigh, this.#codeLow) + whole) % whole;
    const end = low + big(this.#rangeHigh, this.#rangeLow);
    for (let kept = 0; kept <= 4; kept++) {
      const unit = 1n << BigInt(64 - 8 * kept);
      const value = ((low + unit - 1n) / unit) * unit;
      if (value >= end) continue;
      if (value % whole !== window || this.#data.length !== this.#read - UNDERSTOOD_ZEROS + kept) break;
      return;
    }
    throw damaged("a stream of decisions that does not end where it should");
  }
}

function minus(high: number, low: number, byHigh: number, byLow: number): [number, number] {
  return low < byLow ? [high - byHigh - 1, low + WORD - byLow] : [high - byHigh, low - byLow];
}
