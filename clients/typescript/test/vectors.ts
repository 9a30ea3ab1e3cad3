/** The shared test vectors (tests/vectors): files of messages, and what must come out of each. */

import { createHash } from "node:crypto";
import { existsSync, readFileSync, readdirSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const ROOT = repository(dirname(fileURLToPath(import.meta.url)));

function repository(folder: string): string {
  return existsSync(join(folder, "tests", "vectors")) ? folder : repository(dirname(folder));
}

export interface Expected {
  stream: string;
  index: string;
  stamp_ns: string;
  sensor: [string, string, string, number];
  width: number;
  returns: number;
  range: string;
  intensity: string;
  azimuth: string;
  fired: string;
  pose: number[] | null;
  mount?: number[];
  points: number[][];
  /** Of a thinned frame: its sent columns, the number of interpolated returns, and digests of the filled images (which
   * returns were interpolated, ranges, intensities). */
  lattice?: string;
  made_up?: number;
  filled?: [string, string, string];
}

/** Of another sensor than an HDL-64E: tests/vectors/other_sensors.py says what each is. */
export interface ExpectedOther {
  stream: string;
  index: string;
  stamp_ns: string;
  sensor: [string, string, string, number];
  model: string;
  rows: number;
  width: number;
  returns: number;
  planes: Record<string, string>;
  azimuth: string;
  lattice: string | null;
  layout: string;
  packet_ns: string;
  odd: number[];
  series: Record<string, string>;
  pose: number[] | null;
  /** x, y, z, intensity, ring, number of the return, and its time, of the first, middle and last point. */
  points: [number, number, number, number, number, number, string][];
  /** Points of both returns. */
  cloud: number;
  shown: { range: string; intensity: string; range_step_m: number; rings: number[][] | null };
}

/** Of a point cloud: tests/vectors/cloud_vectors.py says what each is. */
export interface ExpectedCloud {
  stream: string;
  index: string;
  stamp_ns: string;
  sensor: [string, string, string, number];
  rows: number;
  /** Digest and size of the message. */
  message: string;
  bytes: number;
  /** Name, type as numpy has it, and number of values of each field. */
  fields: [string, string, number][];
  /** Points with a return. */
  returns: number;
  /** x, y and z of the first, middle and last point. */
  points: [number, number, number][];
  /** What the server gives to viewers; sums of ranges and intensities. */
  shown: { rows: number; columns: number; drawn: number; range: number; intensity: number; step_m: number };
}

export interface Vector<E = Expected> {
  name: string;
  messages: Uint8Array[];
  expected: E[];
}

function split(data: Uint8Array): Uint8Array[] {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const found: Uint8Array[] = [];
  for (let at = 0; at < data.length; at += view.getUint32(at + 8, true))
    found.push(data.subarray(at, at + view.getUint32(at + 8, true)));
  return found;
}

/** The vectors of other sensors than an HDL-64E whose name, without `other_`, matches. */
export function otherVectors(fits: RegExp): Vector<ExpectedOther>[] {
  return read<ExpectedOther>((name) => name.startsWith("other_") && fits.test(name.slice(6)));
}

/** The vectors of an HDL-64E whose name matches. */
export function vectors(fits: RegExp): Vector[] {
  return read<Expected>((name) => !name.startsWith("other_") && fits.test(name));
}

/** The vectors of point clouds whose name matches. */
export function cloudVectors(fits: RegExp): Vector<ExpectedCloud>[] {
  return read<ExpectedCloud>((name) => fits.test(name), "point_clouds");
}

function read<E>(wanted: (name: string) => boolean, under = ""): Vector<E>[] {
  const folder = join(ROOT, "tests", "vectors", under);
  const names = readdirSync(folder).filter((name) => name.endsWith(".json"));
  return names
    .map((name) => name.slice(0, -5))
    .filter(wanted)
    .map((name) => {
      const golden = name.startsWith("golden_");
      const file = golden ? join(ROOT, "tests", "golden", `${name.slice(7)}.bin`) : join(folder, `${name}.bin`);
      const expected = JSON.parse(readFileSync(join(folder, `${name}.json`), "utf8")) as E[];
      return { name, messages: split(new Uint8Array(readFileSync(file))), expected };
    });
}

export function digest(array: Uint8Array | Uint16Array | Uint32Array | BigInt64Array | BigUint64Array): string {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  return createHash("sha256").update(bytes).digest("hex").slice(0, 16);
}
