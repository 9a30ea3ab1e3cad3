/** Where on the canvas what is drawn; device pixels, from the lower left corner as the graphics card counts. */

export interface Rect {
  x: number;
  y: number;
  wide: number;
  high: number;
}

export interface Pane {
  cloud: Rect;
  image: Rect | null;
}

const STRIP_CSS = 132;
/** More of the window than this is not given to the range image. */
const STRIP_PART = 0.24;

/** One pane, or two beside one another; one above the other in an upright window. */
export function layout(wide: number, high: number, ratio: number, panes: 1 | 2, images: boolean): Pane[] {
  const upright = panes === 2 && high > wide;
  const paneWide = upright || panes === 1 ? wide : Math.floor(wide / 2);
  const paneHigh = upright ? Math.floor(high / 2) : high;
  const most = paneHigh * STRIP_PART;
  // whole pixels a ring where there are so many, so that no ring is thicker than another
  const rings = Math.min(STRIP_CSS * ratio, most);
  const strip = images ? Math.max(Math.floor(rings / 64) * 64, Math.min(Math.floor(rings), 64)) : 0;
  const made: Pane[] = [];
  for (let number = 0; number < panes; number++) {
    const x = upright ? 0 : number * paneWide;
    const y = upright ? (panes - 1 - number) * paneHigh : 0;
    made.push({
      cloud: { x, y: y + strip, wide: paneWide, high: paneHigh - strip },
      image: strip > 0 ? { x, y, wide: paneWide, high: strip } : null,
    });
  }
  return made;
}
