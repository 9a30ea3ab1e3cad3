/** Header and sections of a message: the part of docs/wire-format.md named "Message". */

import { crc32c } from "./crc32c.js";
import { DecodeError, damaged } from "./errors.js";

export const LARGEST_MESSAGE = 67_108_864;
export const LARGEST_WIDTH = 24_576;
const HEADER_BYTES = 56;
const CHECKSUM_BYTES = 4;
const PLANES_FLAG = 0x100;
const MAGIC = [0x93, 0x4c, 0x44, 0x43];

export const Section = {
  RANGE: 1,
  MASK: 2,
  INTENSITY: 3,
  AZIMUTH: 4,
  SIDE: 5,
  CALIBRATION: 6,
  KEEP: 7,
  MOTION: 8,
  WEIGHTS: 9,
  POSE: 10,
  FILLER: 11,
  LATTICE: 12,
  POSITION: 13,
  PLANES: 14,
  REST: 15,
  CLOUD: 16,
  MOUNT: 17,
} as const;
const KNOWN_SECTIONS: ReadonlySet<number> = new Set(Object.values(Section));

/** Numbers of codecs by name. */
export const Codec = { raw: 1, zstd: 2, pcodec: 3, png: 4, jxl: 5, jpeg: 6, riddle: 10, predictive: 11 } as const;

export interface Message {
  readonly minor: number;
  readonly codec: number;
  readonly key: boolean;
  /** Whether it is of another sensor than an HDL-64E, in PLANES and REST sections. */
  readonly planes: boolean;
  readonly streamId: bigint;
  /** Host time of the first packet, ns since 1970 UTC. */
  readonly stampNs: bigint;
  readonly index: bigint;
  /** The frame that this message refers to. */
  readonly needs: bigint | null;
  readonly frames: number;
  readonly width: number;
  readonly packets: number;
  /** Sections of known type and ordinal; views of the given bytes. */
  section(type: number, ordinal?: number): Uint8Array | null;
}

function within(value: number, low: number, high: number, what: string): void {
  if (value < low || value > high) throw new DecodeError("header", `${what} is ${value}, allowed is ${low} to ${high}`);
}

/** Reads a message from exactly its bytes, with checks in the order of docs/wire-format.md. */
export function readMessage(given: Uint8Array): Message {
  const data = new Uint8Array(given.buffer, given.byteOffset, given.byteLength); // Node's Buffer slices otherwise
  if (MAGIC.some((byte, at) => at < data.length && data[at] !== byte))
    throw new DecodeError("header", "this is not a message: its first bytes are wrong");
  if (data.length < 5) throw new DecodeError("truncated", "a message ends within its version");
  if (data[4] !== 1) throw new DecodeError("version", `format version ${data[4]}: this decoder reads version 1`);
  const least = HEADER_BYTES + CHECKSUM_BYTES;
  if (data.length < least) throw new DecodeError("truncated", `a message of ${data.length} bytes, fewer than ${least}`);
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const total = view.getUint32(8, true);
  within(total, least, LARGEST_MESSAGE, "the size of the message");
  if (data.length < total) throw new DecodeError("truncated", `${data.length} bytes of a message of ${total}`);
  if (data.length > total) throw new DecodeError("header", `${data.length} bytes for a message of ${total}`);
  const end = total - CHECKSUM_BYTES;
  if (view.getUint32(end, true) !== crc32c(data.subarray(0, end)))
    throw new DecodeError("checksum", "the checksum of the message does not match");

  const headerBytes = view.getUint16(6, true);
  const flags = view.getUint16(14, true);
  const key = (flags & 1) !== 0;
  const index = view.getBigUint64(32, true);
  const needs = view.getBigUint64(40, true);
  if (flags & 0xff00 & ~PLANES_FLAG) throw new DecodeError("version", `flags 0x${flags.toString(16)}: not all of them are known`);
  within(headerBytes, HEADER_BYTES, end, "the size of the header");
  const limits: [string, number, number, number][] = [
    ["frames", view.getUint16(48, true), 1, 64],
    ["width", view.getUint16(50, true), 0, LARGEST_WIDTH],
    ["packets", view.getUint16(52, true), 0, 2048],
    ["sections", view.getUint16(54, true), 0, 256],
  ];
  for (const [what, value, low, high] of limits) within(value, low, high, what);
  if (index >= 1n << 63n) throw new DecodeError("header", "the frame index is beyond 2^63");
  if (!(flags & 2) && needs !== 0n) throw new DecodeError("header", "the header names a needed frame without the flag");
  if (flags & 2 && (key || needs >= index)) throw new DecodeError("header", "the needed frame is not an earlier frame");

  const [frames, width, packets, count] = limits.map(([, value]) => value);
  const sections = readSections(data.subarray(headerBytes, end), view, headerBytes, count, frames);
  return {
    minor: data[5],
    codec: view.getUint16(12, true),
    key,
    planes: (flags & PLANES_FLAG) !== 0,
    streamId: view.getBigUint64(16, true),
    stampNs: view.getBigInt64(24, true),
    index,
    needs: flags & 2 ? needs : null,
    frames,
    width,
    packets,
    section: (type, ordinal = 0) => sections.get(type * 256 + ordinal) ?? null,
  };
}

function readSections(body: Uint8Array, view: DataView, from: number, count: number, frames: number): Map<number, Uint8Array> {
  const found = new Map<number, Uint8Array>();
  let at = 0;
  for (let number = 0; number < count; number++) {
    if (body.length - at < 6) throw new DecodeError("truncated", `section ${number} begins beyond the end`);
    const [type, ordinal] = [body[at], body[at + 1]];
    const length = view.getUint32(from + at + 2, true);
    at += 6;
    if (length > body.length - at)
      throw new DecodeError("truncated", `section ${number} announces ${length} bytes, ${body.length - at} are left`);
    if (KNOWN_SECTIONS.has(type)) {
      if (ordinal >= frames && type !== Section.MOUNT) throw damaged(`a section of frame ${ordinal} of ${frames}`);
      const twice = found.has(type * 256 + ordinal);
      if (twice && type !== Section.WEIGHTS) throw damaged(`two sections of type ${type}`);
      if (!twice) found.set(type * 256 + ordinal, body.subarray(at, at + length));
    }
    at += length;
  }
  if (at !== body.length) throw damaged(`${body.length - at} bytes after the last section`);
  return found;
}

/** A required section. */
export function needed(message: Message, type: number, name: string): Uint8Array {
  const data = message.section(type);
  if (data === null) throw damaged(`a message without ${name}`);
  return data;
}
