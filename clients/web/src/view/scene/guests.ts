/** The other streams of a picture, each in its colour, and how many of all points are in the box. */
import type { Layers } from "../draw/layers";
import type { Legend } from "../draw/legend";
import type { Renderer, Scene } from "../draw/renderer";
import type { Colour3, Theme } from "../draw/theme";
import { between, identity, type Matrix, type Pose } from "../matrix";
import type { RangeFrame } from "../stream/frame";
import type { SensorTable } from "../stream/sensor";
import type { StreamName, ViewOptions } from "../types";
import { type Box, countInside } from "./box";
import { Guest, type GuestOptions } from "./guest";
import { type MainSeat, MOST_STREAMS, type Mount, type Seat } from "./mounts";

/** Another stream to show. */
export interface Beside {
  name: StreamName;
  mount: Mount | null;
}

/** The chosen stream. */
type Main = Seat & { sensor: string; points: number };

/** A line of the legend: a stream, its measured points, and why it lies elsewhere or is missing. */
export interface LegendRow {
  name: string;
  colour: Colour3;
  points: number;
  note: string;
}

/** Of the chosen stream, then of the others; told apart also by people who see fewer colours (Okabe and Ito, 2008). */
const TINTS: Record<"dark" | "light", readonly Colour3[]> = {
  dark: [
    [0.34, 0.71, 0.91],
    [0.9, 0.62, 0.0],
    [0.0, 0.75, 0.55],
    [0.94, 0.89, 0.26],
    [0.92, 0.6, 0.75],
    [0.95, 0.48, 0.2],
  ],
  light: [
    [0.0, 0.45, 0.7],
    [0.75, 0.47, 0.0],
    [0.0, 0.5, 0.37],
    [0.45, 0.42, 0.0],
    [0.66, 0.3, 0.5],
    [0.75, 0.3, 0.0],
  ],
};
const COUNT_MS = 1000;

export function tintOf(number: number, { dark }: Theme): Colour3 {
  const tints = TINTS[dark ? "dark" : "light"];
  return tints[number % tints.length] as Colour3;
}

const keyOf = ({ vehicle, sensor }: StreamName) => `${vehicle}/${sensor}`;

export class Guests {
  readonly all: Guest[] = [];
  #acknowledged: (() => void)[] = [];
  #told = "";
  #inside: number | null = null;
  #box: Box | null = null;
  #countedMs = 0;

  constructor(private readonly came: () => void) {}

  /** Have the other streams that are asked for beside this one, and no others; a comparison is of one stream. */
  show(main: { token: string | undefined } | null, options: ViewOptions): void {
    const { compare, beside, decodeInBrowser, fillGaps } = options;
    this.#set(main && !compare ? beside : [], { token: main?.token, fill: fillGaps, decodeInBrowser });
  }

  #set(beside: readonly Beside[], options: GuestOptions): void {
    const told = JSON.stringify(options);
    const wanted = new Map(beside.slice(0, MOST_STREAMS - 1).map((one) => [keyOf(one.name), one]));
    for (const guest of [...this.all]) {
      if (told === this.#told && wanted.has(keyOf(guest.name))) continue;
      guest.close();
      this.all.splice(this.all.indexOf(guest), 1);
    }
    this.#told = told;
    for (const [key, { name, mount }] of wanted) {
      let guest = this.all.find((one) => keyOf(one.name) === key);
      if (!guest) {
        guest = new Guest(name, options, this.came);
        this.all.push(guest);
      }
      guest.mount = mount;
    }
  }

  /** Put what came onto the card; true if there was something. */
  take(gl: WebGL2RenderingContext, now: number, widest: number): boolean {
    const before = this.#acknowledged.length;
    for (const guest of this.all) this.#acknowledged.push(...guest.take(gl, now, widest));
    return this.#acknowledged.length > before;
  }

  /** What is to be called when the picture is drawn. */
  acknowledged(): (() => void)[] {
    return this.#acknowledged.splice(0);
  }

  /** Place and colour all for the picture that is drawn now. */
  settle(main: MainSeat, theme: Theme): void {
    for (const [number, guest] of this.all.entries()) {
      guest.settle(main);
      guest.tint = tintOf(number + 1, theme);
    }
  }

  /** Show the legend, and count the points for the page. renderer: null while the card is away */
  report(main: Main, scene: Scene, renderer: Renderer | null, legend: Legend, now: number) {
    const streams = this.#legend(main, scene.theme, now);
    legend.show(streams, scene.colour === "stream");
    const { points } = main;
    const inBox = renderer && this.#count(scene, main.pose, renderer.layers, renderer.table, now);
    return { inBox, streams, allPoints: points + this.all.reduce((sum, guest) => sum + guest.points, 0) };
  }

  /** Lines of the legend; none for a stream alone. */
  #legend(main: Main, theme: Theme, now: number): LegendRow[] {
    if (this.all.length === 0) return [];
    const mounted = this.all.some(({ placed }) => placed === "mount");
    const note = !main.mount && mounted ? "no mounting: drawn at the vehicle's origin" : "";
    return [
      { name: keyOf(main), colour: tintOf(0, theme), points: main.points, note },
      ...this.all.map((guest) => ({
        name: keyOf(guest.name),
        colour: guest.tint,
        points: guest.points,
        note: guest.note(main.vehicle, now),
      })),
    ];
  }

  /** How many of all measured points are in the box; null without one. Counted once a second. */
  #count({ box, ground }: Scene, pose: Pose | null, layers: Layers, table: SensorTable | null, now: number) {
    if (!box || !table) this.#inside = null;
    else if (this.#inside === null || box !== this.#box || now - this.#countedMs >= COUNT_MS) {
      this.#countedMs = now;
      this.#box = box;
      const main = ({ pose: its }: RangeFrame) => (pose && its ? between(identity(), pose, its) : identity());
      this.#inside = counted(layers, table, main, box, ground);
      for (const guest of this.all) {
        const { layers: shown, table: own } = guest;
        if (shown && own) this.#inside += counted(shown, own, (frame) => guest.placeOf(frame), box, ground);
      }
    }
    return this.#inside;
  }

  /** Frames of all of them that were shown. */
  get frames(): number {
    return this.all.reduce((sum, { frames }) => sum + frames, 0);
  }

  get bytes(): number {
    return this.all.reduce((sum, { bytes }) => sum + bytes, 0);
  }

  again(gl: WebGL2RenderingContext): void {
    for (const guest of this.all) guest.again(gl);
  }
}

function counted(
  { shown, now }: Layers,
  table: SensorTable,
  placeOf: (frame: RangeFrame) => Matrix,
  box: Box,
  ground: number,
): number {
  return shown
    .slice(0, now)
    .reduce((sum, { frame }) => sum + countInside(frame, table, placeOf(frame), box, ground), 0);
}
