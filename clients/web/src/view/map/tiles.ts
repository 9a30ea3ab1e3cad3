/** The tiles of a map around the vehicle, fetched from the server as points (docs/server.md, `?form=points`). */
import type { Pose } from "../matrix";

/** Tiles within this distance of the vehicle are held. */
const RADIUS_M = 120;
/** Ask for the list of tiles again after so many metres, or after so much time: the map may change. */
const MOVED_M = 20;
const LOOK_MS = 10_000;
const IN_FLIGHT = 2;
const MOST_TILES = 64;
const MOST_POINTS = 2_000_000;
const POINT_BYTES = 12;
/** Points that the server gives of a tile at most. */
const TILE_POINTS = 100_000;
const PATIENCE_MS = 20_000;
const NOT_FOUND = "The map is not drawn: the place of the sensor in it is not known.";
const NO_POSE = "The map is not drawn: this stream has no poses.";

export interface MapTile {
  hash: string;
  /** From the corner of the tile to the map. */
  place: Pose;
  /** (N, 3): x and y in metres from the corner of the tile, z in metres in the map. */
  points: Float32Array;
}

interface Listed {
  tile_m: number;
  places: Place[];
}

interface Place {
  x: number;
  y: number;
  hash: string;
}

/** The answer for one tile is of no use; others may be. */
class TileError extends Error {}

const keyOf = ({ x, y }: Place) => `${x}/${y}`;

export class MapTiles {
  /** By their place, `x/y`. */
  readonly tiles = new Map<string, MapTile>();
  /** Why the map, or a part of it, is not drawn; null if nothing is wrong. */
  note: string | null = null;
  readonly #stop = new AbortController();
  #busy = false;
  #at: [number, number] = [Number.NaN, Number.NaN];
  #asked = 0;

  /** changed: called when there is more or less to draw */
  constructor(
    readonly name: string,
    private readonly token: string | undefined,
    private readonly changed: () => void,
  ) {}

  /** Hold the tiles around a pose in the map; without one none is drawn. sought: a program looks for the sensor in it */
  move(pose: Pose | null, now: number, sought = false): void {
    if (pose === null) {
      this.note = sought ? NOT_FOUND : NO_POSE;
      return;
    }
    if (this.note === NO_POSE || this.note === NOT_FOUND) this.note = null;
    const [x, y] = [pose[3] as number, pose[7] as number];
    const near = Math.hypot(x - this.#at[0], y - this.#at[1]) < MOVED_M;
    if (this.#busy || (near && now - this.#asked < LOOK_MS)) return;
    this.#busy = true;
    this.#at = [x, y];
    this.#asked = now;
    void this.#fetch(x, y).finally(() => {
      this.#busy = false;
    });
  }

  close(): void {
    this.#stop.abort();
    this.tiles.clear();
  }

  async #fetch(x: number, y: number): Promise<void> {
    try {
      const query = `?x=${x.toFixed(1)}&y=${y.toFixed(1)}&radius=${RADIUS_M}`;
      const { places, tile_m } = (await (await this.#get(query)).json()) as Listed;
      const away = (one: Place) => Math.hypot((one.x + 0.5) * tile_m - x, (one.y + 0.5) * tile_m - y);
      const wanted = [...places].sort((a, b) => away(a) - away(b)).slice(0, MOST_TILES);
      this.#keep(new Map(wanted.map((one) => [keyOf(one), one.hash])));
      const failed = await this.#complete(wanted, tile_m);
      this.note = this.#noteOf(places.length, failed);
    } catch (error) {
      if (this.#stop.signal.aborted) return;
      this.note = `Map ${this.name}: ${error instanceof Error ? error.message : error}`;
    }
    this.changed();
  }

  /** Fetch what is missing of these, which come nearest first. Returns why tiles could not be had, for each of those. */
  async #complete(wanted: readonly Place[], tile_m: number): Promise<string[]> {
    const missing = wanted.filter((one) => !this.tiles.has(keyOf(one)));
    const failed: string[] = [];
    const work = async () => {
      for (let one = missing.shift(); one && this.#hasRoom(wanted, one); one = missing.shift()) {
        try {
          await this.#tile(one, tile_m);
        } catch (error) {
          if (!(error instanceof TileError)) throw error;
          failed.push(error.message);
        }
        for (const other of wanted) if (!this.#hasRoom(wanted, other)) this.tiles.delete(keyOf(other));
      }
    };
    await Promise.all(Array.from({ length: IN_FLIGHT }, work));
    return failed;
  }

  /** Whether nearer tiles leave room for this one. wanted: nearest first */
  #hasRoom(wanted: readonly Place[], place: Place): boolean {
    let sum = 0;
    for (const one of wanted) {
      if (one === place) break;
      sum += (this.tiles.get(keyOf(one))?.points.length ?? 0) / 3;
    }
    return sum < MOST_POINTS;
  }

  /** listed: how many tiles the map has around the vehicle */
  #noteOf(listed: number, failed: readonly string[]): string | null {
    if (listed === 0) return `Map ${this.name} has no tile around this vehicle.`;
    const told: string[] = [];
    const drawn = this.tiles.size;
    if (drawn + failed.length < listed) told.push(`the nearest ${drawn} of ${listed} tiles are drawn`);
    if (failed.length > 0) told.push(`${failed.length} of ${listed} tiles are missing: ${failed[0]}`);
    return told.length > 0 ? `Map ${this.name}: ${told.join("; ")}` : null;
  }

  /** Drop tiles that are far away or have changed. */
  #keep(wanted: Map<string, string>): void {
    for (const [place, tile] of this.tiles) if (wanted.get(place) !== tile.hash) this.tiles.delete(place);
  }

  /** Throws TileError if this tile cannot be had. */
  async #tile({ x, y, hash }: Place, tile_m: number): Promise<void> {
    const data = await (await this.#get(`/${x}/${y}?form=points`)).arrayBuffer();
    if (data.byteLength % POINT_BYTES !== 0 || data.byteLength > TILE_POINTS * POINT_BYTES) {
      throw new TileError(`tile ${x}/${y} has ${data.byteLength} bytes, which are no points`);
    }
    if (this.#stop.signal.aborted) return;
    const place = new Float64Array([1, 0, 0, x * tile_m, 0, 1, 0, y * tile_m, 0, 0, 1, 0]);
    this.tiles.set(`${x}/${y}`, { hash, place, points: new Float32Array(data) });
    this.changed();
  }

  /** Throws TileError for an answer that refuses, and what fetch throws if none comes. */
  async #get(tail: string): Promise<Response> {
    const address = new URL(`api/v1/maps/${encodeURIComponent(this.name)}${tail}`, document.baseURI);
    const headers: Record<string, string> = this.token === undefined ? {} : { Authorization: `Bearer ${this.token}` };
    const signal = AbortSignal.any([this.#stop.signal, AbortSignal.timeout(PATIENCE_MS)]);
    const response = await fetch(address, { headers, signal, cache: "no-cache" });
    if (response.ok) return response;
    const problem = (await response.json().catch(() => null)) as { detail?: string } | null;
    throw new TileError(problem?.detail ?? `the server answered ${response.status}`);
  }
}
