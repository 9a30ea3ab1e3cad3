/** What stands over the picture: captions, the scale of the colours, and messages. Written only when it changes. */

import { type Comparison, millimetres } from "../compare";
import type { Colour } from "../types";
import { FAR_M, HEIGHT_M, type MapName, mapOf, STEPS } from "./colours";
import { Legend } from "./legend";
import type { Theme } from "./theme";

const SCALES: Record<Exclude<Colour, "stream">, { title: string; ends: [string, string] }> = {
  height: { title: "height above the road", ends: [`${HEIGHT_M[0]} m`, `${HEIGHT_M[1]} m`] },
  intensity: { title: "intensity", ends: ["0", "255"] },
  distance: { title: "distance", ends: ["0 m", `${FAR_M} m`] },
  ring: { title: "ring", ends: ["top", "bottom"] },
};

function element<K extends keyof HTMLElementTagNameMap>(name: K, kind: string, parent: HTMLElement) {
  const made = document.createElement(name);
  made.className = kind;
  parent.append(made);
  return made;
}

/** Write only what changes: a text that is set makes the browser lay the page out again. */
function write(into: HTMLElement, text: string): void {
  if (into.textContent !== text) into.textContent = text;
}

/** A bar of colours with what its ends stand for. */
class Scale {
  readonly root: HTMLElement;
  readonly #title: HTMLElement;
  readonly #bar: HTMLCanvasElement;
  readonly #from: HTMLElement;
  readonly #to: HTMLElement;
  #drawn = "";

  constructor(parent: HTMLElement) {
    this.root = element("figure", "lidar-scale", parent);
    this.#title = element("figcaption", "", this.root);
    this.#bar = element("canvas", "", this.root);
    this.#bar.width = STEPS;
    this.#bar.height = 1;
    this.#bar.setAttribute("aria-hidden", "true");
    const ends = element("div", "lidar-ends", this.root);
    this.#from = element("span", "", ends);
    this.#to = element("span", "", ends);
  }

  show(name: MapName, dark: boolean, title: string, from: string, to: string): void {
    write(this.#title, title);
    write(this.#from, from);
    write(this.#to, to);
    if (this.#drawn === `${name} ${dark}`) return;
    this.#drawn = `${name} ${dark}`;
    const pen = this.#bar.getContext("2d");
    pen?.putImageData(new ImageData(new Uint8ClampedArray(mapOf(name, dark)), STEPS, 1), 0, 0);
  }
}

export class Overlay {
  readonly root: HTMLElement;
  readonly legend: Legend;
  readonly #scale: Scale;
  readonly #error: Scale;
  readonly #left: HTMLElement;
  readonly #right: HTMLElement;
  readonly #figures: HTMLElement;
  readonly #message: HTMLElement;
  readonly #made: HTMLElement;
  readonly #where: HTMLElement;
  #strip = 0;

  constructor(host: HTMLElement) {
    this.root = element("div", "lidar-overlay", host);
    this.#left = element("p", "lidar-caption lidar-left", this.root);
    this.#right = element("p", "lidar-caption lidar-right", this.root);
    this.#scale = new Scale(this.root);
    this.#error = new Scale(this.root);
    this.#error.root.classList.add("lidar-error");
    this.legend = new Legend(this.root);
    this.#figures = element("dl", "lidar-figures", this.root);
    this.#made = element("p", "lidar-made", this.root);
    this.#made.hidden = true;
    this.#where = element("p", "lidar-where", this.root);
    this.where("", false);
    this.#message = element("p", "lidar-message", this.root);
    this.#message.setAttribute("role", "status");
    this.message("");
  }

  message(text: string): void {
    write(this.#message, text);
    this.#message.hidden = text === "";
  }

  /** How many points were measured, and how many made up between them, which are drawn fainter. */
  made(measured: number, madeUp: number): void {
    this.#made.hidden = madeUp === 0;
    if (madeUp > 0)
      write(
        this.#made,
        `${measured.toLocaleString("en")} measured · ${madeUp.toLocaleString("en")} filled in, fainter`,
      );
  }

  /** Where the sensor is in a map, or that it is lost there; empty: nobody says. */
  where(line: string, lost: boolean): void {
    this.#where.hidden = line === "";
    this.#where.classList.toggle("lidar-lost", lost);
    write(this.#where, line);
  }

  /** colour: null while nothing is shown that a scale would explain */
  scale(colour: Colour | null, { dark }: Theme): void {
    this.#scale.root.hidden = colour === null || colour === "stream";
    if (colour === null || colour === "stream") return;
    const { title, ends } = SCALES[colour];
    this.#scale.show(colour, dark, title, ends[0], ends[1]);
  }

  /** high: of the range image below, CSS pixels. */
  strip(high: number): void {
    if (high === this.#strip) return;
    this.#strip = high;
    this.root.style.setProperty("--lidar-strip", `${high}px`);
  }

  /** Figures of a comparison; null: none is made. upright: the panes are above one another. */
  compare(figures: Comparison | null, scale_mm: number, { dark }: Theme, upright: boolean): void {
    const hidden = figures === null;
    for (const one of [this.#left, this.#right, this.#figures, this.#error.root]) one.hidden = hidden;
    this.root.classList.toggle("lidar-compare", !hidden);
    this.root.classList.toggle("lidar-upright", upright);
    if (!figures) return;
    write(this.#left, "original");
    write(this.#right, "decoded");
    this.#error.show(
      "error",
      dark,
      "error along the ray",
      "0",
      `${figures.max_mm > scale_mm + 1e-3 ? "≥ " : ""}${millimetres(scale_mm)}`,
    );
    const rows = [
      ["RMSE", millimetres(figures.rmse_mm)],
      ["largest", millimetres(figures.max_mm)],
      ["changed", `${(100 * figures.changed).toFixed(figures.changed > 0 && figures.changed < 0.1 ? 2 : 0)} %`],
      ...(figures.dropped > 0 ? [["not sent", figures.dropped.toLocaleString("en")]] : []),
      ...(figures.invented > 0 ? [["invented", figures.invented.toLocaleString("en")]] : []),
    ] as [string, string][];
    while (this.#figures.childElementCount > 2 * rows.length) this.#figures.lastElementChild?.remove();
    while (this.#figures.childElementCount < 2 * rows.length) {
      this.#figures.append(document.createElement(this.#figures.childElementCount % 2 === 0 ? "dt" : "dd"));
    }
    rows.forEach(([name, value], row) => {
      write(this.#figures.children[2 * row] as HTMLElement, name);
      write(this.#figures.children[2 * row + 1] as HTMLElement, value);
    });
  }
}
