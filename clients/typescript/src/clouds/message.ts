/** A `sensor_msgs/PointCloud2` message taken apart: the head before its points, and the values of their fields. */

import { DecodeError, damaged } from "../errors.js";

export const MOST_BYTES = 33_554_432;
export const MOST_POINTS = 1_048_576;
const MOST_FIELDS = 64;
const MOST_TEXT = 4096;
/** Bytes of each type, as sensor_msgs/PointField numbers them from 1 on. */
const BYTES = [0, 1, 1, 2, 2, 4, 4, 4, 8] as const;

export const FieldType = { int8: 1, uint8: 2, int16: 3, uint16: 4, int32: 5, uint32: 6, float32: 7, float64: 8 } as const;

export interface CloudField {
  readonly name: string;
  /** First byte in a point. */
  readonly offset: number;
  /** A FieldType. */
  readonly type: number;
  /** Values of each point. */
  readonly count: number;
}

/** What stands before the points. */
export interface CloudHead {
  /** Bytes of the head. */
  readonly size: number;
  readonly height: number;
  readonly width: number;
  readonly fields: readonly CloudField[];
  /** Byte order of the points. */
  readonly bigEndian: boolean;
  readonly pointStep: number;
  readonly rowStep: number;
  /** Bytes of all rows of points. */
  readonly dataBytes: number;
}

export type Values = Int8Array | Uint8Array | Int16Array | Uint16Array | Int32Array | Uint32Array | Float32Array | Float64Array;

export function bytesOf(type: number): number {
  return BYTES[type]!;
}

/** The first field of this name that has one value a point. */
export function namedField(head: CloudHead, name: string): CloudField | undefined {
  return head.fields.find((field) => field.name === name && field.count === 1);
}

/** The head of a payload; the points need not be there. */
export function readHead(payload: Uint8Array): CloudHead {
  const form = payload.length < 4 ? -1 : new DataView(payload.buffer, payload.byteOffset).getUint32(0);
  const ros1 = form === 0x726f7331;
  if (!ros1 && form !== 0 && form !== 0x00010000) throw damaged("a message that does not begin as a PointCloud2");
  const view = new DataView(payload.buffer, payload.byteOffset, payload.byteLength);
  let at = 4;
  const take = (size: number): number => {
    at += size;
    if (at > payload.length) throw new DecodeError("truncated", "a PointCloud2 message ends too early");
    return at - size;
  };
  const u8 = (): number => payload[take(1)]!;
  const u32 = (): number => {
    if (!ros1) at += (4 - (at % 4)) % 4;
    return view.getUint32(take(4), form !== 0);
  };
  const text = (): string => {
    const size = u32();
    if (size > MOST_TEXT) throw damaged(`a text of ${size} bytes in a PointCloud2`);
    const from = take(size);
    let end = at;
    while (end > from && payload[end - 1] === 0) end--;
    return new TextDecoder("utf-8", { ignoreBOM: true }).decode(payload.subarray(from, end));
  };
  for (let left = ros1 ? 3 : 2; left > 0; left--) u32(); // sequence number of ROS 1, and stamp
  text();
  const [height, width, count] = [u32(), u32(), u32()];
  if (count > MOST_FIELDS) throw damaged(`a PointCloud2 of ${count} fields`);
  const fields = Array.from({ length: count }, (): CloudField => {
    const [name, offset, type, repeated] = [text(), u32(), u8(), u32()];
    if (type < 1 || type > 8) throw damaged(`a field of a PointCloud2 of type ${type}`);
    return { name, offset, type, count: repeated };
  });
  const [bigEndian, pointStep, rowStep, dataBytes] = [u8() !== 0, u32(), u32(), u32()];
  if (dataBytes > MOST_BYTES || height * width > MOST_BYTES) throw damaged(`a PointCloud2 of ${dataBytes} bytes`);
  return { size: at, height, width, fields, bigEndian, pointStep, rowStep, dataBytes };
}

/** Whether the points lie where step and row step say, and each field within its point. */
export function isRegular({ height, width, fields, pointStep, rowStep, dataBytes }: CloudHead): boolean {
  const inside = fields.every(({ offset, type, count }) => offset + bytesOf(type) * count <= pointStep);
  const step = height > 1 ? rowStep : width * pointStep;
  return inside && pointStep > 0 && width * pointStep <= step && dataBytes === step * height;
}

/** A PointCloud2 whose points lie as its head says. */
export class CloudMessage {
  readonly head: CloudHead;
  readonly #payload: Uint8Array;

  private constructor(payload: Uint8Array, head: CloudHead) {
    this.head = head;
    this.#payload = payload;
  }

  /** null for any other payload. */
  static of(payload: Uint8Array): CloudMessage | null {
    try {
      const head = readHead(payload);
      return isRegular(head) && head.size + head.dataBytes <= payload.length ? new CloudMessage(payload, head) : null;
    } catch (error) {
      if (error instanceof DecodeError) return null;
      throw error;
    }
  }

  get points(): number {
    return this.head.height * this.head.width;
  }

  /** The values of a field, `count` for each point. */
  values({ offset, type, count }: CloudField): Values {
    const { size, height, width, bigEndian, pointStep, rowStep } = this.head;
    const payload = this.#payload;
    const found = arrayOf(type, this.points * count);
    const to = new Uint8Array(found.buffer);
    const bytes = bytesOf(type);
    const flip = bigEndian === LITTLE_ENDIAN ? bytes - 1 : 0; // reverses the bytes of a value
    let next = 0;
    for (let row = 0; row < height; row++)
      for (let point = 0; point < width; point++) {
        const at = size + row * (height > 1 ? rowStep : 0) + point * pointStep + offset;
        for (let i = 0; i < count * bytes; i++) to[next++] = payload[at + (i ^ flip)]!;
      }
    return found;
  }
}

/** Byte order of this machine. */
const LITTLE_ENDIAN = new Uint8Array(new Uint16Array([1]).buffer)[0] === 1;

function arrayOf(type: number, size: number): Values {
  switch (type) {
    case FieldType.int8:
      return new Int8Array(size);
    case FieldType.uint8:
      return new Uint8Array(size);
    case FieldType.int16:
      return new Int16Array(size);
    case FieldType.uint16:
      return new Uint16Array(size);
    case FieldType.int32:
      return new Int32Array(size);
    case FieldType.uint32:
      return new Uint32Array(size);
    case FieldType.float32:
      return new Float32Array(size);
    default:
      return new Float64Array(size);
  }
}
