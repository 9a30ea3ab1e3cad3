/** A frame without ranges: azimuths, which cells are returns, and their intensities. */

import { type Columns, readAzimuth } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { readIntensity } from "./intensity.js";
import { SPARSE, SPARSE_WITH_EARLIER, readKeep } from "./keep.js";
import { readMask } from "./mask.js";
import { type Message, Section, needed } from "./message.js";
import type { Sensor } from "./sensor.js";

export interface Planes extends Columns {
  /** 64 x W: 1 for a return. */
  readonly mask: Uint8Array;
  /** 64 x W. */
  readonly intensity: Uint8Array;
}

/** Looks up the reference of a mask, once the azimuths are known. */
export type Earlier = (columns: Columns) => Uint8Array;

export function readPlanes(message: Message, sensor: Sensor, earlier: Earlier | null): Planes {
  const columns = readAzimuth(needed(message, Section.AZIMUTH, "azimuths"), message.width);
  const before = earlier === null ? null : earlier(columns);
  const keep = message.section(Section.KEEP);
  const sparse = keep !== null && (keep[0] === SPARSE || keep[0] === SPARSE_WITH_EARLIER);
  const mask = sparse
    ? readKeep(keep, columns, sensor, before)
    : readMask(keep ?? needed(message, Section.MASK, "a mask"), columns, sensor, before);
  return { ...columns, mask, intensity: readIntensity(message.section(Section.INTENSITY), mask, columns, sensor) };
}

export function count(cells: Uint8Array): number {
  let ones = 0;
  for (let i = 0; i < cells.length; i++) ones += cells[i];
  return ones;
}

/** The odd step of a RANGE section, and the bytes after it. */
export function splitStep(data: Uint8Array): [number, Uint8Array] {
  if (data.length < 2) throw new DecodeError("truncated", "ranges end within their step");
  const step = data[0] | (data[1] << 8);
  if (step % 2 === 0 || step > 20_001) throw damaged(`a range step of ${step}`);
  return [step, data.subarray(2)];
}
