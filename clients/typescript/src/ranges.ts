/** The RANGE section of codec zstd, and the range of an index. */

import { damaged } from "./errors.js";
import { count, splitStep } from "./planes.js";
import { zstdFrame } from "./zstd.js";

const LONGEST = 65535;

/** 64 x W, 0 outside of the returns. mask: 64 x W */
export function readZstdRanges(data: Uint8Array, mask: Uint8Array): Uint16Array {
  const [step, coded] = splitStep(data);
  const returns = count(mask);
  const planes = zstdFrame(coded, 2 * returns);
  const ranges = new Uint16Array(mask.length);
  let index = 0;
  for (let i = 0, at = 0; i < mask.length; i++) {
    if (!mask[i]) continue;
    const folded = planes[at] | (planes[returns + at] << 8);
    at++;
    index = (index + ((folded >> 1) ^ -(folded & 1))) & 0xffff;
    ranges[i] = rangeOf(index, step);
  }
  return ranges;
}

/** The range of an index ("Range steps"); never 0. */
export function rangeOf(index: number, step: number): number {
  const half = (step - 1) / 2;
  if (index > Math.floor((LONGEST + half) / step) || (step === 1 && index === 0))
    throw damaged(`range index ${index} of step ${step}`);
  return index === 0 ? (half + 1) >> 1 : Math.min(index * step, LONGEST);
}
