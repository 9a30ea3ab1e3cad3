/** A picture of the view as a PNG, with a caption below it. */
import type { Colour3, Theme } from "./theme";

const SIZE_CSS = 13;
const MARGIN = 0.6;

const css = ([r, g, b]: Colour3) => `rgb(${[r, g, b].map((part) => Math.round(255 * part)).join(" ")})`;

/** canvas: as it was drawn in this task of the browser; later its pixels may be gone. Null if it cannot be written. */
export function captioned(canvas: HTMLCanvasElement, caption: string, theme: Theme, ratio: number) {
  const size = Math.round(SIZE_CSS * ratio);
  const out = document.createElement("canvas");
  const pen = out.getContext("2d");
  if (!pen) return Promise.resolve(null);
  const font = `${size}px system-ui, sans-serif`;
  pen.font = font;
  const room = canvas.width - 2 * size * MARGIN;
  const lines: string[] = [];
  for (const part of caption.split(" · ")) {
    const longer = lines.length ? `${lines.at(-1)} · ${part}` : part;
    if (lines.length && pen.measureText(longer).width <= room) lines[lines.length - 1] = longer;
    else lines.push(part);
  }
  out.width = canvas.width;
  out.height = canvas.height + Math.round(size * (lines.length * 1.4 + MARGIN));
  pen.fillStyle = css(theme.paper);
  pen.fillRect(0, 0, out.width, out.height);
  pen.drawImage(canvas, 0, 0);
  pen.font = font;
  pen.fillStyle = css(theme.ink);
  lines.forEach((line, row) => {
    pen.fillText(line, size * MARGIN, canvas.height + size * (1.1 + 1.4 * row));
  });
  return new Promise<Blob | null>((done) => out.toBlob(done, "image/png"));
}
