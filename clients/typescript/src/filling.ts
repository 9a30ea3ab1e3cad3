/** Interpolated returns between sent columns: the rule of lidarcodec/filling.py.
 *
 * Between two returns of a row on one surface the inverse of the range is interpolated. Elsewhere each return stands for
 * the half of the gap that is next to it, and the middle column stays empty. All in whole numbers, so that every decoder
 * makes up the same. They are marked, and never counted as measured. */

import type { Frame } from "./decoder.js";
import type { Lattice } from "./lattice.js";

/** Ranges a and b lie on one surface if they differ by at most JUMP + min(a, b) / SHARE steps; 0.25 m. */
const JUMP = 125;
const SHARE = 20;
/** Largest gap in columns that is filled. */
const WIDEST = 64;

/** Fills images in place, of any number of rows. Returns as many numbers, 1 where a return was made up, and how many there are.
 *
 * range, intensity: rows x W, 0 between the columns that were sent */
export function fill(range: Uint16Array, intensity: Uint8Array | null, { width, columns }: Lattice): [Uint8Array, number] {
  const made = new Uint8Array(range.length);
  let count = 0;
  for (let row = 0; row * width < range.length; row++)
    for (let i = 0; i + 1 < columns.length; i++) {
      const [left, right] = [row * width + columns[i], row * width + columns[i + 1]];
      const gap = right - left;
      const [a, b] = [range[left], range[right]];
      const near = Math.min(a, b);
      if (gap < 2 || gap > WIDEST) continue;
      const surface = near > 0 && Math.abs(a - b) <= JUMP + Math.floor(near / SHARE);
      for (let place = 1; place < gap; place++) {
        const nearest = 2 * place < gap ? left : right;
        if (!surface && (2 * place === gap || range[nearest] === 0)) continue;
        const weighted = b * (gap - place) + a * place;
        range[left + place] = surface ? Math.floor((2 * a * b * gap + weighted) / (2 * weighted)) : range[nearest];
        if (intensity)
          intensity[left + place] = surface
            ? Math.floor((intensity[left] * (gap - place) + intensity[right] * place) / gap)
            : intensity[nearest];
        made[left + place] = 1;
        count++;
      }
    }
  return [made, count];
}

/** The frame with interpolated returns between the columns of its lattice, marked in `filled`; other frames unchanged. */
export function filled(frame: Frame): Frame {
  if (frame.lattice === null || frame.filled !== null) return frame;
  const [range, intensity] = [frame.range.slice(), frame.intensity.slice()];
  const [made, madeUp] = fill(range, intensity, { width: frame.width, columns: frame.lattice });
  return { ...frame, range, intensity, filled: made, madeUp };
}
