/** Frames on the graphics card: the newest, and the trail behind it. Textures are taken once and written over. */
import { coverageOf, isEmpty, type RangeFrame } from "../stream/frame";
import { formats, Texture } from "./gl";

/** Columns are taken by so many at once: their number changes from turn to turn. */
const COLUMNS_AT_ONCE = 256;
/** Parts that a turn is put together from, at most. */
const FRAMES_OF_TURN = 64;
/** One frame on the card. */
export class Layer {
  frame: RangeFrame;
  /** What part of a turn it is; 1 for whole turns. */
  coverage = 1;
  range: Texture;
  azimuth: Texture;
  intensity: Texture;
  original: Texture | null = null;
  filled: Texture | null = null;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    frame: RangeFrame,
  ) {
    const columns = Math.ceil(frame.columns / COLUMNS_AT_ONCE) * COLUMNS_AT_ONCE;
    const { u16, u8 } = formats(gl);
    this.range = new Texture(gl, u16, columns, frame.rings);
    this.azimuth = new Texture(gl, u16, columns, 2);
    this.intensity = new Texture(gl, u8, columns, frame.rings);
    this.frame = frame;
    this.write(frame);
  }

  fits(frame: RangeFrame): boolean {
    return frame.rings === this.frame.rings && frame.columns <= this.range.width;
  }

  write(frame: RangeFrame): void {
    const { rings, columns } = frame;
    this.frame = frame;
    const coverage = coverageOf(frame);
    this.coverage = coverage > 0.98 || coverage <= 0 ? 1 : coverage;
    this.range.write(frame.range, columns, rings);
    this.azimuth.write(frame.azimuth, columns, 2);
    if (frame.intensity) this.intensity.write(frame.intensity, columns, rings);
    if (frame.original) {
      this.original ??= new Texture(this.gl, formats(this.gl).u16, this.range.width, rings);
      this.original.write(frame.original, columns, rings);
    }
    if (frame.filled) {
      this.filled ??= new Texture(this.gl, formats(this.gl).u8, this.range.width, rings);
      this.filled.write(frame.filled, columns, rings);
    }
  }

  get bytes(): number {
    const some = (this.original?.bytes ?? 0) + (this.filled?.bytes ?? 0);
    return this.range.bytes + this.azimuth.bytes + this.intensity.bytes + some;
  }

  delete(): void {
    for (const one of [this.range, this.azimuth, this.intensity, this.original, this.filled]) one?.delete();
  }
}

/** How many of the newest frames make a turn, given what part of a turn each of them is: 1 for whole turns. */
export function framesOfTurn(coverage: readonly number[]): number {
  let sum = 0;
  for (let count = 0; count < coverage.length; count++) {
    const part = coverage[count] as number;
    if (count > 0 && sum + part > 1.06) return count;
    sum += part;
    if (sum > 0.98) return count + 1;
  }
  return Math.max(coverage.length, 1);
}

/** The frames that are shown, newest first, and as many textures as that takes. */
export class Layers {
  readonly shown: Layer[] = [];
  /** How many of `shown` are the newest turn; the others are the trail. */
  now = 0;
  readonly #coverage: number[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** Show a frame, with so many turns behind it. */
  push(frame: RangeFrame, trail: number): void {
    this.#coverage.unshift(isEmpty(frame) ? (this.#coverage[0] ?? 1) : coverageOf(frame));
    const turn = framesOfTurn(this.#coverage);
    const wanted = turn * (1 + trail);
    this.#coverage.length = Math.min(this.#coverage.length, FRAMES_OF_TURN);
    while (this.shown.length > wanted) this.shown.pop()?.delete();
    let layer = this.shown.length === wanted ? this.shown.pop() : undefined;
    if (layer && !layer.fits(frame)) {
      layer.delete();
      layer = undefined;
    }
    if (layer) layer.write(frame);
    else layer = new Layer(this.gl, frame);
    this.shown.unshift(layer);
    this.now = Math.min(turn, this.shown.length);
  }

  /** Show fewer turns behind the newest, at once. */
  shorten(trail: number): void {
    while (this.shown.length > Math.max(this.now, 1) * (1 + trail)) this.shown.pop()?.delete();
  }

  /** Returns of the newest turn that were measured. */
  get points(): number {
    return this.shown.slice(0, this.now).reduce((sum, { frame }) => sum + frame.returns, 0);
  }

  /** Returns of the newest turn that were made up. */
  get madeUp(): number {
    return this.shown.slice(0, this.now).reduce((sum, { frame }) => sum + frame.madeUp, 0);
  }

  get bytes(): number {
    return this.shown.reduce((sum, layer) => sum + layer.bytes, 0);
  }

  clear(): void {
    for (const layer of this.shown) layer.delete();
    this.shown.length = this.#coverage.length = this.now = 0;
  }
}
