/** The CLOUD section (docs/wire-format-clouds.md): a `sensor_msgs/PointCloud2` message. */

import { damaged } from "../errors.js";
import { LARGEST_WIDTH } from "../message.js";
import { Reader } from "../other/reader.js";
import { zstdFrame } from "../zstd.js";
import { type Bits, type Cells, columnsOf, type Image, readColumn, readPointBytes } from "./columns.js";
import { bytesOf, FieldType, isRegular, MOST_BYTES, MOST_POINTS, namedField, readHead } from "./message.js";
import { readPositions } from "./positions.js";

const [PLAIN, ZSTD, COLUMNS] = [0, 1, 2];
const MOST_BOUND = 100_000_000;
const MOST_ROWS = 128;
const MOST_CELLS = 1 << 20;

/** The message of a section, and the cells of its points, if they were sent as a range image. Rows count in the order of the
 * message, which may be from the lowest up. */
export interface Cloud {
  readonly payload: Uint8Array;
  readonly cells: Cells | null;
}

/** The planes of a PLANES section, (rows, columns) each; the first is `range`. */
export interface CloudPlanes {
  readonly rows: number;
  readonly planes: readonly { readonly name: string; readonly values: Uint32Array }[];
}

/** Reads a PLANES section, `columns` wide. */
export type ReadPlanes = (data: Uint8Array, columns: number) => CloudPlanes;

export function readCloud(data: Uint8Array, readPlanes: ReadPlanes): Cloud {
  const reader = new Reader(data);
  const kind = reader.byte();
  if (kind === COLUMNS) return readColumns(reader, readPlanes);
  if (kind === ZSTD) {
    const size = reader.varint(MOST_BYTES);
    return { payload: zstdFrame(reader.rest(), size), cells: null };
  }
  if (kind !== PLAIN || reader.left > MOST_BYTES) throw damaged(`a cloud of the kind ${kind}, of ${reader.left} bytes`);
  return { payload: reader.rest().slice(), cells: null };
}

function packed(reader: Reader, most: number): Uint8Array {
  const size = reader.varint(most);
  return size ? zstdFrame(reader.sized(), size) : new Uint8Array();
}

function readColumns(reader: Reader, readPlanes: ReadPlanes): Cloud {
  reader.varint(MOST_BOUND);
  const before = packed(reader, MOST_BYTES);
  const head = readHead(before);
  const { height, width, pointStep, dataBytes, bigEndian } = head;
  if (head.size !== before.length || !isRegular(head) || head.size + dataBytes > MOST_BYTES)
    throw damaged("the head of a cloud is not valid, or does not fit its points");
  const points = height * width;
  const between = dataBytes - points * pointStep;
  if (points === 0 || points > MOST_POINTS || between < 0) throw damaged(`a cloud of ${points} points in ${dataBytes} bytes`);
  const behind = packed(reader, between);
  const tail = packed(reader, MOST_BYTES - head.size - dataBytes);
  if (behind.length !== between) throw damaged("rows of a cloud that are not as long as their step");

  const kind = reader.byte();
  const order = kind === 0 ? null : readOrder(reader, kind, points);
  const positioned = reader.byte();
  if (positioned > 1 || (positioned === 1 && order === null)) throw damaged("coordinates by a range image that is not there");
  const planes = new Map<string, Uint32Array>();
  const cells = order && readCells(reader, order, points, readPlanes, planes);
  const bytes = new Uint8Array(points * pointStep);
  const put = (at: number, type: number, values: Bits): void => putValues(bytes, pointStep, at, bytesOf(type), values, bigEndian);
  let image: Image = { points, cells, geometry: null, n: new Uint32Array(points), k: new Int32Array(points) };
  if (positioned === 1) {
    const n = planes.get("range")!;
    const { geometry, k, xyz } = readPositions(reader.sized(), cells!, n);
    image = { points, cells, geometry, n, k };
    ["x", "y", "z"].forEach((name, axis) => {
      const field = namedField(head, name);
      if (field?.type !== FieldType.float32) throw damaged(`coordinates in a cloud without a FLOAT32 ${name}`);
      put(field.offset, field.type, xyz[axis]!);
    });
  }
  const { columns, gaps } = columnsOf(head, positioned === 1);
  columns.forEach(({ at, type }, number) => put(at, type, readColumn(reader, type, image, planes.get(`c${number}`))));
  putGaps(reader, bytes, points, pointStep, gaps);
  reader.end();
  return { payload: message(before, bytes, behind, tail, height), cells };
}

