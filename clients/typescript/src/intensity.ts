/** The INTENSITY section: forms 0 to 2, and forms 3 to 5 with modelled returns (docs/wire-format-intensity.md). */

import type { Columns } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { readModelled } from "./modelled.js";
import { firedCells } from "./rows.js";
import type { Sensor } from "./sensor.js";
import { zstdFrame } from "./zstd.js";

/** Decodes modelled bytes of the returns to an image, 64 x W. */
export type Modelled = (coded: Uint8Array) => Uint8Array;

/** 64 x W. mask: 64 x W, the returns; modelled: by default this decoder's own */
export function readIntensity(
  data: Uint8Array | null,
  mask: Uint8Array,
  columns: Columns,
  sensor: Sensor,
  modelled: Modelled = (coded) => readModelled(coded, mask, columns, sensor),
): Uint8Array {
  if (data === null) return new Uint8Array(mask.length);
  if (data.length === 0) throw damaged("an intensity section without bytes");
  const form = data[0];
  if (form > 5) throw new DecodeError("version", `intensities of form ${form}`);
  const returns = (coded: Uint8Array) => (form >= 3 ? modelled(coded) : readGrouped(coded, mask));
  if (form % 3 !== 1) return returns(data.subarray(1));
  if (data.length < 5) throw damaged("intensities end within their head");
  const size = data[1] + data[2] * 256 + data[3] * 65536 + data[4] * 16777216;
  if (size > data.length - 5) throw new DecodeError("truncated", "intensities end before their returns");
  const image = returns(data.subarray(5, 5 + size));
  const others = firedCells(columns, sensor);
  let total = 0;
  for (let i = 0; i < others.length; i++) total += others[i] &= 1 - mask[i];
  const values = zstdFrame(data.subarray(5 + size), total);
  for (let i = 0, at = 0; i < others.length; i++) if (others[i]) image[i] = values[at++];
  return image;
}

/** Coded bytes of the returns, grouped by the byte of the previous return. */
function readGrouped(data: Uint8Array, mask: Uint8Array): Uint8Array {
  const groups = data.length > 0 ? data[0] : 0;
  let at = 1 + 9 * groups;
  if (groups === 0 || data.length < at) throw damaged("the groups of intensities");
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const groupOf = new Uint8Array(256);
  let first = -1;
  let left = 0;
  for (let i = 0; i < mask.length; i++) left += mask[i];
  const parts = Array.from({ length: groups }, (_, g) => {
    const begin = view.getUint8(1 + 9 * g);
    const count = view.getUint32(2 + 9 * g, true);
    const size = view.getUint32(6 + 9 * g, true);
    if (begin <= first || (g === 0 && begin !== 0)) throw damaged("groups of intensities that do not rise from 0");
    if (count > left || size > data.length - at) throw damaged("groups of intensities of more than there is");
    first = begin;
    left -= count;
    groupOf.fill(g, begin);
    at += size;
    return zstdFrame(data.subarray(at - size, at), count);
  });
  if (left !== 0 || at !== data.length) throw damaged("groups of intensities that do not add up");
  const next = new Uint32Array(groups);
  const image = new Uint8Array(mask.length);
  let before = 0;
  for (let i = 0; i < mask.length; i++) {
    if (!mask[i]) continue;
    const g = groupOf[before];
    if (next[g] === parts[g].length) throw damaged(`group ${g} of intensities runs out`);
    before = parts[g][next[g]++];
    image[i] = before;
  }
  return image;
}
