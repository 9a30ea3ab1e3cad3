/** Another stream in the picture: its source, its frames on the card, and where they lie. */
import { DecodingSource } from "../../decode/source";
import { formats, Texture } from "../draw/gl";
import { Layers } from "../draw/layers";
import type { Colour3 } from "../draw/theme";
import type { Matrix, Pose } from "../matrix";
import { MAX_RINGS, type RangeFrame } from "../stream/frame";
import { type SensorTable, TEXELS } from "../stream/sensor";
import { CloudSocket } from "../stream/socket";
import type { FrameSource, Sink } from "../stream/source";
import { Tally } from "../stream/tally";
import type { StreamName } from "../types";
import { type MainSeat, type Mount, noteOf, type Placed, Placing } from "./mounts";

export interface GuestOptions {
  token: string | undefined;
  fill: boolean;
  decodeInBrowser: boolean;
}

/** After so long without a frame the legend says so. */
const SILENT_S = 4;

interface Came {
  frame: RangeFrame;
  table: SensorTable;
  shown: () => void;
}

export class Guest implements Sink {
  mount: Mount | null = null;
  tint: Colour3 = [1, 1, 1];
  table: SensorTable | null = null;
  readonly #placing = new Placing();
  readonly #source: FrameSource;
  readonly #tally = new Tally();
  #layers: Layers | null = null;
  #sensor: Texture | null = null;
  #last: Came | null = null;
  #waiting: Came[] = [];

  constructor(
    readonly name: StreamName,
    options: GuestOptions,
    private readonly came: () => void,
  ) {
    const Source = options.decodeInBrowser ? DecodingSource : CloudSocket;
    const { token, fill } = options;
    this.#source = new Source({ stream: name, token, original: false, fill }, this);
  }

  /** The frames on the card, newest first; empty before the first. */
  get layers(): Layers | null {
    return this.#layers;
  }

  get sensor(): Texture | null {
    return this.#sensor;
  }

  get pose(): Pose | null {
    return this.#last?.frame.pose ?? null;
  }

  get points(): number {
    return this.#layers?.points ?? 0;
  }

  get frames(): number {
    return this.#tally.frames;
  }

  get bytes(): number {
    return (this.#layers?.bytes ?? 0) + (this.#sensor?.bytes ?? 0);
  }

  /** Say why nothing comes, and why it does not lie where it should. */
  note(mainVehicle: string, now: number): string {
    const { connection, problem, alive } = this.#source;
    const { silent_s } = this.#tally.stats(now);
    const told = problem && connection !== "open" ? [problem] : [];
    if (silent_s === null) return told[0] ?? (alive === false ? "its vehicle is not connected" : "waiting for a frame");
    if (silent_s > SILENT_S) told.push(`no frame for ${Math.round(silent_s)} s`);
    return [...told, noteOf(this.placed, mainVehicle)].filter(Boolean).join("; ");
  }

  frame(frame: RangeFrame, table: SensorTable, shown: () => void): void {
    this.#waiting.push({ frame, table, shown });
    this.came();
  }

  restarted(): void {
    this.#layers?.clear();
    this.#last = null;
  }

  changed(): void {}

  /** Put what came onto the card. Returns what is to be called when it is drawn. */
  take(gl: WebGL2RenderingContext, now: number, widest: number): (() => void)[] {
    const waiting = this.#waiting;
    this.#waiting = [];
    for (const one of waiting) if (one.frame.columns <= widest) this.#show(gl, one, now);
    return waiting.map(({ shown }) => shown);
  }

  /** The card is another one: put the last frame there. */
  again(gl: WebGL2RenderingContext): void {
    this.#layers = this.#sensor = this.table = null;
    if (this.#last) this.#show(gl, this.#last, performance.now());
  }

  settle(main: MainSeat): void {
    const { vehicle } = this.name;
    this.#placing.settle(main, { vehicle, mount: this.mount, pose: this.pose });
  }

  get placed(): Placed {
    return this.#placing.placed;
  }

  /** From the sensor at one of its frames to the frame of the picture. Overwritten at the next call. */
  placeOf({ pose }: Pick<RangeFrame, "pose">): Matrix {
    return this.#placing.of(pose);
  }

  close(): void {
    this.#source.close();
    this.#layers?.clear();
    this.#sensor?.delete();
    this.#layers = this.#sensor = null;
    this.#waiting.length = 0;
  }

  #show(gl: WebGL2RenderingContext, one: Came, now: number): void {
    const { frame, table } = one;
    this.#layers ??= new Layers(gl);
    this.#sensor ??= new Texture(gl, formats(gl).rgba32f, TEXELS, MAX_RINGS);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (table !== this.table || (this.#last && this.#last.frame.streamId !== frame.streamId)) {
      this.#layers.clear();
      this.#sensor.write(table.values, TEXELS, table.rings);
      this.table = table;
    }
    this.#layers.push(frame, 0);
    this.#last = one;
    this.#tally.shown(frame, this.#layers, now, Date.now() + this.#source.clockAheadMs);
  }
}
