/** Positions of a CLOUD section (docs/wire-format-clouds.md): directions, then what is left of each coordinate. */

import { damaged } from "../errors.js";
import type { Reader } from "../other/reader.js";
import { Reader as Bytes } from "../other/reader.js";
import { signedNumbers } from "../other/rest.js";
import { zstdFrame } from "../zstd.js";
import type { Cells } from "./columns.js";
import { ANGLES, bitsOfOrdered, bitsOfSingle, type CloudGeometry, exponent, nearest, ordered, type Place, placeOf, turnsOf } from "./geometry.js";
import { RestReader, unzigzag } from "./rests.js";

const HEAD_BYTES = 23;
const MOST_TURN = 2 ** 28;
const WIDEST = 1e15;
const [FINE, COARSE] = [2 ** -36, 2 ** -28];
const [LAST_PLACES, DECIMALS, METRES] = [0, 1, 2];

export interface Positions {
  readonly geometry: CloudGeometry;
  /** Direction of each point. */
  readonly k: Int32Array;
  /** Bits of x, y and z of each point. */
  readonly xyz: readonly [Uint32Array, Uint32Array, Uint32Array];
}

interface Left {
  readonly form: number;
  readonly unit: number;
}

/** n: of each point */
export function readPositions(data: Uint8Array, cells: Cells, n: Uint32Array): Positions {
  const reader = new Bytes(data);
  const [geometry, left] = readGeometry(reader, cells.rows);
  const coded = new Bytes(reader.sized());
  const form = coded.byte();
  if (form > 1) throw damaged(`directions of the unknown form ${form}`);
  const step = form === 1 ? Number(coded.signed(BigInt(Math.floor(geometry.turn / 2)))) : null;
  const directions = new Directions(geometry.turn, step, cells);
  const [turned, ...rests] = [0, 1, 2, 3].map(() => new RestReader(coded.sized())) as [RestReader, ...RestReader[]];
  coded.end();
  const k = new Int32Array(n.length);
  const xyz: Positions["xyz"] = [new Uint32Array(n.length), new Uint32Array(n.length), new Uint32Array(n.length)];
  const lengths = new Uint8Array(3 * cells.rows);
  const place: Place = [0, 0, 0, 0];
  for (let point = 0; point < n.length; point++) {
    if (n[point] === 0) continue;
    const row = cells.row[point]!;
    k[point] = directions.next(turned, row, cells.column[point]!);
    const of = geometry.rows[row]!;
    placeOf(geometry, of, n[point]!, turnsOf(geometry, of, k[point]!), place);
    const far = exponent(place[3]);
    for (let axis = 0; axis < 3; axis++) {
      const off = Math.min(Math.max(far - exponent(place[axis]!) + 1, 0), 7);
      const rest = rests[axis]!.next(8 * off + lengths[3 * row + axis]!);
      lengths[3 * row + axis] = Math.min(32 - Math.clz32(rest), 7);
      xyz[axis]![point] = bitsOf(place[axis]!, unzigzag(rest), left);
    }
  }
  for (const one of [turned, ...rests]) one.end();
  readApart(reader, n, xyz);
  reader.end();
  return { geometry, k, xyz };
}

/** A coordinate from its prediction and what is left. */
function bitsOf(told: number, rest: number, { form, unit }: Left): number {
  if (form === LAST_PLACES)
    return bitsOfOrdered(Math.min(Math.max(ordered(told) + rest, -(2 ** 31)), 2 ** 31 - 1));
  if (form === DECIMALS) return bitsOfSingle((whole(told * unit) + rest) / unit);
  return bitsOfSingle(told + rest * unit);
}

function whole(value: number): number {
  return nearest(value > -WIDEST ? Math.min(value, WIDEST) : -WIDEST); // not a number, too
}

function readGeometry(reader: Reader, rows: number): [CloudGeometry, Left] {
  const head = reader.take(HEAD_BYTES);
  const view = new DataView(head.buffer, head.byteOffset);
  const [narrow, stepM, turn, angles] = [head[0]!, view.getFloat64(1, true), view.getUint32(9, true), head[13]!];
  const [form, unit] = [head[14]!, view.getFloat64(15, true)];
  const known = narrow <= 1 && angles < ANGLES.length && form <= METRES && turn >= 1 && turn <= MOST_TURN;
  if (!known || !(stepM > 1e-9 && stepM < 1e3) || !(unit > 1e-9 && unit < 1e6))
    throw damaged(`a geometry of ${turn} steps of a turn and ranges in ${stepM} m`);
  const series = signedNumbers(reader.sized(), Array.from({ length: 6 }, () => rows));
  const of = Array.from({ length: rows }, (_, row) => {
    const value = (at: number, scale: number) => Number(series[at]![row]!) * scale;
    const found = { along: value(0, FINE), alongM: value(1, COARSE), up: value(2, FINE), upM: value(3, COARSE), asideM: value(4, COARSE), turned: value(5, COARSE) };
    if (Math.abs(found.turned) >= 2 ** 32) throw damaged("a row that is turned by more than any sensor's");
    return found;
  });
  return [{ stepM, turn, narrow: narrow === 1, angles, rows: of }, { form, unit }];
}

