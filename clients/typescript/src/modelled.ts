/** Modelled intensities (docs/wire-format-intensity.md): contexts of seven kinds; their log odds are added. */

import type { Columns } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { BitModels, RangeDecoder } from "./rangecoder.js";
import { Rows } from "./rows.js";
import { ROWS, type Sensor } from "./sensor.js";
import { WideDecoder } from "./widecoder.js";

const CONTEXTS = 7;
/** Cells of the row above in the context: one to the left, two to the right. */
const REACH = 2;

/** Used values, ascending, and the class of each. */
interface Symbols {
  readonly values: number[];
  readonly classes: number[];
}

/** 64 x W, 0 outside of the returns. mask: 64 x W, the cells whose intensities are coded */
export function readModelled(data: Uint8Array, mask: Uint8Array, columns: Columns, sensor: Sensor): Uint8Array {
  const image = new Uint8Array(mask.length);
  if (!mask.includes(1)) {
    if (data.length > 0) throw damaged("intensities where there are no returns");
    return image;
  }
  if (data.length === 0) throw new DecodeError("truncated", "intensities without bytes");
  if (data[0] === 0) {
    if (data.length !== 2) throw damaged("one intensity for all in other than two bytes");
    for (let i = 0; i < mask.length; i++) if (mask[i]) image[i] = data[1];
    return image;
  }
  if (data[0] !== 1) throw new DecodeError("version", `modelled intensities of kind ${data[0]}`);
  if (data.length < 11) throw new DecodeError("truncated", "intensities end within their head");
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const [turn, rate, symbolBytes] = [view.getUint16(1, true), view.getUint16(3, true), view.getUint16(5, true)];
  const begin = 11 + symbolBytes;
  const split = begin + view.getUint32(7, true);
  if (rate < 1 || rate > 8191) throw damaged(`intensities that learn at the rate ${rate}`);
  if (split > data.length) throw new DecodeError("truncated", "intensities end before their streams");
  const symbols = readSymbols(data.subarray(11, begin));
  const streams = [new WideDecoder(data.subarray(begin, split)), new WideDecoder(data.subarray(split))];
  const tree = new Tree(symbols, rate);
  const rows = new Rows(sensor, columns);
  const width = columns.width;
  let above: Uint8Array = new Uint8Array(0);
  for (let row = 0; row < ROWS; row++) {
    const own = rows.columns(row);
    const seen = rows.seen(row > 0 ? above : null, row - 1, row, turn, REACH);
    const cells = Uint8Array.from(own, (column) => mask[row * width + column]);
    const coded = codeRow(tree, streams, cells, seen);
    own.forEach((column, k) => cells[k] && (image[row * width + column] = symbols.values[coded[k]]));
    above = coded;
  }
  for (const stream of streams) stream.end();
  return image;
}

function readSymbols(data: Uint8Array): Symbols {
  const coder = new RangeDecoder(data);
  const [used, rise] = [new BitModels(8), new BitModels(2)];
  const values: number[] = [];
  for (let value = 0, recent = 0; value < 256; value++) {
    const bit = coder.bit(used, recent);
    if (bit) values.push(value);
    recent = (2 * recent + bit) % 8;
  }
  let [level, rises] = [0, 0];
  const classes = values.map(() => {
    while (level < 47) {
      rises = coder.bit(rise, rises);
      if (!rises) break;
      level++;
    }
    return level;
  });
  coder.end();
  if (values.length < 2) throw damaged(`${values.length} intensities in use`);
  return { values, classes };
}

/** Symbols of the cells of a row, with filled-in symbols for cells without returns; `seen`: the row above. */
function codeRow(tree: Tree, streams: WideDecoder[], cells: Uint8Array, seen: Uint8Array): Uint8Array {
  const returns = Array.from(cells.keys()).filter((k) => cells[k]);
  const out = new Uint8Array(cells.length);
  if (returns.length === 0) return out.map((_, k) => seen[k + REACH]);
  const half = (returns.length + 1) >> 1;
  const last: number[][] = [0, half].map((first) => new Array<number>(4).fill(seen[(returns[first] ?? 0) + REACH]));
  for (let i = 0; i < half; i++) {
    const both: Leaf[] = [];
    for (let h = 0; h < 2; h++) {
      const at = i + h * half;
      if (at >= returns.length) continue;
      const k = returns[at];
      const gap = Math.min(k - (at > 0 ? returns[at - 1] : -1) - 1, 3);
      const edges = (k > 0 && !cells[k - 1] ? 2 : 0) + (k + 1 < cells.length && !cells[k + 1] ? 1 : 0);
      both.push(tree.leaf(streams[h], last[h], seen, k + REACH, gap, edges));
    }
    tree.decode(both);
    both.forEach((leaf, h) => {
      const symbol = tree.symbolOf(leaf);
      out[returns[i + h * half]] = symbol;
      last[h].pop();
      last[h].unshift(symbol);
    });
  }
  let filled = out[returns[0]];
  for (let k = 0; k < out.length; k++) {
    if (cells[k]) filled = out[k];
    else out[k] = filled;
  }
  return out;
}

/** A return on its way down the tree. */
interface Leaf {
  readonly stream: WideDecoder;
  readonly slots: number[];
  way: number;
}

interface Decided {
  readonly cells: number[];
  readonly by: number;
}

