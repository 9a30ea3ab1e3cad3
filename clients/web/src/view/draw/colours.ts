/** Colour maps, computed here: even steps of lightness in OKLab, so that equal differences look equal.
 *
 * A map is a path through lightness, chroma and hue; what the screen cannot show is made less colourful, not clipped.
 * OKLab: https://bottosson.github.io/posts/oklab/ */
import type { Colour } from "../types";

export const STEPS = 256;
/** "stream" has no map: each stream has a colour of its own. */
export type MapName = Exclude<Colour, "stream"> | "error";
/** Rows of the texture that holds all maps. */
export const MAPS: readonly MapName[] = ["height", "intensity", "distance", "ring", "error"];

interface Path {
  lightness: readonly number[];
  chroma: readonly number[];
  /** Degrees. */
  hue: readonly number[];
}

/** On a dark ground what matters is light; on a light one it is dark. */
const PATHS: Record<"dark" | "light", Record<MapName, Path>> = {
  dark: {
    height: {
      lightness: [0.5, 0.62, 0.76, 0.88, 0.95],
      chroma: [0.13, 0.13, 0.14, 0.15, 0.06],
      hue: [275, 225, 165, 105, 85],
    },
    intensity: { lightness: [0.38, 0.57, 0.77, 0.97], chroma: [0.08, 0.12, 0.14, 0.04], hue: [300, 350, 415, 455] },
    distance: {
      lightness: [0.93, 0.82, 0.69, 0.56, 0.44],
      chroma: [0.09, 0.15, 0.16, 0.15, 0.12],
      hue: [95, 55, 20, -25, -70],
    },
    ring: {
      lightness: [0.78, 0.72, 0.78, 0.72, 0.78],
      chroma: [0.13, 0.13, 0.13, 0.13, 0.13],
      hue: [20, 110, 200, 290, 370],
    },
    error: {
      lightness: [0.42, 0.68, 0.82, 0.74, 0.66],
      chroma: [0.03, 0.1, 0.16, 0.19, 0.26],
      hue: [240, 160, 90, 50, 10],
    },
  },
  light: {
    height: {
      lightness: [0.34, 0.47, 0.57, 0.64, 0.68],
      chroma: [0.13, 0.11, 0.12, 0.14, 0.16],
      hue: [285, 240, 165, 95, 50],
    },
    intensity: { lightness: [0.76, 0.62, 0.46, 0.28], chroma: [0.06, 0.13, 0.15, 0.1], hue: [80, 40, -10, -70] },
    distance: {
      lightness: [0.38, 0.48, 0.57, 0.66, 0.74],
      chroma: [0.15, 0.18, 0.16, 0.13, 0.08],
      hue: [25, 0, -40, -80, -110],
    },
    ring: {
      lightness: [0.55, 0.5, 0.55, 0.5, 0.55],
      chroma: [0.14, 0.14, 0.14, 0.14, 0.14],
      hue: [20, 110, 200, 290, 370],
    },
    error: {
      lightness: [0.76, 0.62, 0.58, 0.52, 0.46],
      chroma: [0.02, 0.11, 0.14, 0.19, 0.22],
      hue: [240, 165, 85, 40, 5],
    },
  },
};

export type Rgb = [number, number, number];

/** A value at t in 0..1 of equally spaced stops, smoothly. */
export function along(stops: readonly number[], t: number): number {
  const last = stops.length - 1;
  const at = Math.min(Math.max(t, 0), 1) * last;
  const before = Math.min(Math.floor(at), last - 1);
  const part = at - before;
  const smooth = part * part * (3 - 2 * part) * 0.5 + part * 0.5;
  const a = stops[before] as number;
  return a + ((stops[before + 1] as number) - a) * smooth;
}

function linearOf(lightness: number, chroma: number, hue: number): Rgb {
  const a = chroma * Math.cos((hue * Math.PI) / 180);
  const b = chroma * Math.sin((hue * Math.PI) / 180);
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ];
}

const shown = (value: number) => value >= -1e-4 && value <= 1.0001;
const gamma = (value: number) => (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055);

/** 0..255 of red, green, blue; of the same lightness and hue, and as colourful as a screen can show. */
export function oklch(lightness: number, chroma: number, hue: number): Rgb {
  let most = chroma;
  let least = 0;
  let rgb = linearOf(lightness, chroma, hue);
  if (!rgb.every(shown)) {
    for (let turn = 0; turn < 12; turn++) {
      const middle = (least + most) / 2;
      rgb = linearOf(lightness, middle, hue);
      if (rgb.every(shown)) least = middle;
      else most = middle;
    }
    rgb = linearOf(lightness, least, hue);
  }
  return rgb.map((value) => Math.round(255 * gamma(Math.min(Math.max(value, 0), 1)))) as Rgb;
}

/** (STEPS, 4) of one map. */
export function mapOf(name: MapName, dark: boolean): Uint8Array {
  const path = PATHS[dark ? "dark" : "light"][name];
  const out = new Uint8Array(4 * STEPS);
  for (let step = 0; step < STEPS; step++) {
    const t = step / (STEPS - 1);
    out.set(oklch(along(path.lightness, t), along(path.chroma, t), along(path.hue, t)), 4 * step);
    out[4 * step + 3] = 255;
  }
  return out;
}

/** All maps, a row each in the order of MAPS. */
export function allMaps(dark: boolean): Uint8Array {
  const out = new Uint8Array(MAPS.length * 4 * STEPS);
  MAPS.forEach((name, row) => {
    out.set(mapOf(name, dark), row * 4 * STEPS);
  });
  return out;
}

/** What a colour stands for at both ends of its map. */
export const HEIGHT_M: readonly [number, number] = [-0.3, 5];
export const FAR_M = 80;
