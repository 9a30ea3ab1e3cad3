/** Columns of a CLOUD section (docs/wire-format-clouds.md, "Columns"): fields of all points of a cloud. */

import { damaged } from "../errors.js";
import type { Reader } from "../other/reader.js";
import { readLine, signedNumbers } from "../other/rest.js";
import { zstdFrame } from "../zstd.js";
import { ANGLES, bitsOfOrdered, type CloudGeometry, driverRadians, ordered, turnsOf } from "./geometry.js";
import { bytesOf, type CloudHead, FieldType } from "./message.js";
import { RestReader, unzigzag } from "./rests.js";

const MOST_REPEATED = 16;
const WIDEST = 1n << 60n;
const EXACT = 2n ** 51n;
const TICK = 1e-9;
const Way = { bytes: 0, constant: 1, row: 2, range: 3, metres: 4, plane: 5, whole: 6, byRow: 7, sums: 8, times: 9, angle: 10, steps: 11 } as const;
/** Least and largest number of each type; of floats that of their order. */
const LIMITS: readonly (readonly [number, number])[] = [
  [0, 0],
  [-128, 127],
  [0, 255],
  [-32_768, 32_767],
  [0, 65_535],
  [-2_147_483_648, 2_147_483_647],
  [0, 4_294_967_295],
  [-2_147_483_648, 2_147_483_647],
];

/** Cells of points in a range image. */
export interface Cells {
  readonly rows: number;
  readonly columns: number;
  readonly row: Uint8Array;
  readonly column: Uint16Array;
}

/** What columns refer to. n and k are 0 where they mean nothing. */
export interface Image {
  readonly points: number;
  readonly cells: Cells | null;
  readonly geometry: CloudGeometry | null;
  readonly n: Uint32Array;
  readonly k: Int32Array;
}

/** Bits of the values of a column, of numbers of 8 bytes as bigints. */
export type Bits = Uint32Array | BigInt64Array;

export interface Column {
  /** First byte in a point. */
  readonly at: number;
  readonly type: number;
}

/** The columns of points, and the bytes of a point that are in none. */
export function columnsOf(head: CloudHead, withoutXyz: boolean): { columns: Column[]; gaps: Uint8Array } {
  const gaps = new Uint8Array(head.pointStep).fill(1);
  const columns: Column[] = [];
  for (const { name, offset, type, count } of head.fields) {
    if (count > MOST_REPEATED) continue;
    const bytes = bytesOf(type);
    for (let at = offset; at < offset + count * bytes; at += bytes) {
      const own = gaps.subarray(at, at + bytes);
      if (own.includes(0)) continue;
      if (!withoutXyz || count !== 1 || !["x", "y", "z"].includes(name)) columns.push({ at, type });
      own.fill(0);
    }
  }
  return { columns, gaps };
}

/** Bytes of points as of way 0: the first ones of all, then the second ones, ... */
export function readPointBytes(reader: Reader, points: number, bytes: number): Uint8Array {
  const form = reader.byte();
  if (form > 1) throw damaged(`bytes of points of the unknown form ${form}`);
  const plain = zstdFrame(reader.sized(), points * bytes);
  if (form === 1)
    for (let byte = 0; byte < bytes; byte++)
      for (let i = byte * points + 1; i < (byte + 1) * points; i++) plain[i] = (plain[i]! + plain[i - 1]!) & 0xff;
  return plain;
}

