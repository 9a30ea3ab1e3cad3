/** A decoded frame in the bytes in which the cloud socket sends it (docs/live-sockets.md, form range). */

import { Field, ROWS, rowValues, type Sensor } from "../../../../typescript/src/sensor.js";
import type { Rings } from "./native.js";

const HEADER_BYTES = 96;
const POSE_BYTES = 96;
const INTENSITY = 1;
const POSE = 32;
const THINNED = 8;
const FILLED = 64;
const MADE_UP = 128;

export interface Image {
  readonly streamId: bigint;
  readonly index: bigint;
  readonly stampNs: bigint;
  readonly codec: number;
  readonly rows: number;
  readonly width: number;
  readonly range: Uint16Array;
  readonly azimuth: Uint16Array;
  readonly intensity: Uint8Array | null;
  /** rows x W, 1 for a return that was made up; null where nothing was to be. */
  readonly filled: Uint8Array | null;
  readonly rangeStep: number;
  /** Returns that were measured, where not all of them are in the image. */
  readonly measured?: number;
  /** 96 bytes, f64, as in the message. */
  readonly pose: Uint8Array | null;
}

const padded = (bytes: number) => (bytes + 3) & ~3;

/** nowMs: when it was decoded, ms since 1970 */
export function packImage(image: Image, nowMs: number): ArrayBuffer {
  const { rows, width, range, azimuth, intensity, filled, pose } = image;
  const header = HEADER_BYTES + (pose ? POSE_BYTES : 0);
  const cells = rows * width;
  const bytes = padded(cells);
  const intensityAt = header + padded(2 * cells) + 4 * width;
  const size = intensityAt + (intensity ? bytes : 0) + (filled ? bytes : 0);
  const data = new ArrayBuffer(size);
  const view = new DataView(data);
  new Uint8Array(data).set([0x4c, 0x44, 0x43, 0x52]); // LDCR
  view.setUint16(4, 1, true);
  view.setUint16(6, header, true);
  view.setBigUint64(8, image.streamId, true);
  view.setBigUint64(16, image.index, true);
  view.setBigInt64(24, image.stampNs, true);
  view.setBigInt64(32, BigInt(Math.round(nowMs * 1000)) * 1000n, true);
  view.setUint16(40, image.codec, true);
  view.setUint16(42, (intensity ? INTENSITY : 0) | (pose ? POSE : 0) | (filled ? FILLED | MADE_UP : 0), true);
  view.setFloat32(56, Number.NaN, true); // two clocks: only the page knows how far they are apart
  view.setFloat32(60, image.rangeStep, true);
  view.setUint16(76, width, true);
  view.setUint16(78, rows, true);
  view.setUint32(80, size, true);
  if (pose) new Uint8Array(data).set(pose, HEADER_BYTES);
  new Uint16Array(data, header, cells).set(range);
  new Uint16Array(data, header + padded(2 * cells), 2 * width).set(azimuth);
  if (intensity) new Uint8Array(data, intensityAt, cells).set(intensity);
  if (filled) new Uint8Array(data, size - bytes, cells).set(filled);
  let [returns, measured] = [0, 0];
  for (let i = 0; i < cells; i++) {
    if (range[i] === 0) continue;
    returns++;
    if (!filled?.[i]) measured++;
  }
  view.setUint32(44, returns, true);
  view.setUint32(48, image.measured ?? measured, true);
  if ((image.measured ?? measured) > measured) view.setUint16(42, view.getUint16(42, true) | THINNED, true);
  return data;
}

/** What the socket's event `sensor` says of a sensor: for each ring its laser, block and calibration. */
export interface SensorFacts {
  readonly name: string;
  readonly model: string;
  readonly hash: string;
  readonly origin: "message";
  readonly convention: "ros" | "veloview";
  readonly range_step_m: number;
  readonly rings: number;
  readonly laser: number[];
  readonly block: number[];
  readonly rot_correction_rad: number[];
  readonly vert_correction_rad: number[];
  readonly dist_correction_m: number[];
  readonly dist_correction_x_m: number[];
  readonly dist_correction_y_m: number[];
  readonly vert_offset_m: number[];
  readonly horiz_offset_m: number[];
}

export function factsOf(sensor: Sensor): SensorFacts {
  const values = (field: number, perUnit: number) => Array.from(rowValues(sensor, field), (steps) => steps / perUnit);
  return {
    name: sensor.name,
    model: "hdl64e",
    hash: sensor.hash,
    origin: "message",
    convention: sensor.convention,
    range_step_m: sensor.rangeStep,
    rings: ROWS,
    laser: [...sensor.laser],
    block: [...sensor.half],
    rot_correction_rad: values(Field.rotation, 1e8),
    vert_correction_rad: values(Field.vertical, 1e8),
    dist_correction_m: values(Field.distance, 1e7),
    dist_correction_x_m: values(Field.distanceX, 1e7),
    dist_correction_y_m: values(Field.distanceY, 1e7),
    vert_offset_m: values(Field.verticalOffset, 1e7),
    horiz_offset_m: values(Field.horizontalOffset, 1e7),
  };
}

/** The same of another sensor. */
export function factsOfRings({ name, model, hash, rangeStep, laser, values }: Rings): SensorFacts {
  const rings = laser.length;
  const numbers = (at: number) => Array.from(laser, (_, ring) => values[(ring * values.length) / rings + at] as number);
  const distance = numbers(2);
  return {
    name,
    model,
    hash,
    origin: "message",
    convention: "veloview",
    range_step_m: rangeStep,
    rings,
    laser: [...laser],
    block: Array.from(laser, () => 0),
    rot_correction_rad: numbers(0),
    vert_correction_rad: numbers(1),
    dist_correction_m: distance,
    dist_correction_x_m: distance,
    dist_correction_y_m: distance,
    vert_offset_m: numbers(3),
    horiz_offset_m: numbers(4),
  };
}
