/** Weight files of codec riddle (docs/wire-format-riddle-weights.md), by name: those a stream brings, and the server's. */

import { crc32c } from "../../../../typescript/src/crc32c.js";
import { DecodeError, damaged } from "../../../../typescript/src/errors.js";
import { sha256 } from "../../../../typescript/src/sha256.js";
import type { Network } from "./native.js";

const OUTPUTS = 32;
const INPUTS = [72, 112];
const KEPT = 4;
/** Added to the shift of a layer whose weights take a byte each. */
const IN_BYTES = 128;
/** Added to that of a first layer with biases of cases: a byte for each of 64 rows and 32 scales, behind its others. */
const WITH_CASES = 64;
const CASES = 96;
/** Added to that of a layer whose file leaves out tiles of sixteen sums and four inputs without weights. */
const FEW_TILES = 32;
const TILE_SUMS = 16;
const TILE_INPUTS = 4;

export interface WeightNetwork extends Network {
  /** 0 small, 1 large, 2 largest. */
  readonly size: number;
}

export interface Weights {
  readonly name: string;
  readonly networks: readonly WeightNetwork[];
}

export function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function joined(parts: readonly Uint8Array[]): Uint8Array {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/** All weights of a layer of which some tiles are there, (out, into) of `width` bytes. take: gives so many bytes. */
function tiled(take: (bytes: number) => Uint8Array, into: number, out: number, width: number): Uint8Array {
  if (into % TILE_INPUTS) throw damaged(`a layer of ${into} inputs in tiles of ${TILE_INPUTS}`);
  const [blocks, across] = [Math.ceil(out / TILE_SUMS), into / TILE_INPUTS];
  const left = take(Math.ceil((blocks * across) / 8));
  const run = TILE_INPUTS * width;
  const said = left.reduce((sum, byte) => sum + byte.toString(2).replaceAll("0", "").length, 0);
  const weights = new Uint8Array(blocks * TILE_SUMS * into * width);
  let found = 0;
  for (let tile = 0; tile < blocks * across; tile++) {
    if (!((left[tile >> 3] >> (tile & 7)) & 1)) continue;
    found++;
    const [block, place] = [Math.floor(tile / across), tile % across];
    const taken = take(TILE_SUMS * run);
    if (!taken.some((byte) => byte)) throw damaged("an empty tile that is said to have weights");
    for (let sum = 0; sum < TILE_SUMS; sum++)
      weights.set(taken.subarray(sum * run, (sum + 1) * run), (block * TILE_SUMS + sum) * into * width + place * run);
  }
  if (found !== said || found === blocks * across || weights.subarray(out * into * width).some((byte) => byte))
    throw damaged("a layer whose tiles are not those that have weights");
  return weights.subarray(0, out * into * width);
}

/** The networks of a file's bytes. What its numbers are is looked at where they are used. */
export function readWeights(data: Uint8Array): Weights {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (hex(data.subarray(0, 4)) === "4c435255") throw new DecodeError("version", "it goes on learning while it drives");
  if (data.length < 14 || hex(data.subarray(0, 4)) !== "4c435257") throw damaged("no weight file");
  if (data[4] !== 1) throw new DecodeError("version", `weights of version ${data[4]}`);
  const end = data.length - 4;
  if (view.getUint32(end, true) !== crc32c(data.subarray(0, end)))
    throw new DecodeError("checksum", "the checksum of the weights does not match");
  let at = 9 + view.getUint32(5, true);
  if (at >= end) throw new DecodeError("truncated", "weights end within their provenance");
  const count = data[at++];
  if (count < 1 || count > 6) throw damaged(`weights of ${count} networks`);
  const networks = Array.from({ length: count }, (): WeightNetwork => {
    if (end - at < 14) throw new DecodeError("truncated", "weights end within a network");
    const [expects, size, layers] = data.subarray(at, at + 3);
    const [inputs, first, second, outputs] = [3, 5, 7, 9].map((by) => view.getUint16(at + by, true));
    const shifts = data.slice(at + 11, at + 14);
    if (
      expects > 1 ||
      size > 2 ||
      layers !== 3 ||
      inputs !== INPUTS[expects] ||
      outputs !== OUTPUTS ||
      first > 256 ||
      second > 256
    )
      throw damaged("a network of other than the known kinds");
    at += 14;
    const take = (bytes: number): Uint8Array => {
      if (bytes > end - at) throw new DecodeError("truncated", "weights end within a network");
      at += bytes;
      return data.subarray(at - bytes, at);
    };
    const sizes = [inputs, first, second, outputs];
    const parts = Array.from(shifts, (shift, layer) => {
      const [into, out] = [sizes[layer], sizes[layer + 1]];
      const width = shift < IN_BYTES ? 2 : 1;
      const weights = shift & FEW_TILES ? tiled(take, into, out, width) : take(into * out * width);
      const cases = layer === 0 && shift & WITH_CASES ? CASES * out : 0;
      return [weights, take(4 * out + cases)];
    });
    return {
      layers: joined(parts.flat()),
      hidden: [first, second],
      shifts: [shifts[0] & ~FEW_TILES, shifts[1] & ~FEW_TILES, shifts[2] & ~FEW_TILES],
      expects: expects === 1,
      size,
    };
  });
  if (at !== end) throw damaged("weights with bytes too many");
  return { name: hex(sha256(data).subarray(0, 8)), networks };
}

/** The networks for an effort, of both kinds: of its size, or of the nearest there is, of two the smaller. */
export function networksOf(weights: Weights, effort: number): WeightNetwork[] {
  const apart = ({ size }: WeightNetwork) => Math.abs(size - (effort - 2));
  return [false, true].map((expects) => {
    const kind = weights.networks.filter((network) => network.expects === expects);
    const found = kind.sort((a, b) => apart(a) - apart(b) || a.size - b.size)[0];
    if (found === undefined) throw damaged(`weights ${weights.name} have no network for frames of one kind`);
    return found;
  });
}

/** Weights by name. fetched: asks the server for those that a stream does not bring; null if it has none of that name */
export class Shelf {
  readonly #brought = new Map<string, Weights>();
  readonly #shipped = new Map<string, Weights>();
  readonly #fetched: (name: string) => Promise<Uint8Array | null>;

  constructor(fetched: (name: string) => Promise<Uint8Array | null>) {
    this.#fetched = fetched;
  }

  put(weights: Weights): void {
    this.#brought.delete(weights.name);
    this.#brought.set(weights.name, weights);
    if (this.#brought.size > KEPT) this.#brought.delete(this.#brought.keys().next().value as string);
  }

  async find(name: string): Promise<Weights> {
    const known = this.#brought.get(name) ?? this.#shipped.get(name);
    if (known) return known;
    const data = await this.#fetched(name);
    const weights = data && readWeights(data);
    if (weights?.name !== name)
      throw new DecodeError("reference", `weights ${name} are not here: they come with a key message, ask for one`);
    if (this.#shipped.size >= KEPT) this.#shipped.clear();
    this.#shipped.set(name, weights);
    return weights;
  }
}