/** plane: numbers of its plane, if it has one */
export function readColumn(reader: Reader, type: number, image: Image, plane: Uint32Array | undefined): Bits {
  const way = reader.byte();
  const { points, cells, geometry } = image;
  const unknown = () => damaged(`a column of a cloud coded in the way ${way}, which does not fit it`);
  if (way === Way.bytes) return joined(readPointBytes(reader, points, bytesOf(type)), points, type);
  if (way === Way.constant) return constant(reader.take(bytesOf(type)), points, type);
  const long = type === FieldType.float64;
  const base = long ? bigint(reader.take(8)) : 0n;
  if (way === Way.steps) return steps(reader, points, type, base);
  if (cells === null) throw unknown();
  if (way === Way.byRow) {
    const line = readLine(reader, cells.rows);
    if (!long) return fromNumbers(spread(Float64Array.from(line, Number), cells.row), type);
    const numbers = new BigInt64Array(points);
    for (let i = 0; i < points; i++) numbers[i] = line[cells.row[i]!]! + base;
    return numbers;
  }
  if (way === Way.sums) return sums(reader, cells, type, base);
  if (long) throw unknown();
  if (way === Way.row) return fromNumbers(cells.row, type);
  if (way === Way.range) return fromNumbers(image.n, type);
  if ((way === Way.plane || way === Way.whole) && plane === undefined) throw damaged("a column of a cloud without its plane");
  if (way === Way.plane) return fromNumbers(plane!, type);
  if (type !== FieldType.float32) throw unknown();
  if (way === Way.whole) return singles(plane!, 1);
  if (way === Way.times) return times(reader, cells);
  if (geometry !== null && way === Way.metres) return singles(image.n, Math.fround(geometry.stepM));
  if (geometry !== null && way === Way.angle) return angles(reader, image, cells, geometry);
  throw unknown();
}

/** Bits of numbers times a float32, as float32. */
function singles(numbers: Uint32Array, by: number): Uint32Array {
  const found = new Float32Array(numbers.length);
  for (let i = 0; i < found.length; i++) found[i] = numbers[i]! * by;
  return new Uint32Array(found.buffer);
}

function bigint(bytes: Uint8Array): bigint {
  return new DataView(bytes.buffer, bytes.byteOffset).getBigInt64(0, true);
}

function spread(line: Float64Array, row: Uint8Array): Float64Array {
  const found = new Float64Array(row.length);
  for (let i = 0; i < found.length; i++) found[i] = line[row[i]!]!;
  return found;
}

function joined(plain: Uint8Array, points: number, type: number): Bits {
  const bytes = bytesOf(type);
  if (bytes === 8) {
    const own = new Uint8Array(8 * points);
    for (let byte = 0; byte < 8; byte++) for (let i = 0; i < points; i++) own[8 * i + byte] = plain[byte * points + i]!;
    const view = new DataView(own.buffer);
    return BigInt64Array.from({ length: points }, (_, i) => view.getBigInt64(8 * i, true));
  }
  const found = new Uint32Array(points);
  for (let byte = 0; byte < bytes; byte++)
    for (let i = 0; i < points; i++) found[i] = (found[i]! | (plain[byte * points + i]! << (8 * byte))) >>> 0;
  return found;
}

function constant(bytes: Uint8Array, points: number, type: number): Bits {
  if (type === FieldType.float64) return new BigInt64Array(points).fill(bigint(bytes));
  return new Uint32Array(points).fill(bytes.reduce((sum, byte, at) => sum + byte * 256 ** at, 0));
}

/** Numbers as the bits of a type. */
function fromNumbers(numbers: ArrayLike<number> | BigInt64Array, type: number): Bits {
  if (type === FieldType.float64) return numbers as BigInt64Array;
  const [least, most] = LIMITS[type]!;
  const found = new Uint32Array(numbers.length);
  for (let i = 0; i < found.length; i++) {
    const number = Number(numbers[i]);
    if (number < least || number > most) throw damaged(`a number that does not fit a column of type ${type}`);
    found[i] = type === FieldType.float32 ? bitsOfOrdered(number) : number;
  }
  return found;
}

function steps(reader: Reader, points: number, type: number, base: bigint): Bits {
  const [numbers] = signedNumbers(reader.sized(), [points]) as [BigInt64Array];
  if (points) numbers[0]! += base;
  for (let i = 1; i < points; i++) numbers[i]! += numbers[i - 1]!;
  return fromNumbers(numbers, type);
}

