/** Decodes messages of the frames socket in the page, in a thread of its own (README.md says which, and what it costs). */

import type { SensorEvent } from "../view/stream/sensor";
import type { Asked } from "./protocol";

/** Of a sensor what the cloud socket's event `sensor` says. */
export type SensorFacts = SensorEvent & { readonly hash: string };

export interface DecodedFrame {
  /** What the cloud socket would send with form=range: header, range, azimuth, intensity (docs/live-sockets.md). */
  readonly data: ArrayBuffer;
  readonly sensor: SensorFacts;
  /** Another number where `sensor` says something else. */
  readonly told: number;
}

/** Why a message became no frame. `version`: its codec, or something in it, is not decoded here; `reference`: it builds on
 * a message that was not decoded; `failed`: the thread did. */
export class DecodeFailure extends Error {
  constructor(
    readonly code: string,
    message: string,
  ) {
    super(message);
    this.name = "DecodeFailure";
  }
}

export interface Decoder {
  /** The frame of the stream's next message, whose bytes are given away. Rejects with DecodeFailure, and goes on. */
  push(message: ArrayBuffer): Promise<DecodedFrame>;
  dispose(): void;
}

export interface DecoderOptions {
  /** Where the server has weights of codec riddle, by name; by default the page's own server. */
  readonly weights?: string;
  readonly token?: string | undefined;
  /** Whether returns are made up between the columns that were sent. */
  readonly fill?: boolean;
}

/** Codecs that are decoded here, by number (docs/wire-format.md): raw, zstd, png, riddle, predictive. */
export const DECODED_HERE: ReadonlySet<number> = new Set([1, 2, 3, 4, 10, 11]);

/** A frame takes a fiftieth of this; a thread that is silent for so long has stumbled over something and is begun anew. */
const PATIENCE_MS = 15_000;

interface Answer {
  readonly id: number;
  readonly data?: ArrayBuffer;
  readonly sensor?: SensorFacts;
  readonly told?: number;
  readonly code?: string;
  readonly error?: string;
}

interface Waiting {
  resolve(frame: DecodedFrame): void;
  reject(failure: DecodeFailure): void;
}

class Thread implements Decoder {
  readonly #options: DecoderOptions;
  readonly #waiting = new Map<number, Waiting>();
  #worker: Worker | null = null;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #next = 0;

  constructor(options: DecoderOptions) {
    this.#options = options;
  }

  push(message: ArrayBuffer): Promise<DecodedFrame> {
    const worker = this.#worker ?? this.#begin();
    const id = this.#next++;
    worker.postMessage({ id, message } satisfies Asked, [message]);
    if (this.#waiting.size === 0) this.#watch();
    return new Promise((resolve, reject) => this.#waiting.set(id, { resolve, reject }));
  }

  dispose(): void {
    this.#end("the decoder was ended");
  }

  #begin(): Worker {
    const worker = new Worker(new URL("./worker/worker.ts", import.meta.url), { type: "module", name: "decoder" });
    const { weights = new URL("api/v1/codecs/riddle/weights/", document.baseURI).href, token } = this.#options;
    const headers: Record<string, string> = token ? { Authorization: `Bearer ${token}` } : {};
    worker.postMessage({ weights, headers, fill: this.#options.fill ?? false } satisfies Asked);
    worker.onmessage = ({ data }: MessageEvent<Answer>) => this.#answered(data);
    worker.onerror = ({ message }) => this.#end(message || "the decoder could not be loaded");
    this.#worker = worker;
    return worker;
  }

  #answered({ id, data, sensor, told, code, error }: Answer): void {
    const waiting = this.#waiting.get(id);
    this.#waiting.delete(id);
    clearTimeout(this.#timer);
    if (this.#waiting.size > 0) this.#watch();
    if (data && sensor && told !== undefined) waiting?.resolve({ data, sensor, told });
    else waiting?.reject(new DecodeFailure(code ?? "failed", error ?? "the decoder gave no frame"));
  }

  #watch(): void {
    this.#timer = setTimeout(() => this.#end("the decoder did not answer"), PATIENCE_MS);
  }

  #end(why: string): void {
    clearTimeout(this.#timer);
    this.#worker?.terminate();
    this.#worker = null;
    const waiting = [...this.#waiting.values()];
    this.#waiting.clear();
    for (const { reject } of waiting) reject(new DecodeFailure("failed", why));
  }
}

/** A decoder of one stream. Its thread begins with the first message. */
export function createDecoder(options: DecoderOptions = {}): Decoder {
  return new Thread(options);
}
