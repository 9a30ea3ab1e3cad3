/** The decoder's thread: messages in, range images out, one after the other (index.ts is the other end). */

import { DecodeError } from "../../../../typescript/src/errors.js";
import { zstdReady } from "../../../../typescript/src/zstd.js";
import type { Asked } from "../protocol";
import wasm from "./decoder.wasm?url";
import { StreamDecoder } from "./stream.js";

let asked = { weights: "", headers: {} as Record<string, string>, fill: false };

async function weightsOf(name: string): Promise<Uint8Array | null> {
  const answer = await fetch(`${asked.weights}${name}`, { headers: asked.headers });
  return answer.ok ? new Uint8Array(await answer.arrayBuffer()) : null;
}

async function begun(): Promise<StreamDecoder> {
  const [bytes] = await Promise.all([fetch(wasm).then((answer) => answer.arrayBuffer()), zstdReady()]);
  return new StreamDecoder(await WebAssembly.compile(bytes), weightsOf, Date.now);
}

const decoder = begun();
let before: Promise<void> = Promise.resolve();

async function decode(id: number, message: ArrayBuffer): Promise<void> {
  try {
    const { data, sensor, told } = await (await decoder).decode(new Uint8Array(message), asked.fill);
    postMessage({ id, data, sensor, told }, { transfer: [data] });
  } catch (error) {
    const code = error instanceof DecodeError ? error.code : "failed";
    postMessage({ id, code, error: error instanceof Error ? error.message : String(error) });
  }
}

addEventListener("message", ({ data }: MessageEvent<Asked>) => {
  if ("weights" in data) asked = data;
  else before = before.then(() => decode(data.id, data.message));
});
