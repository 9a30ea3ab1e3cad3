/** Interpolated returns between sent columns: the rule of lidarcodec/filling.py.
 *
 * Between two returns of a row on one surface the inverse of the range is interpolated. Elsewhere each return stands for
 * the half of the gap that is next to it, and its surface goes on along the line from the return before it. Midway it is
 * the farther of the two. All in whole numbers, so that every decoder makes up the same. They are marked, and never
 * counted as measured. */

import type { Frame } from "./decoder.js";
import type { Lattice } from "./lattice.js";

/** Ranges a and b are alike if they differ by at most JUMP + min(a, b) / SHARE steps (0.25 m), close if by half of that. */
const JUMP = 125;
const SHARE = 20;
/** Largest gap in columns that is filled. */
const WIDEST = 64;

/** part: 1 for alike, 2 for close */
function within(a: number, b: number, part: 1 | 2): boolean {
  const near = Math.min(a, b);
  return near > 0 && Math.abs(a - b) <= Math.floor(JUMP / part) + Math.floor(near / (part * SHARE));
}

const alike = (a: number, b: number) => within(a, b, 1);
const close = (a: number, b: number) => within(a, b, 2);

/** The range `place` columns past the range a, on the line from the range that is `gap` columns before it; 0 if none. */
function beyond(a: number, before: number, place: number, gap: number): number {
  const weighted = before * gap + (before - a) * place;
  return weighted > 0 ? Math.floor((2 * a * before * gap + weighted) / (2 * weighted)) : 0;
}

/** The range `place` columns past the range a, whose surface ends in the gap. farthest: of all that were sent */
function edge(a: number, before: number, place: number, gap: number, farthest: number): number {
  const on = beyond(a, before, place, gap);
  return close(before, a) && close(on, a) && on <= farthest ? on : a;
}

/** Fills images in place, of any number of rows. Returns as many numbers, 1 where a return was made up, and how many there are.
 *
 * range, intensity: rows x W, 0 between the columns that were sent */
export function fill(range: Uint16Array, intensity: Uint8Array | null, { width, columns }: Lattice): [Uint8Array, number] {
  const made = new Uint8Array(range.length);
  let count = 0;
  let farthest = 0;
  for (let i = 0; i < range.length; i++) farthest = Math.max(farthest, range[i]);
  for (let row = 0; row * width < range.length; row++)
    for (let i = 0; i + 1 < columns.length; i++) {
      const [left, right] = [row * width + columns[i], row * width + columns[i + 1]];
      const gap = right - left;
      const [a, b] = [range[left], range[right]];
      if (gap < 2 || gap > WIDEST || (a === 0 && b === 0)) continue;
      const [before, after] = [i > 0 ? row * width + columns[i - 1] : left, row * width + (columns[i + 2] ?? columns[i + 1])];
      const [from, until] = [before < left ? range[before] : 0, after > right ? range[after] : 0];
      const [reach, past] = [Math.max(left - before, 1), Math.max(after - right, 1)];
      const onward = alike(a, b) || close(beyond(a, from, gap, reach), b) || close(beyond(b, until, gap, past), a);
      const surface = a > 0 && b > 0 && onward;
      for (let place = 1; place < gap; place++) {
        let one = 0;
        let isRight = 2 * place > gap;
        if (surface) {
          const weighted = b * (gap - place) + a * place;
          one = Math.floor((2 * a * b * gap + weighted) / (2 * weighted));
        } else {
          const near = edge(a, from, place, reach, farthest);
          const far = edge(b, until, gap - place, past, farthest);
          isRight ||= 2 * place === gap && far > near;
          one = isRight ? far : near;
        }
        if (one === 0) continue;
        range[left + place] = one;
        if (intensity)
          intensity[left + place] = surface
            ? Math.floor((intensity[left] * (gap - place) + intensity[right] * place) / gap)
            : intensity[isRight ? right : left];
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
