/** Colours of the picture, after the background on which the page shows it. */
import { oklch, type Rgb } from "./colours";

export type Colour3 = readonly [number, number, number];

export interface Theme {
  dark: boolean;
  paper: Colour3;
  ink: Colour3;
  accent: Colour3;
  /** Where the range image has no return. */
  none: Colour3;
  dropped: Colour3;
  invented: Colour3;
}

const part = ([r, g, b]: Rgb): Colour3 => [r / 255, g / 255, b / 255];

const DARK: Theme = {
  dark: true,
  paper: part(oklch(0.17, 0.012, 260)),
  ink: part(oklch(0.8, 0.02, 250)),
  accent: part(oklch(0.86, 0.15, 85)),
  none: part(oklch(0.12, 0.01, 260)),
  dropped: part(oklch(0.34, 0.012, 260)),
  invented: part(oklch(0.7, 0.27, 330)),
};
const LIGHT: Theme = {
  dark: false,
  paper: part(oklch(0.975, 0.004, 250)),
  ink: part(oklch(0.42, 0.02, 250)),
  accent: part(oklch(0.58, 0.19, 35)),
  none: part(oklch(0.92, 0.004, 250)),
  dropped: part(oklch(0.85, 0.008, 250)),
  invented: part(oklch(0.55, 0.27, 325)),
};

/** Follows what the page or the system says: the colour scheme that is in force for the element. */
export class ThemeWatch {
  theme: Theme = DARK;
  readonly #query = window.matchMedia("(prefers-color-scheme: dark)");
  readonly #observer: MutationObserver;
  readonly #look: () => void;

  constructor(element: HTMLElement, changed: () => void) {
    this.#look = () => {
      const before = this.theme;
      this.theme = isDark(element, this.#query.matches) ? DARK : LIGHT;
      if (this.theme !== before) changed();
    };
    this.#query.addEventListener("change", this.#look);
    this.#observer = new MutationObserver(this.#look);
    const options = { attributes: true, attributeFilter: ["class", "style", "data-theme", "data-scheme"] };
    this.#observer.observe(document.documentElement, options);
    this.#observer.observe(document.body, options);
    this.#look();
  }

  dispose(): void {
    this.#query.removeEventListener("change", this.#look);
    this.#observer.disconnect();
  }
}

function isDark(element: HTMLElement, systemDark: boolean): boolean {
  const scheme = getComputedStyle(element).colorScheme;
  const darkFirst = scheme.includes("dark") && scheme.includes("light");
  return darkFirst || !scheme.match(/dark|light/) ? systemDark : scheme.includes("dark");
}