class Tree {
  readonly #n: number;
  readonly #classes: number[];
  readonly #levels: number;
  readonly #symbol: Int16Array;
  readonly #cells: Int16Array[];
  readonly #nodes: number;
  readonly #rate: number;
  readonly #third: number[];
  readonly #sixth: number[];
  readonly #eighth: number[];

  constructor({ values, classes }: Symbols, rate: number) {
    this.#n = values.length;
    this.#classes = classes;
    this.#rate = rate;
    this.#levels = Math.max(1, Math.ceil(Math.log2(this.#n)));
    this.#nodes = 2 ** this.#levels;
    this.#symbol = new Int16Array(this.#nodes).fill(-1);
    for (let s = 0; s < this.#n; s++) this.#symbol[Math.floor((s * this.#nodes) / this.#n)] = s;
    [this.#third, this.#sixth, this.#eighth] = [3, 6, 8].map((by) => classes.map((c) => Math.floor(c / by)));
    const slots = [16 * 16, 256 * 16, 256 * 16, 8 ** 3, 6 ** 4, 4, 4 * 8 * 4];
    this.#cells = slots.map((count) => new Int16Array(count * this.#nodes));
    this.#startByGuess();
    this.#startByGap();
  }

  /** The cells of a slot belong to its nodes: the node of level l and path w has cell 2^l + w. */
  #startByGuess(): void {
    const [n, whole] = [this.#n, this.#nodes];
    for (let guess = 0; guess < 16; guess++) {
      const first = this.#third.indexOf(guess);
      if (first < 0) continue;
      const z = Math.floor(((first + this.#third.lastIndexOf(guess) + 1) * whole) / n);
      for (let node = 1; node < whole; node++) {
        const level = 31 - Math.clz32(node);
        const h = 2 ** (this.#levels - level);
        const off = Math.min(Math.max(z - (2 * (node - 2 ** level) + 1) * h, -h), h);
        for (let other = 0; other < 16; other++)
          this.#cells[0][(guess * 16 + other) * whole + node] = (off * 21845) >> this.#levels;
      }
    }
  }

  #startByGap(): void {
    const holds = Array.from({ length: 2 * this.#nodes }, () => false);
    for (let leaf = 0; leaf < this.#nodes; leaf++) holds[this.#nodes + leaf] = this.#symbol[leaf] >= 0;
    for (let node = this.#nodes - 1; node >= 1; node--) {
      holds[node] = holds[2 * node] || holds[2 * node + 1];
      const start = holds[2 * node] === holds[2 * node + 1] ? 0 : holds[2 * node + 1] ? 32767 : -32768;
      for (let gap = 0; gap < 4; gap++) this.#cells[5][gap * this.#nodes + node] = start;
    }
  }

  leaf(stream: WideDecoder, last: number[], seen: Uint8Array, at: number, gap: number, edges: number): Leaf {
    const [a, b, c, d] = last;
    const [third, sixth, eighth] = [this.#third, this.#sixth, this.#eighth];
    const u0 = seen[at];
    const guess = (2 * a + 2 * b + c + d + u0 + seen[at + 1]) >> 3;
    const around = (seen[at - 1] + u0 + seen[at + 1] + seen[at + 2]) >> 2;
    const fine = this.#levels < 8 ? 0 : 1;
    const slots = [
      third[guess] * 16 + third[a],
      (a >> fine) * 16 + third[b],
      (b >> fine) * 16 + third[a],
      (sixth[a] * 8 + sixth[b]) * 8 + sixth[c],
      ((eighth[a] * 6 + eighth[b]) * 6 + eighth[c]) * 6 + eighth[d],
      gap,
      (edges * 8 + sixth[a]) * 4 + Math.floor(this.#classes[around] / 12),
    ];
    return { stream, slots: slots.map((slot) => slot * this.#nodes), way: 1 };
  }

  /** Decodes all down to their leaves; the models are updated after every four levels. */
  decode(leaves: Leaf[]): void {
    for (let from = 0; from < this.#levels; from += 4) {
      const decided: Decided[] = [];
      for (const leaf of leaves)
        for (let level = from; level < Math.min(from + 4, this.#levels); level++) decided.push(this.#decide(leaf));
      for (const { cells, by } of decided)
        for (let i = 0; i < CONTEXTS; i++) this.#cells[i][cells[i]] = clamp16(this.#cells[i][cells[i]] + by);
    }
  }

  #decide(leaf: Leaf): Decided {
    const cells = leaf.slots.map((slot) => slot + leaf.way);
    const [x0, x1, x2, x3, x4, x5, x6] = cells.map((cell, i) => this.#cells[i][cell]);
    const left = clamp16(clamp16(x0 + x1) + clamp16(x2 + x3));
    const x = clamp16(left + clamp16(clamp16(x4 + x5) + x6));
    const t = 65534 - 2 * (x >= 0 ? x : -1 - x);
    const squared = Math.floor((t * t) / 65536);
    const rare = Math.max(Math.floor((squared * t) / 2 ** 18), 10);
    const p = x < 0 ? rare : 32767 - rare;
    const bit = leaf.stream.decision(p);
    leaf.way = 2 * leaf.way + bit;
    return { cells, by: (((bit ? 32767 : 0) - p) * this.#rate + 32768) >> 16 };
  }

  symbolOf(leaf: Leaf): number {
    const symbol = this.#symbol[leaf.way - this.#nodes];
    if (symbol < 0) throw damaged("an intensity that is not in use");
    return symbol;
  }
}

function clamp16(x: number): number {
  return x < -32768 ? -32768 : x > 32767 ? 32767 : x;
}