/** How points come in the range image. */
interface Order {
  readonly rows: number;
  readonly columns: number;
  readonly full: boolean;
  /** Rows of a column as they come; null: points come row by row. */
  readonly firing: Uint8Array | null;
}

function readOrder(reader: Reader, kind: number, points: number): Order {
  if (kind > 2) throw damaged(`a range image of the unknown kind ${kind}`);
  const [rows, columns, full] = [reader.byte() + 1, reader.varint(LARGEST_WIDTH, 1), reader.byte()];
  if (rows > MOST_ROWS || full > 1 || rows * columns > MOST_CELLS || rows * columns < points)
    throw damaged(`a range image of ${rows} x ${columns} for ${points} points`);
  const firing = kind === 2 ? reader.take(rows) : null;
  if (firing && (firing.some((row) => row >= rows) || new Set(firing).size < rows)) throw damaged("the order of firing is damaged");
  return { rows, columns, full: full === 1, firing };
}

/** The cells of points; puts the numbers that planes have there into `planes`. */
function readCells(reader: Reader, order: Order, points: number, readPlanes: ReadPlanes, planes: Map<string, Uint32Array>): Cells {
  const { rows, columns, full, firing } = order;
  const section = readPlanes(reader.sized(), columns);
  if (section.rows !== rows) throw damaged(`planes of ${section.rows} rows of a cloud of ${rows}`);
  const ranges = section.planes[0]!.values;
  const [row, column, cell] = [new Uint8Array(points), new Uint16Array(points), new Uint32Array(points)];
  let count = 0;
  const take = (r: number, c: number): void => {
    const at = r * columns + c;
    if (!full && ranges[at] === 0) return;
    if (count < points) {
      row[count] = r;
      column[count] = c;
      cell[count] = at;
    }
    count++;
  };
  if (firing) for (let c = 0; c < columns; c++) for (const r of firing) take(r, c);
  else for (let r = 0; r < rows; r++) for (let c = 0; c < columns; c++) take(r, c);
  if (count !== points) throw damaged(`a range image of ${count} points, not ${points}`);
  for (const { name, values } of section.planes) {
    const numbers = new Uint32Array(points);
    for (let i = 0; i < points; i++) numbers[i] = values[cell[i]!]!;
    planes.set(name, numbers);
  }
  return { rows, columns, row, column };
}

function putValues(to: Uint8Array, step: number, at: number, bytes: number, values: Bits, bigEndian: boolean): void {
  if (values instanceof BigInt64Array) {
    const view = new DataView(to.buffer);
    for (let i = 0; i < values.length; i++) view.setBigInt64(i * step + at, values[i]!, !bigEndian);
    return;
  }
  for (let byte = 0; byte < bytes; byte++) {
    const shift = 8 * (bigEndian ? bytes - 1 - byte : byte);
    for (let i = 0, place = at + byte; i < values.length; i++, place += step) to[place] = values[i]! >>> shift;
  }
}

/** Bytes of points that are in no column. */
function putGaps(reader: Reader, to: Uint8Array, points: number, step: number, gaps: Uint8Array): void {
  const count = gaps.reduce((sum, gap) => sum + gap, 0);
  if (count === 0) return;
  const bytes = readPointBytes(reader, points, count);
  let from = 0;
  for (let at = 0; at < step; at++) if (gaps[at]) for (let i = 0; i < points; i++) to[i * step + at] = bytes[from++]!;
}

function message(before: Uint8Array, points: Uint8Array, behind: Uint8Array, tail: Uint8Array, height: number): Uint8Array {
  const whole = new Uint8Array(before.length + points.length + behind.length + tail.length);
  whole.set(before);
  const [row, gap] = [points.length / height, behind.length / height];
  let at = before.length;
  for (let number = 0; number < height; number++) {
    whole.set(points.subarray(number * row, (number + 1) * row), at);
    whole.set(behind.subarray(number * gap, (number + 1) * gap), at + row);
    at += row + gap;
  }
  whole.set(tail, at);
  return whole;
}
