/** Which streams are in the picture: each with its colour, and why one lies elsewhere or is missing. */
import type { LegendRow } from "../scene/guests";

export class Legend {
  readonly #list = document.createElement("ul");
  #told = "";

  constructor(host: HTMLElement) {
    this.#list.className = "lidar-streams";
    this.#list.setAttribute("aria-label", "Streams in the picture");
    this.#list.hidden = true;
    host.append(this.#list);
  }

  /** Written only when it changes. swatches: whether points have the colours of their streams */
  show(rows: readonly LegendRow[], swatches: boolean): void {
    const told = JSON.stringify([rows, swatches]);
    if (told === this.#told) return;
    this.#told = told;
    this.#list.hidden = rows.length === 0;
    this.#list.replaceChildren(
      ...rows.map(({ name, colour, points, note }) => {
        const row = document.createElement("li");
        const swatch = document.createElement("span");
        swatch.className = "lidar-swatch";
        swatch.hidden = !swatches;
        const [r, g, b] = colour.map((part) => Math.round(255 * part));
        swatch.style.background = `rgb(${r} ${g} ${b})`;
        row.append(swatch, `${name}  ${points.toLocaleString("en")}`);
        if (note) {
          const why = document.createElement("small");
          why.textContent = note;
          row.append(why);
        }
        return row;
      }),
    );
  }
}
