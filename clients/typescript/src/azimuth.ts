/** The AZIMUTH section: rotation of each half of each column, and which halves were fired. */

import { damaged } from "./errors.js";
import { BitModels, Mixer, NumberModel, RangeDecoder } from "./rangecoder.js";

export const TURN = 36_000;

/** W columns. `azimuth` in 0.01 degree and `fired` (1 or 0) are 2 x W: upper halves, then lower. */
export interface Columns {
  readonly width: number;
  readonly azimuth: Uint16Array;
  readonly fired: Uint8Array;
}

export function readAzimuth(data: Uint8Array, width: number): Columns {
  if (data.length < 1) throw damaged("an azimuth section without bytes");
  const flags = data[0];
  const [allFired, lowerFirst, listed] = [flags & 1, (flags >> 1) & 1, (flags >> 2) & 7];
  if (flags >> 5 || listed > 4 || data.length < 1 + 2 * listed) throw damaged("the head of an azimuth section");
  const steps = Array.from({ length: listed }, (_, i) => data[1 + 2 * i] + 256 * data[2 + 2 * i]);
  if (steps.some((step) => step >= TURN)) throw damaged("a step of a turn or more");
  const coder = new RangeDecoder(data.subarray(1 + 2 * listed));
  const rotation = new Steps(coder, steps);
  const [firing, same] = [new BitModels(64 * 4), new BitModels(4)];
  const azimuth = new Uint16Array(2 * width);
  const fired = new Uint8Array(2 * width);
  let before = 0;
  let recent = 3;
  for (let column = 0; column < width; column++) {
    let [upper, lower] = [1, 1];
    if (!allFired) {
      lower = coder.bit(firing, before * 4 + 1);
      upper = coder.bit(firing, before * 4 + 2 + lower);
      before = (before * 4 + upper + 2 * lower) % 64;
    }
    fired[column] = upper;
    fired[width + column] = lower;
    const first = rotation.next();
    let second = first;
    if (upper && lower) {
      const again = coder.bit(same, recent);
      recent = ((recent << 1) | again) & 3;
      if (!again) second = rotation.next();
    }
    const lowerIsFirst = lower && (!upper || lowerFirst);
    azimuth[column] = lowerIsFirst ? second : first;
    azimuth[width + column] = lowerIsFirst ? first : second;
  }
  coder.end();
  return { width, azimuth, fired };
}

/** Azimuths coded as steps from one column to the next. */
class Steps {
  readonly #coder: RangeDecoder;
  readonly #list: number[];
  readonly #two = new BitModels(16 * 16 * 4);
  readonly #three = new BitModels(16 * 16 * 16);
  readonly #mixer = new Mixer(2, 39322, 16);
  readonly #number = new BitModels(4 * 3);
  readonly #other = new NumberModel();
  #rotation = 0;
  #run = 0;
  #last = 0;
  #r0 = 0;
  #r1 = 0;

  constructor(coder: RangeDecoder, list: number[]) {
    this.#coder = coder;
    this.#list = list;
  }

  next(): number {
    const runs = this.#run * 16 + this.#r0;
    const contexts = [runs * 4 + this.#last, runs * 16 + this.#r1];
    let number = 0;
    if (this.#mixer.decide(this.#coder, [this.#two, this.#three], contexts)) {
      this.#run = Math.min(this.#run + 1, 15);
    } else {
      [this.#r1, this.#r0, this.#run] = [this.#r0, this.#run, 0];
      number = 1;
      while (number < 4 && !this.#coder.bit(this.#number, this.#last * 3 + number - 1)) number++;
      this.#last = Math.min(number, 3);
    }
    if (number >= this.#list.length && number < 4) throw damaged(`step ${number} of a list of ${this.#list.length}`);
    const step = number < 4 ? this.#list[number] : this.#other.decode(this.#coder, 16);
    if (step >= TURN) throw damaged("a step of a turn or more");
    this.#rotation = (this.#rotation + step) % TURN;
    return this.#rotation;
  }
}
