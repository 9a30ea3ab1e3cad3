/** Codec raw: every plane without compression. */

import { TURN } from "./azimuth.js";
import { damaged } from "./errors.js";
import { type Message, Section, needed } from "./message.js";
import type { Planes } from "./planes.js";
import { firedCells } from "./rows.js";
import { ROWS, type Sensor } from "./sensor.js";

function words(data: Uint8Array): Uint16Array {
  const found = new Uint16Array(data.length >> 1);
  for (let i = 0; i < found.length; i++) found[i] = data[2 * i] | (data[2 * i + 1] << 8);
  return found;
}

function sized(data: Uint8Array, size: number, what: string): Uint8Array {
  if (data.length !== size) throw damaged(`raw ${what} of ${data.length} bytes, not ${size}`);
  return data;
}

/** All of a frame; ranges are 64 x W. */
export function readRaw(message: Message, sensor: Sensor): Planes & { range: Uint16Array } {
  const { width } = message;
  const cells = ROWS * width;
  const range = words(sized(needed(message, Section.RANGE, "ranges"), 2 * cells, "ranges"));
  const angles = sized(needed(message, Section.AZIMUTH, "azimuths"), 5 * width, "azimuths");
  const azimuth = words(angles.subarray(0, 4 * width));
  const halves = angles.subarray(4 * width);
  if (azimuth.some((angle) => angle >= TURN) || halves.some((bits) => bits > 3))
    throw damaged("a raw azimuth beyond a turn, or an unknown half");
  const fired = new Uint8Array(2 * width);
  halves.forEach((bits, column) => {
    fired[column] = bits & 1;
    fired[width + column] = bits >> 1;
  });
  const sent = message.section(Section.INTENSITY);
  const intensity = sent === null ? new Uint8Array(cells) : sized(sent, cells, "intensities").slice();
  const mask = new Uint8Array(cells);
  for (let i = 0; i < cells; i++) mask[i] = range[i] ? 1 : 0;
  const there = firedCells({ width, azimuth, fired }, sensor);
  for (let i = 0; i < cells; i++)
    if (!there[i] && (mask[i] || intensity[i])) throw damaged("returns in cells that were not fired");
  return { width, azimuth, fired, mask, intensity, range };
}
