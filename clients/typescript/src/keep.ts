/** Kinds 4 and 5 of the KEEP section (docs/wire-format-keep.md): the few kept returns of a reduced frame. */

import { type Columns, TURN } from "./azimuth.js";
import { damaged } from "./errors.js";
import { BitModels, Mixer, RangeDecoder } from "./rangecoder.js";
import { Rows, spread } from "./rows.js";
import { ROWS, type Sensor } from "./sensor.js";

export const SPARSE = 4;
export const SPARSE_WITH_EARLIER = 5;
const DIRECTIONS = 2048;
const STARTS = [20000, 12000, 8500, 6000, 3600, 1800, 1200];
const GAPS = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100];
const AGES = [1, 2, 4, 8];
const CROWDS = [1, 2, 3, 5, 9, 16];
const GAP_CLASS = Uint8Array.from({ length: 102 }, (_, gap) => GAPS.filter((limit) => limit < gap).length);
const AGE_CLASS = Uint8Array.from({ length: 64 }, (_, age) => AGES.filter((limit) => limit < age).length);
const LEVEL = Uint8Array.from({ length: DIRECTIONS }, (_, d) => Math.max(5 - halvings(d, 5), 0));
const ROW_LEVEL = Uint8Array.from({ length: ROWS }, (_, row) => Math.max(3 - halvings(row, 3), 0));

function halvings(value: number, most: number): number {
  let times = 0;
  while (times < most && value % 2 ** (times + 1) === 0) times++;
  return times;
}

/** A table with `each` contexts for every level. */
function startedModels(each: number): BitModels {
  const models = new BitModels(7 * each);
  for (let context = 0; context < 7 * each; context++) models.start(context, STARTS[Math.floor(context / each)]);
  return models;
}

/** Directions by which a row is offset. The product needs 62 bits. */
function aside(rotation: number): number {
  const turn = 628_318_531n;
  const positive = ((BigInt(rotation) % turn) + turn) % turn;
  const angle = (positive * 2n ** 32n + turn / 2n) / turn;
  return Number(((angle + 2n ** 20n) % 2n ** 32n) >> 21n);
}

/** 64 x W of 1 and 0. earlier: 64 x W, the mask last sent in the direction of each cell */
export function readKeep(data: Uint8Array, columns: Columns, sensor: Sensor, earlier: Uint8Array | null): Uint8Array {
  const withEarlier = data[0] === SPARSE_WITH_EARLIER;
  if (withEarlier && (earlier === null || columns.width === 0)) throw damaged("a keep mask that refers to none");
  const before = withEarlier ? earlier : null;
  const coder = new RangeDecoder(data.subarray(1));
  const rows = new Rows(sensor, columns);
  const { width } = columns;
  const image = new Uint8Array(ROWS * width);

  const direction: Uint16Array[] = [];
  const had: Uint8Array[] = []; // of each row: directions that the earlier row has
  for (let row = 0; row < ROWS; row++) {
    const away = aside(rows.rotation[row]);
    const own = rows.columns(row);
    const half = sensor.half[row] * width;
    direction.push(
      Uint16Array.from(own, (column) => {
        const looked = Math.floor((columns.azimuth[half + column] * DIRECTIONS) / TURN);
        return (looked - away + DIRECTIONS) % DIRECTIONS;
      }),
    );
    const has = new Uint8Array(DIRECTIONS);
    if (before) own.forEach((column, k) => before[row * width + column] && (has[direction[row][k]] = 1));
    had.push(has);
  }

  const tables = [
    startedModels(4 * 14),
    startedModels(4 * 7 * 7),
    startedModels(8 * 14),
    startedModels(before ? 4 * 8 : 4 * 5 * 5),
  ];
  const mixers = STARTS.map(() => new Mixer(4, 26214, 14));
  const ages = new Uint8Array(DIRECTIONS).fill(63);
  const contexts = [0, 0, 0, 0];
  for (let row = 0; row < ROWS; row++) {
    const own = rows.columns(row);
    const looks = direction[row];
    const around = new Surroundings(ages);
    const kept = new Uint8Array(own.length);
    let [gap, last] = [101, 7];
    for (let k = 0; k < own.length; k++) {
      const d = looks[k];
      const level = k > 0 && looks[k - 1] === d ? 6 : LEVEL[d];
      const rowLevel = level * 4 + ROW_LEVEL[row];
      contexts[0] = rowLevel * 14 + GAP_CLASS[gap];
      contexts[1] = rowLevel * 49 + around.crowd(d) * 7 + around.finest(d);
      contexts[2] = (level * 8 + last) * 14 + GAP_CLASS[gap];
      if (before) {
        const beside = had[row][(d + 1) % DIRECTIONS] | had[row][(d + DIRECTIONS - 1) % DIRECTIONS];
        const upright = (row > 0 ? had[row - 1][d] : 0) | (row < ROWS - 1 ? had[row + 1][d] : 0);
        contexts[3] = rowLevel * 8 + had[row][d] * 4 + beside * 2 + upright;
      } else {
        contexts[3] = rowLevel * 25 + around.youngest(d, 2) * 5 + around.youngest(d, 8);
      }
      const alone = tables[0].chance(contexts[0]);
      const bit =
        alone < 512 || alone > 65024 ? coder.bit(tables[0], contexts[0]) : mixers[level].decide(coder, tables, contexts);
      kept[k] = bit;
      if (bit) [gap, last] = [1, level];
      else gap = Math.min(gap + 1, 101);
    }
    for (let d = 0; d < DIRECTIONS; d++) ages[d] = Math.min(ages[d] + 1, 63);
    kept.forEach((bit, k) => bit && (ages[looks[k]] = 1));
    spread(image, row, own, kept);
  }
  coder.end();
  return image;
}

/** What the rows above kept around each direction, computed when needed, before the present row changes it. */
class Surroundings {
  readonly #ages: Uint8Array;
  readonly #crowd = new Int8Array(DIRECTIONS).fill(-1);
  readonly #finest = new Int8Array(DIRECTIONS).fill(-1);
  readonly #youngest: Record<number, Int8Array> = {
    2: new Int8Array(DIRECTIONS).fill(-1),
    8: new Int8Array(DIRECTIONS).fill(-1),
  };

  constructor(ages: Uint8Array) {
    this.#ages = ages.slice();
  }

  crowd(d: number): number {
    if (this.#crowd[d] < 0) this.#look(d);
    return this.#crowd[d];
  }

  finest(d: number): number {
    if (this.#finest[d] < 0) this.#look(d);
    return this.#finest[d];
  }

  youngest(d: number, reach: 2 | 8): number {
    const known = this.#youngest[reach];
    if (known[d] < 0) {
      let least = 63;
      for (let by = -reach; by <= reach; by++) least = Math.min(least, this.#ages[(d + by + DIRECTIONS) % DIRECTIONS]);
      known[d] = AGE_CLASS[least];
    }
    return known[d];
  }

  #look(d: number): void {
    let [late, finest] = [0, 0];
    for (let by = -16; by <= 16; by++) {
      const at = (d + by + DIRECTIONS) % DIRECTIONS;
      if (this.#ages[at] > 3) continue;
      late++;
      finest = Math.max(finest, LEVEL[at]);
    }
    this.#crowd[d] = CROWDS.filter((limit) => limit <= late).length;
    this.#finest[d] = finest;
  }
}