/** The rests of a field, each in the context of those of its row and its column before it. */
class FieldRests {
  readonly #rests: RestReader;
  readonly #cells: Cells;
  readonly #rows: Uint8Array;
  readonly #columns: Uint8Array;

  constructor(data: Uint8Array, cells: Cells) {
    this.#rests = new RestReader(data);
    this.#cells = cells;
    this.#rows = new Uint8Array(cells.rows);
    this.#columns = new Uint8Array(cells.columns);
  }

  of(point: number): number {
    const [row, column] = [this.#cells.row[point]!, this.#cells.column[point]!];
    const rest = this.#rests.next(4 * this.#rows[row]! + this.#columns[column]!);
    this.#rows[row] = this.#columns[column] = Math.min(rest, 3);
    return unzigzag(rest);
  }

  end(): void {
    this.#rests.end();
  }
}

interface Lines {
  readonly byColumn: BigInt64Array;
  readonly byRow: BigInt64Array;
}

function lines(reader: Reader, cells: Cells): Lines {
  const found = { byColumn: readLine(reader, cells.columns), byRow: readLine(reader, cells.rows) };
  if ([found.byColumn, found.byRow].some((line) => line.some((number) => number <= -WIDEST || number >= WIDEST)))
    throw damaged("a number of a column or row beyond 60 bits");
  return found;
}

/** Whether numbers are exact as those of JavaScript, with some added. */
function exact(line: BigInt64Array): boolean {
  return line.every((number) => number > -EXACT && number < EXACT);
}

function sums(reader: Reader, cells: Cells, type: number, base: bigint): Bits {
  const { byColumn, byRow } = lines(reader, cells);
  const rests = new FieldRests(reader.sized(), cells);
  const points = cells.row.length;
  let numbers: Float64Array | BigInt64Array;
  if (type !== FieldType.float64 && exact(byColumn) && exact(byRow)) {
    const [columns, rows] = [Float64Array.from(byColumn, Number), Float64Array.from(byRow, Number)];
    numbers = new Float64Array(points);
    for (let i = 0; i < points; i++) numbers[i] = columns[cells.column[i]!]! + rows[cells.row[i]!]! + rests.of(i);
  } else {
    numbers = new BigInt64Array(points);
    for (let i = 0; i < points; i++) numbers[i] = byColumn[cells.column[i]!]! + byRow[cells.row[i]!]! + BigInt(rests.of(i)) + base;
  }
  rests.end();
  return fromNumbers(numbers, type);
}

function times(reader: Reader, cells: Cells): Bits {
  const { byColumn, byRow } = lines(reader, cells);
  const rests = new FieldRests(reader.sized(), cells);
  const found = new Uint32Array(cells.row.length);
  const plain = exact(byColumn) && exact(byRow);
  for (let i = 0; i < found.length; i++) {
    const [column, row] = [byColumn[cells.column[i]!]!, byRow[cells.row[i]!]!];
    const told = plain ? Number(column) + Number(row) : Number(column + row);
    const number = ordered(told * TICK) + rests.of(i);
    found[i] = bitsOfOrdered(Math.min(Math.max(number, -(2 ** 31)), 2 ** 31 - 1));
  }
  rests.end();
  return found;
}

function angles(reader: Reader, image: Image, cells: Cells, geometry: CloudGeometry): Bits {
  const sense = reader.byte();
  if (sense < 1 || sense >= ANGLES.length) throw damaged(`an angle of the unknown sense ${sense}`);
  const rests = new FieldRests(reader.sized(), cells);
  const numbers = new Float64Array(image.points);
  for (let i = 0; i < image.points; i++) {
    const turns = turnsOf(geometry, geometry.rows[cells.row[i]!]!, image.k[i]!);
    numbers[i] = ordered(driverRadians(turns, sense)) + rests.of(i);
  }
  rests.end();
  return fromNumbers(numbers, FieldType.float32);
}
