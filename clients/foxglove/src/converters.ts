/** What the extension gives for a message: its points, its pose, and why there are no points. */

import { type FrameTransform, type Log, LogLevel, type PointCloud, type Time } from "@foxglove/schemas";
import { DecodeError } from "../../typescript/src/errors.js";
import { type Message, readMessage } from "../../typescript/src/message.js";
import { readPose } from "../../typescript/src/pose.js";
import { frameTransform, pointCloud } from "./cloud.js";
import { checkCodec, CodedStream, type Core, keepLast } from "./stream.js";

export const FORMAT = "lidarcodec";
/** The frame of poses in ROS (REP 105), as in bags and bridges of lidarcodec. */
export const WORLD = "map";

/** point_cloud_interfaces/CompressedPointCloud2, as far as it is read here. */
export interface CompressedCloud {
  readonly header: { readonly stamp: Time; readonly frame_id: string };
  readonly compressed_data: Uint8Array;
  readonly format: string;
}

/** Type of the section that says where the sensor sits on its vehicle (docs/wire-format.md). */
const MOUNT = 17;
/** Streams of which that is kept. */
const MOST_NAMES = 256;
/** Streams whose decoders are kept; each takes some 20 MB. */
const MOST_STREAMS = 16;

/** core: null until it is loaded, or an error if that failed */
export class Converters {
  #core: Core | Error | null = null;
  readonly #streams = new Map<string, CodedStream>();
  readonly #alone = new Map<string, boolean>();

  ready(core: Core | Error): void {
    this.#core = core;
  }

  /** The points of a message on a topic; undefined if it has another format, or cannot be decoded. */
  cloud(coded: CompressedCloud, topic: string): PointCloud | undefined {
    if (coded.format !== FORMAT || !this.#core || this.#core instanceof Error) return undefined;
    try {
      const message = readMessage(coded.compressed_data);
      const decoded = this.#stream(topic, this.#core).decode(message, coded.compressed_data);
      return pointCloud(decoded, coded.header.stamp, coded.header.frame_id);
    } catch (error) {
      if (error instanceof DecodeError) return undefined; // `log` says why
      throw error;
    }
  }

  /** The pose that a message carries, if any; nothing is decoded for it. None where the stream says how the sensor is mounted on
   * its vehicle: the topics /tf and /tf_static have the vehicle between, and a frame has one parent only. */
  transform(coded: CompressedCloud): FrameTransform | undefined {
    if (coded.format !== FORMAT) return undefined;
    try {
      const message = readMessage(coded.compressed_data);
      const [rows, alone] = [readPose(message), this.#aloneOnItsVehicle(message, coded.compressed_data)];
      return rows && alone ? frameTransform(rows, coded.header.stamp, WORLD, coded.header.frame_id) : undefined;
    } catch (error) {
      if (error instanceof DecodeError) return undefined;
      throw error;
    }
  }

  /** Why a message has no points; undefined where it has, or nobody asked for them yet. It decodes nothing itself: panels that
   * load a whole file would move the decoder away from the moment that is shown. */
  log(coded: CompressedCloud, topic: string): Log | undefined {
    const why = coded.format === FORMAT ? this.#why(coded.compressed_data, topic) : null;
    if (!why) return undefined;
    const { timestamp, name, file, line } = { timestamp: coded.header.stamp, name: topic, file: "", line: 0 };
    return { timestamp, level: why.level, message: why.text, name, file, line };
  }

  /** Whether the last key message of a stream, which has to be known, says no mounting. */
  #aloneOnItsVehicle({ key, streamId }: Message, data: Uint8Array): boolean {
    if (key) keepLast(this.#alone, `${streamId}`, !hasSection(data, MOUNT), MOST_NAMES);
    return this.#alone.get(`${streamId}`) ?? false;
  }

  #why(data: Uint8Array, topic: string): { level: LogLevel; text: string } | null {
    if (this.#core instanceof Error)
      return { level: LogLevel.FATAL, text: `the decoder could not be loaded: ${this.#core.message}` };
    if (this.#core === null) return { level: LogLevel.WARNING, text: "the decoder is being loaded" };
    try {
      const message = readMessage(data);
      checkCodec(message);
      const problem = this.#streams.get(topic)?.problemOf(message, data);
      return problem ? told(problem, message) : null;
    } catch (error) {
      if (error instanceof DecodeError) return { level: LogLevel.ERROR, text: error.message };
      throw error;
    }
  }

  #stream(topic: string, core: Core): CodedStream {
    const stream = this.#streams.get(topic) ?? new CodedStream(core);
    keepLast(this.#streams, topic, stream, MOST_STREAMS);
    return stream;
  }
}

/** Whether a message, which was read without an error, has a section of a type that the decoder in TypeScript does not know. */
function hasSection(data: Uint8Array, type: number): boolean {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  let at = view.getUint16(6, true);
  for (let left = view.getUint16(54, true); left > 0; left--) {
    if (data[at] === type) return true;
    at += 6 + view.getUint32(at + 2, true);
  }
  return false;
}

function told(problem: DecodeError, { index }: Message): { level: LogLevel; text: string } {
  if (problem.code !== "reference") return { level: LogLevel.ERROR, text: problem.message };
  return {
    level: LogLevel.WARNING,
    text: `frame ${index} builds on one that was not decoded, as after a jump in time: points come with the next key message`,
  };
}
