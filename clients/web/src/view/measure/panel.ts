/** What the ruler shows: marks with a line over the picture, and a panel with the fields of each return. */

import type { Picked } from "./pick";
import type { Between } from "./ruler";

const SVG = "http://www.w3.org/2000/svg";
export const HINT = "Click or tap a point to see its fields, then another one to measure. Escape begins again.";
export const MISSED = "No point there: click nearer to one.";

export function metres(value: number): string {
  return `${value.toFixed(2)} m`;
}

/** The rows of the panel: what a number is, then the number, for both points side by side. missed: a click met none. */
export function rows(picked: readonly Picked[], ground: number, apart: Between | null, missed = false): string[][] {
  const both = (name: string, said: (one: Picked) => string) => [name, ...picked.map(said)];
  const out: string[][] = [];
  if (apart) {
    out.push(["distance", metres(apart.distance)], ["over the ground", metres(apart.flat)]);
    out.push(["height", metres(apart.up)]);
    if (apart.uncertain) out.push(["Wrong if the vehicle moved: the points are of two frames without poses."]);
  }
  if (missed) out.push([MISSED]);
  if (picked.length === 0) return missed ? out : [[HINT]];
  out.push(["", "A", "B"].slice(0, picked.length + 1));
  if (picked.some(({ stream }) => stream !== null))
    out.push(both("stream", ({ stream }) => stream ?? "the chosen one"));
  out.push(both("x forward", ({ point }) => metres(point[0])));
  out.push(both("y left", ({ point }) => metres(point[1])));
  out.push(both("z up", ({ point }) => metres(point[2])));
  out.push(both("above the road", ({ point }) => metres(point[2] - ground)));
  out.push(both("from the sensor", ({ distance }) => metres(distance)));
  out.push(both("intensity", ({ intensity }) => (intensity === null ? "not sent" : `${intensity}`)));
  out.push(both("ring, column", ({ ring, column }) => `${ring}, ${column}`));
  out.push(both("azimuth", ({ azimuth }) => `${azimuth.toFixed(2)}°`));
  out.push(both("frame", ({ frameIndex }) => `${frameIndex}`));
  if (picked.some(({ madeUp }) => madeUp)) out.push(both("", ({ madeUp }) => (madeUp ? "filled in" : "measured")));
  return out;
}

export class Panel {
  readonly #marks = document.createElementNS(SVG, "svg");
  readonly #line = document.createElementNS(SVG, "line");
  readonly #rings = ["A", "B"].map(() => document.createElementNS(SVG, "circle"));
  readonly #told = document.createElement("div");
  readonly #table = document.createElement("table");

  constructor(host: HTMLElement) {
    this.#marks.setAttribute("class", "lidar-marks");
    this.#marks.setAttribute("aria-hidden", "true");
    this.#marks.append(this.#line, ...this.#rings);
    for (const ring of this.#rings) ring.setAttribute("r", "6");
    this.#told.className = "lidar-picked";
    this.#told.setAttribute("role", "status");
    this.#told.append(this.#table);
    host.append(this.#marks, this.#told);
  }

  /** Show rows; null: nothing. */
  show(told: string[][] | null): void {
    this.#told.hidden = told === null;
    this.#marks.toggleAttribute("hidden", told === null);
    this.#table.replaceChildren(
      ...(told ?? []).map((cells) => {
        const row = document.createElement("tr");
        for (const [number, text] of cells.entries()) {
          const cell = document.createElement(number === 0 ? "th" : "td");
          cell.textContent = text;
          if (cells.length === 1) cell.colSpan = 3;
          row.append(cell);
        }
        return row;
      }),
    );
  }

  /** Put the marks where the points are: CSS pixels from the upper left corner; null: out of sight. */
  place(at: readonly ([number, number] | null)[]): void {
    for (const [number, ring] of this.#rings.entries()) {
      const spot = at[number] ?? null;
      ring.toggleAttribute("hidden", spot === null);
      if (spot === null) continue;
      ring.setAttribute("cx", `${spot[0]}`);
      ring.setAttribute("cy", `${spot[1]}`);
    }
    const [a, b] = at;
    this.#line.toggleAttribute("hidden", !(a && b));
    if (!a || !b) return;
    for (const [name, value] of Object.entries({ x1: a[0], y1: a[1], x2: b[0], y2: b[1] })) {
      this.#line.setAttribute(name, `${value}`);
    }
  }
}
