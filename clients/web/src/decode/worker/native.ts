/** The core of the package as a WebAssembly module (native/wasm): what it exports, and the arrays of its memory. */

import type { CloudPlanes } from "../../../../typescript/src/clouds/section.js";
import { DecodeError, type ErrorCode } from "../../../../typescript/src/errors.js";
import { inflated } from "../../../../typescript/src/inflate.js";
import { ROWS, type Sensor } from "../../../../typescript/src/sensor.js";
import { zstdFrame } from "../../../../typescript/src/zstd.js";

/** What the module exports: native/wasm/api.cpp says it of each. */
interface Exports {
  readonly memory: WebAssembly.Memory;
  _initialize(): void;
  lidarcodec_open(): number;
  lidarcodec_input(stream: number, size: number): number;
  lidarcodec_give_calibration(stream: number): void;
  lidarcodec_missing_weights(stream: number): number;
  lidarcodec_give_weights(stream: number): void;
  lidarcodec_give_picture(stream: number): void;
  lidarcodec_push(stream: number): void;
  lidarcodec_read_planes(stream: number, columns: number): void;
  lidarcodec_plane_rows(stream: number): number;
  lidarcodec_plane_count(stream: number): number;
  lidarcodec_plane_name(stream: number, number: number): number;
  lidarcodec_plane_values(stream: number, number: number): number;
  lidarcodec_rows(stream: number): number;
  lidarcodec_width(stream: number): number;
  lidarcodec_azimuth(stream: number): number;
  lidarcodec_range(stream: number): number;
  lidarcodec_intensity(stream: number): number;
  lidarcodec_sensor_model(stream: number): number;
  lidarcodec_sensor_name(stream: number): number;
  lidarcodec_sensor_hash(stream: number): number;
  lidarcodec_convention(stream: number): number;
  lidarcodec_range_step(stream: number): number;
  lidarcodec_table(stream: number): number;
  lidarcodec_laser(stream: number): number;
  lidarcodec_rings(stream: number): number;
}

const TABLE = 11 * ROWS;
/** Numbers of a ring. */
const RING = 5;
const LOWER_LASERS = 32;
/** Of ErrorCode of native/src/base/error.hpp. */
const CODES: readonly ErrorCode[] = [
  "section",
  "header",
  "truncated",
  "checksum",
  "section",
  "section",
  "version",
  "reference",
];

/** A frame, views that hold until the next call. */
export interface NativeFrame {
  readonly rows: number;
  readonly width: number;
  readonly range: Uint16Array;
  readonly azimuth: Uint16Array;
  /** Null where none are sent. */
  readonly intensity: Uint8Array | null;
}

/** Another sensor than an HDL-64E, with the geometry of each row, fitted to a frame. */
export interface Rings {
  readonly name: string;
  readonly model: string;
  readonly hash: string;
  /** Metres of a step of the range image. */
  readonly rangeStep: number;
  readonly laser: Uint8Array;
  /** (rows, 5): rotation, elevation, distance, height, aside; radians and metres. */
  readonly values: Float64Array;
}

/** A session of the core. After any error that it throws it is of no more use: make another one. */
export class NativeStream {
  readonly #exports: Exports;
  readonly #stream: number;

  constructor(module: WebAssembly.Module) {
    const failed = (code: number, what: number): never => {
      throw new DecodeError(CODES[code] ?? "section", this.#text(what));
    };
    const unzstd = (frame: number, size: number, plain: number, bytes: number): number =>
      this.#opened(plain, () => zstdFrame(this.#bytes().slice(frame, frame + size), bytes)) === bytes ? 1 : 0;
    const inflate = (stream: number, size: number, plain: number, most: number): number =>
      this.#opened(plain, () => inflated(this.#bytes().slice(stream, stream + size), most));
    const instance = new WebAssembly.Instance(module, { lidarcodec: { failed, unzstd, inflate } });
    this.#exports = instance.exports as unknown as Exports;
    this.#exports._initialize();
    this.#stream = this.#exports.lidarcodec_open();
  }

  #bytes(): Uint8Array {
    return new Uint8Array(this.#exports.memory.buffer);
  }

  #text(at: number): string {
    const bytes = this.#bytes();
    return new TextDecoder("utf-8", { ignoreBOM: true }).decode(
      bytes.slice(at, Math.min(bytes.indexOf(0, at), at + 500)),
    );
  }

