/** "One zstd frame of n bytes" (docs/wire-format.md): its stated size is checked before memory is allocated. */

import { ZSTDDecoder } from "zstddec";
import { damaged } from "./errors.js";

const library = new ZSTDDecoder();

/** Must have finished before the first frame is decompressed. */
export async function zstdReady(): Promise<void> {
  await library.init();
}

/** The `size` bytes of a frame that has exactly that many, and is all of `data`. */
export function zstdFrame(data: Uint8Array, size: number): Uint8Array {
  if (frameSize(data) !== size) throw damaged(`not one zstd frame of ${size} bytes`);
  let plain: Uint8Array;
  try {
    plain = library.decode(data, size);
  } catch (error) {
    throw damaged(`a zstd frame that cannot be opened: ${error}`);
  }
  if (plain.length !== size) throw damaged(`a damaged zstd frame, of ${size} bytes`);
  return plain;
}

/** The content size that a frame states (RFC 8878, 3.1.1.1), if its blocks fill the data to the end; else -1. */
function frameSize(data: Uint8Array): number {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  if (data.length < 6 || view.getUint32(0, true) !== 0xfd2fb528) return -1;
  const descriptor = data[4];
  const single = (descriptor >> 5) & 1;
  const bytes = [single, 2, 4, 8][descriptor >> 6];
  const dictionary = descriptor & 3;
  let at = 5 + (single ? 0 : 1);
  if (dictionary !== 0 || bytes === 0 || data.length < at + bytes) return -1;
  let size = data[at];
  if (bytes === 2) size = view.getUint16(at, true) + 256;
  else if (bytes === 4) size = view.getUint32(at, true);
  else if (bytes === 8) size = Number(view.getBigUint64(at, true));
  at += bytes;
  for (let last = 0; !last; ) {
    if (data.length < at + 3) return -1;
    const head = data[at] | (data[at + 1] << 8) | (data[at + 2] << 16);
    last = head & 1;
    at += 3 + ((head >> 1) % 4 === 1 ? 1 : head >> 3); // type 1: one byte, repeated
  }
  return at + (descriptor & 4) === data.length ? size : -1;
}
