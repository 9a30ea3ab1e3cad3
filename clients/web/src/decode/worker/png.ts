/** The image of codec png: 16 bits, grey; filters none and sub. The browser inflates it. */

import { damaged } from "../../../../typescript/src/errors.js";

const SIGNATURE = [137, 80, 78, 71, 13, 10, 26, 10];

/** (rows, width) samples. */
export async function readPng(data: Uint8Array, rows: number, width: number): Promise<Uint16Array> {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (data.length < 33 || SIGNATURE.some((byte, at) => data[at] !== byte)) throw damaged("no PNG");
  const packed: Uint8Array[] = [];
  let ended = false;
  for (let at = 8; !ended; ) {
    if (data.length - at < 12) throw damaged("a PNG that is cut");
    const size = view.getUint32(at);
    const kind = String.fromCharCode(...data.subarray(at + 4, at + 8));
    if (size > data.length - at - 12) throw damaged("a PNG that is cut");
    if ((kind === "IHDR") !== (at === 8)) throw damaged("a PNG that does not begin with its header");
    if (kind === "IHDR") {
      const fits = size === 13 && view.getUint32(at + 8) === width && view.getUint32(at + 12) === rows;
      if (!fits || hexOf(data.subarray(at + 16, at + 21)) !== "1000000000")
        throw damaged(`a PNG that is not 16 bits of ${width} x ${rows}`);
    } else if (kind === "IDAT") packed.push(data.subarray(at + 8, at + 8 + size));
    else if (kind === "IEND") ended = true;
    else throw damaged("a PNG with a part that has no place in it");
    at += 12 + size;
    if (ended && at !== data.length) throw damaged("bytes after a PNG");
  }
  const line = 2 * width + 1;
  return unfiltered(await inflated(packed, line * rows), rows, width);
}

function hexOf(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Exactly so many bytes; more are not taken. */
async function inflated(packed: Uint8Array[], size: number): Promise<Uint8Array> {
  const out = new Uint8Array(size);
  let at = 0;
  try {
    const stream = new Blob(packed as BlobPart[]).stream().pipeThrough(new DecompressionStream("deflate"));
    const reader = stream.getReader();
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (value.length > size - at) {
        await reader.cancel();
        throw damaged("a PNG of more samples than its size");
      }
      out.set(value, at);
      at += value.length;
    }
  } catch (error) {
    throw damaged(`a damaged PNG: ${error instanceof Error ? error.message : error}`);
  }
  if (at !== size) throw damaged("a PNG of fewer samples than its size");
  return out;
}

function unfiltered(lines: Uint8Array, rows: number, width: number): Uint16Array {
  const line = 2 * width + 1;
  const image = new Uint16Array(rows * width);
  for (let row = 0; row < rows; row++) {
    const begin = row * line + 1;
    const filter = lines[begin - 1];
    if (filter > 1) throw damaged(`a PNG with the filter ${filter}`);
    for (let i = 2; filter === 1 && i < line - 1; i++) lines[begin + i] += lines[begin + i - 2];
    for (let column = 0; column < width; column++)
      image[row * width + column] = (lines[begin + 2 * column] << 8) | lines[begin + 2 * column + 1];
  }
  return image;
}
