/** Form 3 of the CALIBRATION section (docs/wire-format.md): other sensors than an HDL-64E. */

import { damaged } from "../errors.js";
import { FIELDS, Field, HASH_BYTES, hex, sensorName } from "../sensor.js";
import { sha256 } from "../sha256.js";
import { zstdFrame } from "../zstd.js";

const HEAD_BYTES = 12;
const MOST_ROWS = 128;
const MOST_DESCRIPTION = 1 << 20;

export interface DescribedSensor {
  readonly name: string;
  /** As in docs/sensors.md: `vlp16`, `os1-128`. */
  readonly model: string;
  /** 16 hex digits that name sensor, table and description. */
  readonly hash: string;
  readonly convention: "ros" | "veloview";
  /** Metres of one range unit. */
  readonly rangeStep: number;
  readonly rows: number;
  /** 11 x rows, a row a value, a column a laser; as of an HDL-64E. */
  readonly table: Int32Array;
  /** Laser of each row of an image. */
  readonly laser: Uint8Array;
  /** What the sensor says of itself: of an Ouster its metadata JSON. */
  readonly description: Uint8Array;
}

export function readDescribed(data: Uint8Array): DescribedSensor {
  const at = 1 + HASH_BYTES;
  if (data.length < at + 4) throw damaged("a calibration ends within its head");
  const size = new DataView(data.buffer, data.byteOffset, data.byteLength).getUint32(at, true);
  if (size < HEAD_BYTES || size > MOST_DESCRIPTION + (1 << 14)) throw damaged(`a calibration that announces ${size} bytes`);
  const plain = zstdFrame(data.subarray(at + 4), size);
  const view = new DataView(plain.buffer, plain.byteOffset, plain.byteLength);
  const [convention, step, rows] = [plain[0]!, view.getUint32(1, true), plain[7]!];
  if (convention > 1 || step === 0 || rows < 1 || rows > MOST_ROWS)
    throw damaged(`convention ${convention}, range step ${step} and ${rows} rows of a calibration`);
  const nameEnd = HEAD_BYTES + plain[5]!;
  const modelEnd = nameEnd + plain[6]!;
  const end = modelEnd + view.getUint32(8, true);
  if (size !== end + 4 * FIELDS * rows) throw damaged(`a calibration of ${size} bytes whose parts do not add up`);
  const [name, model] = [plain.subarray(HEAD_BYTES, nameEnd), plain.subarray(nameEnd, modelEnd)];
  const description = plain.slice(modelEnd, end);
  if (model.some((byte) => byte > 0x7f)) throw damaged("a sensor's model that is not ASCII");
  const zero = Uint8Array.of(0);
  const hashed = joined([name, zero, plain.subarray(end), zero, model, zero, description]);
  const table = Int32Array.from({ length: FIELDS * rows }, (_, i) => view.getInt32(end + 4 * i, true));
  const vertical = table.subarray(Field.vertical * rows, (Field.vertical + 1) * rows);
  return {
    name: sensorName(name),
    model: String.fromCharCode(...model),
    hash: hex(sha256(hashed).subarray(0, HASH_BYTES)),
    convention: convention === 0 ? "ros" : "veloview",
    rangeStep: step / 10_000_000,
    rows,
    table,
    laser: Uint8Array.from({ length: rows }, (_, i) => i).sort((a, b) => vertical[b]! - vertical[a]! || a - b),
    description,
  };
}

function joined(parts: Uint8Array[]): Uint8Array {
  const whole = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    whole.set(part, at);
    at += part.length;
  }
  return whole;
}
