/** A picture of the view as a PNG, with a caption below it. */
import type { Colour3, Theme } from "./theme";

const SIZE_CSS = 13;
const MARGIN = 0.6;

const css = ([r, g, b]: Colour3) => `rgb(${[r, g, b].map((part) => Math.round(255 * part)).join(" ")})`;

/** Lines that a clip has room for beyond those of its first caption. */
export const SPARE_LINES = 2;
const LINE = 1.4;
/** Letters get smaller by this factor until a caption has room. */
const SMALLER = 0.9;

/** A canvas for pictures with captions: of one picture, or of all of a clip, whose size stays that of the first. */
export class Captioned {
  readonly out = document.createElement("canvas");
  readonly #size: number;
  #strip = 0;

  /** spare: lines for captions that get longer */
  constructor(
    private readonly theme: Theme,
    ratio: number,
    private readonly spare = 0,
  ) {
    this.#size = Math.round(SIZE_CSS * ratio);
  }

  /** canvas: as it was drawn in this task of the browser; later its pixels may be gone. False if it cannot be drawn. */
  draw(canvas: HTMLCanvasElement, caption: string): boolean {
    const { out } = this;
    const pen = out.getContext("2d");
    if (!pen) return false;
    if (this.#strip === 0) {
      pen.font = fontOf(this.#size);
      const lines = linesOf(pen, caption, canvas.width - 2 * this.#size * MARGIN).length + this.spare;
      this.#strip = Math.round(this.#size * (lines * LINE + MARGIN));
      out.width = canvas.width;
      out.height = canvas.height + this.#strip;
    }
    const below = out.height - this.#strip;
    pen.fillStyle = css(this.theme.paper);
    pen.fillRect(0, 0, out.width, out.height);
    pen.drawImage(canvas, 0, 0, out.width, below);
    pen.fillStyle = css(this.theme.ink);
    const { size, lines } = fitted(pen, caption, out.width, this.#strip, this.#size);
    lines.forEach((line, row) => {
      pen.fillText(line, size * MARGIN, below + size * (1.1 + LINE * row));
    });
    return true;
  }
}

type Pen = Pick<CanvasRenderingContext2D, "font" | "measureText">;

const fontOf = (size: number) => `${size}px system-ui, sans-serif`;

/** A caption in a strip of a picture: its lines, and the size of its letters, smaller where it has no room otherwise. The
 * pen has that font then. wide, high: of the strip, in pixels */
export function fitted(pen: Pen, caption: string, wide: number, high: number, size: number) {
  for (;;) {
    pen.font = fontOf(size);
    const lines = linesOf(pen, caption, wide - 2 * size * MARGIN);
    if (size * (lines.length * LINE + MARGIN) <= high + 1 || size < 2) return { size, lines };
    size *= SMALLER;
  }
}

/** The parts of a caption in lines that fit; only a part that is longer than a line is broken between words. */
function linesOf(pen: Pen, caption: string, room: number): string[] {
  const lines: string[] = [];
  const fits = (text: string) => pen.measureText(text).width <= room;
  for (const part of caption.split(" · ")) {
    let line = lines.pop();
    for (const [number, word] of (fits(part) ? [part] : part.split(" ")).entries()) {
      const longer = line === undefined ? word : `${line}${number === 0 ? " · " : " "}${word}`;
      if (line === undefined || fits(longer)) line = longer;
      else {
        lines.push(line);
        line = word;
      }
    }
    if (line !== undefined) lines.push(line);
  }
  return lines;
}

/** canvas: as of `Captioned.draw`. Null if it cannot be written. */
export function captioned(canvas: HTMLCanvasElement, caption: string, theme: Theme, ratio: number) {
  const picture = new Captioned(theme, ratio);
  if (!picture.draw(canvas, caption)) return Promise.resolve(null);
  return new Promise<Blob | null>((done) => picture.out.toBlob(done, "image/png"));
}
