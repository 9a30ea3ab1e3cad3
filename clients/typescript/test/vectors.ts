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
  points: number[][];
  /** Of a thinned frame: its columns, and the images with what is made up between them: which, ranges, intensities. */
  lattice?: string;
  made_up?: number;
  filled?: [string, string, string];
}

export interface Vector {
  name: string;
  messages: Uint8Array[];
  expected: Expected[];
}

function split(data: Uint8Array): Uint8Array[] {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const found: Uint8Array[] = [];
  for (let at = 0; at < data.length; at += view.getUint32(at + 8, true))
    found.push(data.subarray(at, at + view.getUint32(at + 8, true)));
  return found;
}

/** Those whose name fits. */
export function vectors(fits: RegExp): Vector[] {
  const folder = join(ROOT, "tests", "vectors");
  const names = readdirSync(folder).filter((name) => name.endsWith(".json"));
  return names
    .map((name) => name.slice(0, -5))
    .filter((name) => fits.test(name))
    .map((name) => {
      const golden = name.startsWith("golden_");
      const file = golden ? join(ROOT, "tests", "golden", `${name.slice(7)}.bin`) : join(folder, `${name}.bin`);
      const expected = JSON.parse(readFileSync(join(folder, `${name}.json`), "utf8")) as Expected[];
      return { name, messages: split(new Uint8Array(readFileSync(file))), expected };
    });
}

export function digest(array: Uint8Array | Uint16Array): string {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  return createHash("sha256").update(bytes).digest("hex").slice(0, 16);
}