/** Points whose coordinates are sent as they are. */
function readApart(reader: Reader, n: Uint32Array, xyz: Positions["xyz"]): void {
  const hasNone = reader.byte();
  if (hasNone === 1) {
    const none = reader.take(12);
    const view = new DataView(none.buffer, none.byteOffset);
    xyz.forEach((axis, at) => {
      const value = view.getUint32(4 * at, true);
      for (let i = 0; i < n.length; i++) if (n[i] === 0) axis[i] = value;
    });
  }
  const count = reader.varint(n.length);
  if (hasNone > 1) throw damaged("a mark of points without a return that is neither 0 nor 1");
  if (count === 0) return;
  const [passed] = signedNumbers(reader.sized(), [count]) as [BigInt64Array];
  const places = new Uint32Array(count);
  let next = 0;
  for (let i = 0; i < count; i++) {
    if (passed[i]! < 0n || passed[i]! >= BigInt(n.length - next)) throw damaged("a point apart beyond the points of the cloud");
    places[i] = next + Number(passed[i]);
    next = places[i]! + 1;
  }
  const values = zstdFrame(reader.sized(), 12 * count);
  const view = new DataView(values.buffer, values.byteOffset, values.byteLength);
  xyz.forEach((axis, at) => {
    for (let i = 0; i < count; i++) axis[places[i]!] = view.getUint32(4 * (at * count + i), true);
  });
}

/** Directions of points, told by those before. */
class Directions {
  readonly #turn: number;
  readonly #least: number;
  /** By which neighbours in a row differ; null: told by columns. */
  readonly #step: number | null;
  // Of each row: direction and column of its last point, how its rest was; -1 for none yet.
  readonly #k: Int32Array;
  readonly #column: Int32Array;
  readonly #rowLeft: Uint8Array;
  // Of each column: its position, how its last rest was, whether it has one.
  readonly #position: Int32Array;
  readonly #columnLeft: Uint8Array;
  readonly #seen: Uint8Array;
  #last = 0;
  #lastPosition = 0;
  #lastColumn = 0;
  #meanStep: number | null = null;

  constructor(turn: number, step: number | null, cells: Cells) {
    this.#turn = turn;
    this.#least = -Math.floor(turn / 2);
    this.#step = step;
    this.#k = new Int32Array(cells.rows);
    this.#column = new Int32Array(cells.rows).fill(-1);
    this.#rowLeft = new Uint8Array(cells.rows);
    this.#position = new Int32Array(cells.columns);
    this.#columnLeft = new Uint8Array(cells.columns);
    this.#seen = new Uint8Array(cells.columns);
  }

  #wrapped(steps: number): number {
    const from = steps - this.#least;
    if (from >= 0 && from < this.#turn) return steps;
    const off = from % this.#turn;
    return (off < 0 ? off + this.#turn : off) + this.#least;
  }

  next(rests: RestReader, row: number, column: number): number {
    const began = this.#column[row]! >= 0;
    const rowLeft = this.#rowLeft[row]!;
    let k: number;
    let left: number;
    if (this.#step !== null) {
      left = unzigzag(rests.next(3 * rowLeft));
      k = this.#wrapped(this.#wrapped(began ? this.#k[row]! + this.#step : this.#last) + left);
      if (!began) this.#last = k;
    } else {
      const known = this.#seen[column] === 1;
      const gone = column - this.#lastColumn;
      const ahead = Math.floor(((this.#meanStep ?? 0) * gone + 128) / 256);
      let position = known ? this.#position[column]! : this.#wrapped(this.#lastPosition + ahead);
      const told = this.#wrapped(position + (began ? this.#k[row]! - this.#position[this.#column[row]!]! : this.#last));
      left = unzigzag(rests.next(known ? 3 * rowLeft + this.#columnLeft[column]! : 9 + rowLeft));
      k = this.#wrapped(told + left);
      if (began) position = this.#wrapped(position + left);
      else this.#last = this.#wrapped(k - position);
      if (!known && gone > 0) {
        const step = Math.floor((256 * this.#wrapped(position - this.#lastPosition)) / gone);
        this.#meanStep = this.#meanStep === null ? step : this.#meanStep + Math.floor((step - this.#meanStep) / 8);
      }
      this.#position[column] = this.#lastPosition = position;
      this.#columnLeft[column] = Math.min(Math.abs(left), 2);
      this.#seen[column] = 1;
      this.#lastColumn = column;
    }
    this.#k[row] = k;
    this.#column[row] = column;
    this.#rowLeft[row] = Math.min(Math.abs(left), 2);
    return k;
  }
}
