/** The PLANES section (docs/wire-format-other-sensors.md), kinds 0 and 1: all images of a frame. */

import { DecodeError, damaged } from "../errors.js";
import { LARGEST_WIDTH } from "../message.js";
import { zstdFrame } from "../zstd.js";
import { Reader } from "./reader.js";

const MOST_ROWS = 128;
const MOST_PLANES = 12;
export const MOST_NUMBERS = 5_242_880;
const MOST_STEP = 40_001;
const MOST_BITS = 20;
const ATTRIBUTE = 2;
const [REDUCED, WITH_TABLES] = [64, 128];
const ROLES = ["range", "second range", "attribute"] as const;

/** An image, rows x W. */
export interface Plane {
  /** `range`, `intensity`, `range2`, `signal`, ... */
  readonly name: string;
  readonly role: (typeof ROLES)[number];
  readonly bits: number;
  /** Of an attribute, the range plane that it describes. */
  readonly of: string;
  readonly values: Uint32Array;
}

interface Form {
  readonly name: string;
  readonly role: number;
  readonly bits: number;
  readonly of: number;
}

export interface PlaneSection {
  readonly rows: number;
  readonly planes: Plane[];
}

/** The planes of a section, `columns` wide. */
export function readPlaneSection(data: Uint8Array, columns: number): PlaneSection {
  const reader = new Reader(data);
  const marks = reader.byte();
  const kind = marks & ~(REDUCED | WITH_TABLES);
  const rows = reader.byte() + 1;
  const step = reader.varint(MOST_STEP, 1);
  const count = reader.varint(MOST_PLANES, 1);
  if (kind > 1) throw new DecodeError("version", `planes of kind ${kind}: this decoder reads 0 and 1`);
  if (rows > MOST_ROWS || columns > LARGEST_WIDTH || rows * columns * count > MOST_NUMBERS)
    throw damaged(`${count} planes of ${rows} x ${columns}`);
  if (step % 2 === 0) throw damaged(`a range step of ${step}`);
  const forms = Array.from({ length: count }, () => readForm(reader));
  checkForms(forms);
  for (let row = 0; row < rows; row++) reader.signed(BigInt(LARGEST_WIDTH)); // by which kind 2 moves rows
  const tables = marks & WITH_TABLES ? readTables(reader, forms) : forms.map(() => null);

  const cells = rows * columns;
  const widths = forms.map(({ bits }, i) => (tables[i] ? 1 : bits <= 8 ? 1 : bits <= 16 ? 2 : 4));
  const size = widths.reduce((sum, width) => sum + cells * width, 0);
  const body = kind === 1 ? zstdFrame(reader.rest(), size) : reader.rest();
  if (body.length !== size) throw damaged(`planes of ${body.length} bytes where ${size} are expected`);
  let at = 0;
  const numbers = widths.map((width) => {
    const part = body.subarray(at, at + cells * width);
    at += cells * width;
    return kind === 1 ? summed(part, rows, columns, width) : plain(part, cells, width);
  });
  forms.forEach((form, i) => scale(form, tables[i] ? 8 : form.bits, numbers[i]!, step));
  forms.forEach((form, i) => lookUp(form, numbers[i]!, tables[i]!, numbers[form.of]!));
  const planes = forms.map(({ name, role, bits, of }, i) => ({
    name,
    role: ROLES[role]!,
    bits,
    of: role === ATTRIBUTE ? forms[of]!.name : name,
    values: numbers[i]!,
  }));
  return { rows, planes };
}

function readForm(reader: Reader): Form {
  const [role, bits, of] = [reader.byte(), reader.byte(), reader.byte()];
  const name = reader.name(16, 1);
  if (role > ATTRIBUTE || bits < 1 || bits > MOST_BITS) throw damaged(`a plane of role ${role} and ${bits} bits`);
  return { name, role, bits, of };
}

function checkForms(forms: Form[]): void {
  if (forms[0]!.name !== "range" || forms[0]!.role !== 0 || new Set(forms.map(({ name }) => name)).size < forms.length)
    throw damaged("planes whose names occur twice, or whose first is not the ranges");
  for (const { name, role, of } of forms) {
    if (of >= forms.length || (role === ATTRIBUTE && forms[of]!.role === ATTRIBUTE))
      throw damaged(`plane ${name} belongs to plane ${of}, which is not one of ranges`);
  }
}

/** What the number 1 stands for. */
function valueOfOne(step: number): number {
  return (((step - 1) / 2 + 1) / 2) | 0;
}

/** Of each plane the values that it has, ascending; null for a plane without a table. */
function readTables(reader: Reader, forms: Form[]): (number[] | null)[] {
  const tables = Array.from({ length: reader.varint(forms.length, 1) }, () => {
    const table: number[] = [];
    for (let left = reader.varint(256, 1); left > 0; left--) {
      const step = reader.varint(1 << 20);
      if (step === 0 && table.length) throw damaged("a table of values that do not ascend");
      table.push((table.at(-1) ?? 0) + step);
    }
    return table;
  });
  return forms.map(({ name, role, bits }) => {
    const number = reader.byte();
    if (number === 0) return null;
    if (number > tables.length || role !== ATTRIBUTE) throw damaged(`plane ${name} with table ${number}`);
    const table = tables[number - 1]!;
    if (table.at(-1)! >= 2 ** bits) throw damaged(`plane ${name} of ${bits} bits with a table beyond them`);
    return table;
  });
}

function plain(data: Uint8Array, cells: number, width: number): Uint32Array {
  const values = new Uint32Array(cells);
  for (let i = 0; i < cells; i++)
    for (let byte = 0; byte < width; byte++) values[i] = values[i]! | (data[i * width + byte]! << (8 * byte));
  return values;
}

/** Sums along rows of differences, whose lowest bytes come first. */
function summed(data: Uint8Array, rows: number, columns: number, width: number): Uint32Array {
  const cells = rows * columns;
  const values = new Uint32Array(cells);
  for (let byte = 0; byte < width; byte++)
    for (let i = 0; i < cells; i++) values[i] = values[i]! | (data[byte * cells + i]! << (8 * byte));
  const modulo = 2 ** (8 * width);
  for (let row = 0; row < rows; row++)
    for (let at = row * columns + 1; at < (row + 1) * columns; at++) values[at] = (values[at]! + values[at - 1]!) % modulo;
  return values;
}

/** Numbers become values, in place. */
function scale({ name, role }: Form, bits: number, numbers: Uint32Array, step: number): void {
  const most = 2 ** bits - 1;
  if (role === ATTRIBUTE || step === 1) {
    if (numbers.some((value) => value > most)) throw damaged(`plane ${name} holds a number of more than ${bits} bits`);
    return;
  }
  const one = Math.min(valueOfOne(step), most); // a step may be too large for the plane
  for (let i = 0; i < numbers.length; i++) {
    const number = numbers[i]!;
    if (number > 0) numbers[i] = number === 1 ? one : Math.min((number - 1) * step, most);
  }
}

/** Places in a table become values, in place. */
function lookUp({ name }: Form, numbers: Uint32Array, table: number[] | null, ranges: Uint32Array): void {
  if (table === null) return;
  for (let i = 0; i < numbers.length; i++) {
    const value = ranges[i] ? table[numbers[i]!] : 0;
    if (value === undefined) throw damaged(`plane ${name} holds places beyond its ${table.length} values`);
    numbers[i] = value;
  }
}
