/** The map under the cloud: its tiles, and where the sensor is in it. A program that finds the sensor in the map counts
 * before the poses of the stream. While it says that the sensor is lost, the map is not drawn. */
import { between, identity, type Pose } from "../matrix";
import type { Motion } from "../motion";
import type { RangeFrame } from "../stream/frame";
import { MapTiles } from "./tiles";
import { type PoseEvent, Where } from "./where";

export class Town {
  tiles: MapTiles | null = null;
  /** The sensor's place, for people, and whether it is lost. Empty while no program reports it. */
  line = "";
  lost = false;
  readonly #where = new Where();
  readonly #way = identity();

  constructor(private readonly changed: () => void) {}

  /** name: of the map that is drawn; null for none */
  choose(name: string | null, token: string | undefined): void {
    this.tiles?.close();
    this.tiles = name === null ? null : new MapTiles(name, token, this.changed);
    this.changed();
  }

  told(event: PoseEvent, now: number): void {
    this.#where.take(event, now);
    this.changed();
  }

  /** A frame is shown. */
  frame(frame: RangeFrame, motion: Motion, now: number): void {
    this.#where.frame(frame.stampMs);
    const pose = this.pose(frame, motion, now);
    this.tiles?.move(pose, now, this.#said(now));
  }

  /** The sensor in the map, as far on from the newest frame as its cloud is drawn; null while that is not known. */
  pose(frame: RangeFrame | null, motion: Motion, now: number): Pose | null {
    if (!this.#said(now)) return motion.known ? motion.pose : null;
    const at = this.#where.pose(this.tiles?.name as string, now);
    return at && frame?.pose && motion.known ? this.#further(at, frame.pose, motion.pose) : at;
  }

  /** Look again at what programs report: it grows old. True if that changed. */
  look(now: number): boolean {
    const name = this.tiles?.name ?? null;
    const before = this.line;
    this.line = this.#where.line(name, now);
    this.lost = this.#where.lost(name, now);
    return this.line !== before;
  }

  reset(): void {
    this.#where.reset();
  }

  #said(now: number): boolean {
    return this.tiles !== null && this.#where.said(this.tiles.name, now);
  }

  /** at, moved by the way from one pose of the stream to another. */
  #further(at: Pose, from: Pose, to: Pose): Pose {
    const way = between(this.#way, from, to);
    const out = new Float64Array(12);
    for (let row = 0; row < 12; row += 4)
      for (let column = 0; column < 4; column++) {
        let sum = column === 3 ? (at[row + 3] as number) : 0;
        for (let k = 0; k < 3; k++) sum += (at[row + k] as number) * (way[4 * column + k] as number);
        out[row + column] = sum;
      }
    return out;
  }
}
