/** The core of the package as a WebAssembly module (native/wasm): what it exports, and the arrays of its memory. */

import { DecodeError, type ErrorCode } from "../../../../typescript/src/errors.js";

/** What the module exports: native/wasm/api.cpp says it of each. */
interface Exports {
  readonly memory: WebAssembly.Memory;
  _initialize(): void;
  lidarcodec_open(): number;
  lidarcodec_input(stream: number, size: number): number;
  lidarcodec_sensor(stream: number): void;
  lidarcodec_columns(stream: number, at: number, size: number, width: number): void;
  lidarcodec_mask(
    stream: number,
    at: number,
    size: number,
    keep: number,
    motionAt: number,
    motionSize: number,
    follows: number,
  ): void;
  lidarcodec_intensity(stream: number, at: number, size: number): void;
  lidarcodec_begin_nets(stream: number): void;
  lidarcodec_net(
    stream: number,
    at: number,
    size: number,
    first: number,
    second: number,
    shift1: number,
    shift2: number,
    shift3: number,
    expects: number,
  ): void;
  lidarcodec_use_nets(stream: number, learned: number): void;
  lidarcodec_ranges(stream: number, at: number, size: number, step: number, follows: number): void;
  lidarcodec_done(stream: number, follows: number): void;
  lidarcodec_azimuth(stream: number): number;
  lidarcodec_fired(stream: number): number;
  lidarcodec_returns(stream: number): number;
  lidarcodec_bright(stream: number): number;
  lidarcodec_range(stream: number): number;
}

const ROWS = 64;
const NONE = 0xffffffff;
/** Of ErrorCode of native/src/base/error.hpp. */
const CODES: readonly ErrorCode[] = ["section", "header", "truncated", "checksum", "section", "section"];

/** Where a section lies in the message that was given last. */
export interface Part {
  readonly at: number;
  readonly size: number;
}

/** A network in a weight file: where its layers are, two hidden sizes, three shifts as the file has them. */
export interface Network {
  readonly layers: Uint8Array;
  readonly hidden: readonly [number, number];
  readonly shifts: readonly [number, number, number];
  readonly expects: boolean;
}

/** The state of one stream. After any error it is of no more use: make another one. */
export class NativeStream {
  readonly #exports: Exports;
  readonly #stream: number;
  width = 0;

  constructor(module: WebAssembly.Module) {
    const failed = (code: number, what: number): never => {
      throw new DecodeError(CODES[code] ?? "section", this.#text(what));
    };
    const instance = new WebAssembly.Instance(module, { lidarcodec: { failed } });
    this.#exports = instance.exports as unknown as Exports;
    this.#exports._initialize();
    this.#stream = this.#exports.lidarcodec_open();
  }

  #bytes(): Uint8Array {
    return new Uint8Array(this.#exports.memory.buffer);
  }

  #text(at: number): string {
    const bytes = this.#bytes();
    return new TextDecoder().decode(bytes.slice(at, Math.min(bytes.indexOf(0, at), at + 500)));
  }

  /** Gives the bytes that parts are parts of. */
  give(data: Uint8Array): void {
    const at = this.#exports.lidarcodec_input(this.#stream, data.length);
    this.#bytes().set(data, at);
  }

  /** rows: (6, 64), of each row of an image its half, and what the calibration says of it */
  sensor(rows: Int32Array): void {
    this.give(new Uint8Array(rows.buffer, rows.byteOffset, rows.byteLength));
    this.#exports.lidarcodec_sensor(this.#stream);
  }

  columns({ at, size }: Part, width: number): void {
    this.width = width;
    this.#exports.lidarcodec_columns(this.#stream, at, size, width);
  }

  mask({ at, size }: Part, keep: boolean, motion: Part | null, follows: boolean): void {
    const [motionAt, motionSize] = [motion?.at ?? NONE, motion?.size ?? 0];
    this.#exports.lidarcodec_mask(this.#stream, at, size, +keep, motionAt, motionSize, +follows);
  }

  intensity({ at, size }: Part): void {
    this.#exports.lidarcodec_intensity(this.#stream, at, size);
  }

  /** Codes with these networks from now on, as if nothing had been learned; null: without any. */
  networks(networks: readonly Network[] | null): void {
    this.#exports.lidarcodec_begin_nets(this.#stream);
    for (const { layers, hidden, shifts, expects } of networks ?? []) {
      this.give(layers);
      this.#exports.lidarcodec_net(this.#stream, 0, layers.length, ...hidden, ...shifts, +expects);
    }
    this.#exports.lidarcodec_use_nets(this.#stream, +(networks !== null));
  }

  ranges({ at, size }: Part, step: number, follows: boolean): void {
    this.#exports.lidarcodec_ranges(this.#stream, at, size, step, +follows);
  }

  done(follows: boolean): void {
    this.#exports.lidarcodec_done(this.#stream, +follows);
  }

  // Views of arrays: they hold until the next call.

  get azimuth(): Uint16Array {
    return new Uint16Array(this.#exports.memory.buffer, this.#exports.lidarcodec_azimuth(this.#stream), 2 * this.width);
  }

  get fired(): Uint8Array {
    return new Uint8Array(this.#exports.memory.buffer, this.#exports.lidarcodec_fired(this.#stream), 2 * this.width);
  }

  get returns(): Uint8Array {
    const at = this.#exports.lidarcodec_returns(this.#stream);
    return new Uint8Array(this.#exports.memory.buffer, at, ROWS * this.width);
  }

  get intensities(): Uint8Array {
    const at = this.#exports.lidarcodec_bright(this.#stream);
    return new Uint8Array(this.#exports.memory.buffer, at, ROWS * this.width);
  }

  get range(): Uint16Array {
    return new Uint16Array(
      this.#exports.memory.buffer,
      this.#exports.lidarcodec_range(this.#stream),
      ROWS * this.width,
    );
  }
}
