/** A picture of the view as a PNG, with a caption below it. */
import type { Colour3, Theme } from "./theme";

const SIZE_CSS = 13;
const MARGIN = 0.6;

const css = ([r, g, b]: Colour3) => `rgb(${[r, g, b].map((part) => Math.round(255 * part)).join(" ")})`;

/** A canvas for pictures with captions: of one picture, or of all of a clip, whose size stays that of the first. */
export class Captioned {
  readonly out = document.createElement("canvas");
  readonly #size: number;
  #lines = 0;

  constructor(
    private readonly theme: Theme,
    ratio: number,
  ) {
    this.#size = Math.round(SIZE_CSS * ratio);
  }

  /** canvas: as it was drawn in this task of the browser; later its pixels may be gone. False if it cannot be drawn. */
  draw(canvas: HTMLCanvasElement, caption: string): boolean {
    const { out } = this;
    const size = this.#size;
    const pen = out.getContext("2d");
    if (!pen) return false;
    const font = `${size}px system-ui, sans-serif`;
    pen.font = font;
    if (this.#lines === 0) {
      this.#lines = linesOf(pen, caption, canvas.width - 2 * size * MARGIN).length;
      out.width = canvas.width;
      out.height = canvas.height + Math.round(size * (this.#lines * 1.4 + MARGIN));
      pen.font = font;
    }
    const below = out.height - Math.round(size * (this.#lines * 1.4 + MARGIN));
    const lines = linesOf(pen, caption, out.width - 2 * size * MARGIN).slice(0, this.#lines);
    pen.fillStyle = css(this.theme.paper);
    pen.fillRect(0, 0, out.width, out.height);
    pen.drawImage(canvas, 0, 0, out.width, below);
    pen.fillStyle = css(this.theme.ink);
    lines.forEach((line, row) => {
      pen.fillText(line, size * MARGIN, below + size * (1.1 + 1.4 * row));
    });
    return true;
  }
}

/** The parts of a caption in lines that fit. */
function linesOf(pen: CanvasRenderingContext2D, caption: string, room: number): string[] {
  const lines: string[] = [];
  for (const part of caption.split(" · ")) {
    const longer = lines.length ? `${lines.at(-1)} · ${part}` : part;
    if (lines.length && pen.measureText(longer).width <= room) lines[lines.length - 1] = longer;
    else lines.push(part);
  }
  return lines;
}

/** canvas: as of `Captioned.draw`. Null if it cannot be written. */
export function captioned(canvas: HTMLCanvasElement, caption: string, theme: Theme, ratio: number) {
  const picture = new Captioned(theme, ratio);
  if (!picture.draw(canvas, caption)) return Promise.resolve(null);
  return new Promise<Blob | null>((done) => picture.out.toBlob(done, "image/png"));
}
