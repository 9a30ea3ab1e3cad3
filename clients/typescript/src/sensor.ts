/** The CALIBRATION section: the sensor's calibration and units. */

import { DecodeError, damaged } from "./errors.js";
import { type Message, Section, needed } from "./message.js";
import { sha256 } from "./sha256.js";
import { zstdFrame } from "./zstd.js";

export const ROWS = 64;
export const FIELDS = 11;
const TABLE_BYTES = FIELDS * ROWS * 4;
export const HASH_BYTES = 8;
const KEPT = 8;

/** Rows of the calibration table. Angles in 1e-8 rad, lengths in 1e-7 m. */
export const Field = {
  rotation: 0,
  vertical: 1,
  distance: 2,
  distanceX: 3,
  distanceY: 4,
  verticalOffset: 5,
  horizontalOffset: 6,
} as const;

export interface Sensor {
  readonly name: string;
  /** 16 hex digits that name sensor and table. */
  readonly hash: string;
  readonly convention: "ros" | "veloview";
  /** Metres of one range unit. */
  readonly rangeStep: number;
  /** 11 x 64, a row for each value, a column for each laser. */
  readonly table: Int32Array;
  /** Laser of each row of an image: by descending vertical correction, then ascending id. */
  readonly laser: Uint8Array;
  /** Half of a column in which each row fires: 0 upper (lasers 0 to 31), 1 lower. */
  readonly half: Uint8Array;
}

/** One value of the table for each row of an image. */
export function rowValues(sensor: Sensor, field: number): Int32Array {
  return Int32Array.from(sensor.laser, (laser) => sensor.table[field * ROWS + laser]);
}

export function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export function sensorName(bytes: Uint8Array): string {
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes);
  } catch {
    throw damaged("a sensor name that is not UTF-8");
  }
}

/** A sensor of forms 1 and 2 of the section, an HDL-64E. */
export function readSensor(data: Uint8Array): Sensor {
  const at = 1 + HASH_BYTES;
  if (data.length < at + 6) throw damaged("a calibration ends within its head");
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const convention = data[at];
  const step = view.getUint32(at + 1, true);
  const nameEnd = at + 6 + data[at + 5];
  if (convention > 1 || step === 0) throw damaged(`convention ${convention}, range step ${step} of a calibration`);
  if (data.length < nameEnd) throw damaged("a calibration ends within its name");
  const nameBytes = data.subarray(at + 6, nameEnd);
  const name = sensorName(nameBytes);
  const rest = data.subarray(nameEnd);
  const bytes = data[0] === 1 ? zstdFrame(rest, TABLE_BYTES) : rest;
  if (bytes.length !== TABLE_BYTES) throw damaged(`a calibration table of ${bytes.length} bytes`);
  const hashed = new Uint8Array(nameBytes.length + 1 + TABLE_BYTES);
  hashed.set(nameBytes);
  hashed.set(bytes, nameBytes.length + 1);
  const hash = hex(sha256(hashed).subarray(0, HASH_BYTES));

  const tableView = new DataView(bytes.buffer, bytes.byteOffset, TABLE_BYTES);
  const table = Int32Array.from({ length: FIELDS * ROWS }, (_, i) => tableView.getInt32(4 * i, true));
  const vertical = table.subarray(Field.vertical * ROWS, (Field.vertical + 1) * ROWS);
  const laser = Uint8Array.from({ length: ROWS }, (_, i) => i).sort((a, b) => vertical[b] - vertical[a] || a - b);
  return {
    name,
    hash,
    convention: convention === 0 ? "ros" : "veloview",
    rangeStep: step / 10_000_000,
    table,
    laser,
    half: laser.map((id) => (id < 32 ? 0 : 1)),
  };
}

/** Sensors that key messages described, by hash; the last eight. forms: of the section that describe such a sensor. */
export class SensorBook<S extends { readonly hash: string }> {
  readonly #known = new Map<string, { data: Uint8Array; sensor: S }>();
  readonly #forms: readonly number[];
  readonly #read: (data: Uint8Array) => S;

  constructor(forms: readonly number[], read: (data: Uint8Array) => S) {
    this.#forms = forms;
    this.#read = read;
  }

  of(message: Message): S {
    const data = needed(message, Section.CALIBRATION, "calibration");
    if (data.length < 1 + HASH_BYTES || (data[0] !== 0 && !this.#forms.includes(data[0]!))) throw damaged(`a calibration of ${data.length} bytes, form ${data[0]}`);
    const hash = hex(data.subarray(1, 1 + HASH_BYTES));
    let known = this.#known.get(hash);
    if (data[0] === 0) {
      if (data.length !== 1 + HASH_BYTES) throw damaged("bytes after a calibration's hash");
      if (!known) throw new DecodeError("reference", `calibration ${hash} comes with a key message: ask for one`);
    } else if (!known || !same(known.data, data)) {
      known = { data: data.slice(), sensor: this.#read(data) };
      if (known.sensor.hash !== hash) throw damaged(`a calibration of hash ${known.sensor.hash} with another one in it`);
    }
    this.#known.delete(hash); // and to the end: the one used longest ago gives way
    this.#known.set(hash, known);
    if (this.#known.size > KEPT) this.#known.delete(this.#known.keys().next().value as string);
    return known.sensor;
  }
}

function same(a: Uint8Array, b: Uint8Array): boolean {
  return a.length === b.length && a.every((byte, at) => byte === b[at]);
}