  /** Puts what was decompressed at its place: how many bytes, or -1 for what is damaged. */
  #opened(at: number, open: () => Uint8Array): number {
    try {
      const plain = open();
      this.#bytes().set(plain, at);
      return plain.length;
    } catch {
      return -1;
    }
  }

  #give(data: Uint8Array): void {
    const at = this.#exports.lidarcodec_input(this.#stream, data.length);
    this.#bytes().set(data, at);
  }

  /** A CALIBRATION section that an earlier message of the stream brought. */
  giveCalibration(section: Uint8Array): void {
    this.#give(section);
    this.#exports.lidarcodec_give_calibration(this.#stream);
  }

  /** Name of weights that a message needs and that are not here yet; "" if there are none. */
  missingWeights(message: Uint8Array): string {
    this.#give(message);
    return this.#text(this.#exports.lidarcodec_missing_weights(this.#stream));
  }

  /** The file of the weights that were missing. */
  giveWeights(file: Uint8Array): void {
    this.#give(file);
    this.#exports.lidarcodec_give_weights(this.#stream);
  }

  /** The picture in the message that is pushed next. samples: rows x columns */
  givePicture(samples: Uint16Array): void {
    this.#give(new Uint8Array(samples.buffer, samples.byteOffset, samples.byteLength));
    this.#exports.lidarcodec_give_picture(this.#stream);
  }

  /** Decodes a message. */
  push(message: Uint8Array): void {
    this.#give(message);
    this.#exports.lidarcodec_push(this.#stream);
  }

  /** The planes of a PLANES section, copies. */
  planes(section: Uint8Array, columns: number): CloudPlanes {
    this.#give(section);
    const { memory, ...of } = this.#exports;
    of.lidarcodec_read_planes(this.#stream, columns);
    const rows = of.lidarcodec_plane_rows(this.#stream);
    const planes = Array.from({ length: of.lidarcodec_plane_count(this.#stream) }, (_, number) => {
      const at = of.lidarcodec_plane_values(this.#stream, number);
      const name = this.#text(of.lidarcodec_plane_name(this.#stream, number));
      return { name, values: new Uint32Array(memory.buffer, at, rows * columns).slice() };
    });
    return { rows, planes };
  }

  /** The frame that was pushed. */
  get frame(): NativeFrame {
    const { memory, ...of } = this.#exports;
    const [rows, width] = [of.lidarcodec_rows(this.#stream), of.lidarcodec_width(this.#stream)];
    const intensity = of.lidarcodec_intensity(this.#stream);
    return {
      rows,
      width,
      range: new Uint16Array(memory.buffer, of.lidarcodec_range(this.#stream), rows * width),
      azimuth: new Uint16Array(memory.buffer, of.lidarcodec_azimuth(this.#stream), 2 * width),
      intensity: intensity === 0 ? null : new Uint8Array(memory.buffer, intensity, rows * width),
    };
  }

  /** Hash of the sensor of the frame that was pushed. */
  get sensorHash(): string {
    return this.#text(this.#exports.lidarcodec_sensor_hash(this.#stream));
  }

  get #laser(): Uint8Array {
    const { memory, ...of } = this.#exports;
    const rows = of.lidarcodec_rows(this.#stream);
    return new Uint8Array(memory.buffer, of.lidarcodec_laser(this.#stream), rows).slice();
  }

  /** A copy of that sensor, if it is another than an HDL-64E; else null. */
  get rings(): Rings | null {
    const of = this.#exports;
    const at = of.lidarcodec_rings(this.#stream);
    if (at === 0) return null;
    const laser = this.#laser;
    return {
      name: this.#text(of.lidarcodec_sensor_name(this.#stream)),
      model: this.#text(of.lidarcodec_sensor_model(this.#stream)),
      hash: this.sensorHash,
      rangeStep: of.lidarcodec_range_step(this.#stream) / 10_000_000,
      laser,
      values: new Float64Array(of.memory.buffer, at, laser.length * RING).slice(),
    };
  }

  /** A copy of that sensor, if it is an HDL-64E. */
  get sensor(): Sensor {
    const { memory, ...of } = this.#exports;
    const laser = this.#laser;
    return {
      name: this.#text(of.lidarcodec_sensor_name(this.#stream)),
      hash: this.sensorHash,
      convention: of.lidarcodec_convention(this.#stream) === 0 ? "ros" : "veloview",
      rangeStep: of.lidarcodec_range_step(this.#stream) / 10_000_000,
      table: new Int32Array(memory.buffer, of.lidarcodec_table(this.#stream), TABLE).slice(),
      laser,
      half: laser.map((id) => (id < LOWER_LASERS ? 0 : 1)),
    };
  }
}
