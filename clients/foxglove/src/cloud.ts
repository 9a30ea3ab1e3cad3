/** Frames as Foxglove's messages. A point has 14 bytes: x y z float32 in metres (x forward, y left, z up), intensity and ring
 * uint8, ring 0 the highest beam. One of a driver's point cloud has x y z float32, and the other fields of its message. */

import { type FrameTransform, NumericType, type PackedElementField, type PointCloud, type Time } from "@foxglove/schemas";
import { pointOf } from "../../web/src/view/measure/point.js";
import { damaged } from "../../typescript/src/errors.js";
import { bytesOf, FieldType, MOST_BYTES } from "../../typescript/src/clouds/message.js";
import { cloudPointsOf } from "../../typescript/src/clouds/points.js";
import type { Vector } from "../../web/src/view/matrix.js";
import type { Decoded, DecodedFrame } from "./stream.js";

const STRIDE = 14;
const FIELDS: PackedElementField[] = [
  { name: "x", offset: 0, type: NumericType.FLOAT32 },
  { name: "y", offset: 4, type: NumericType.FLOAT32 },
  { name: "z", offset: 8, type: NumericType.FLOAT32 },
  { name: "intensity", offset: 12, type: NumericType.UINT8 },
  { name: "ring", offset: 13, type: NumericType.UINT8 },
];
const IDENTITY = { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };

/** The points of all returns, column by column; of a point cloud in the order of its message. */
export function pointCloud(decoded: Decoded, timestamp: Time, frame_id: string): PointCloud {
  const points = "payload" in decoded ? pointsOfCloud(decoded.payload) : pointsOfFrame(decoded);
  return { timestamp, frame_id, pose: IDENTITY, ...points };
}

type Packed = Pick<PointCloud, "point_stride" | "fields" | "data">;

/** Types of fields by the numbers of sensor_msgs/PointField. */
const NUMERIC: Readonly<Record<number, NumericType>> = {
  [FieldType.int8]: NumericType.INT8,
  [FieldType.uint8]: NumericType.UINT8,
  [FieldType.int16]: NumericType.INT16,
  [FieldType.uint16]: NumericType.UINT16,
  [FieldType.int32]: NumericType.INT32,
  [FieldType.uint32]: NumericType.UINT32,
  [FieldType.float32]: NumericType.FLOAT32,
  [FieldType.float64]: NumericType.FLOAT64,
};

/** Points with a return, and all their fields of one value. */
function pointsOfCloud(payload: Uint8Array): Packed {
  const { count, xyz, names, type, values } = cloudPointsOf(payload);
  const fields = FIELDS.slice(0, 3);
  let stride = 12;
  for (const name of names.filter((one) => !["x", "y", "z"].includes(one))) {
    fields.push({ name, offset: stride, type: NUMERIC[type(name)]! });
    stride += bytesOf(type(name));
  }
  if (stride * count > MOST_BYTES) throw damaged("a point cloud whose fields lie over each other");
  const data = new Uint8Array(stride * count);
  const view = new DataView(data.buffer);
  for (let i = 0; i < count; i++)
    for (let axis = 0; axis < 3; axis++) view.setFloat32(i * stride + 4 * axis, xyz[3 * i + axis]!, true);
  for (const { name, offset } of fields.slice(3)) {
    const column = values(name);
    const [bytes, width] = [new Uint8Array(column.buffer, column.byteOffset, column.byteLength), column.BYTES_PER_ELEMENT];
    for (let i = 0; i < count; i++)
      for (let byte = 0; byte < width; byte++) data[i * stride + offset + byte] = bytes[i * width + byte]!;
  }
  return { point_stride: stride, fields, data };
}

function pointsOfFrame({ frame, table }: DecodedFrame): Packed {
  const data = new Uint8Array(STRIDE * (frame?.returns ?? 0));
  const view = new DataView(data.buffer);
  const point: Vector = [0, 0, 0];
  let at = 0;
  for (let column = 0; column < (frame?.columns ?? 0); column++)
    for (let ring = 0; ring < (frame?.rings ?? 0); ring++) {
      const cell = ring * frame!.columns + column;
      if (frame!.range[cell] === 0) continue;
      pointOf(frame!, table, ring, column, point);
      for (let axis = 0; axis < 3; axis++) view.setFloat32(at + 4 * axis, point[axis]!, true);
      data[at + 12] = frame!.intensity?.[cell] ?? 0;
      data[at + 13] = ring;
      at += STRIDE;
    }
  return { point_stride: STRIDE, fields: FIELDS, data };
}

/** rows: the first three rows of T_parent_child, row after row. */
export function frameTransform(rows: Float64Array, timestamp: Time, parent: string, child: string): FrameTransform {
  return {
    timestamp,
    parent_frame_id: parent,
    child_frame_id: child,
    translation: { x: rows[3]!, y: rows[7]!, z: rows[11]! },
    rotation: quaternionOf(rows),
  };
}

/** Of a rotation (Shepperd 1978): the largest of the four parts is computed first, the others are divided by it. */
export function quaternionOf(rows: Float64Array): { x: number; y: number; z: number; w: number } {
  const m = (i: number, j: number): number => rows[4 * i + j]!;
  const [xx, yy, zz] = [m(0, 0), m(1, 1), m(2, 2)];
  const squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz];
  const [xy, xz, yz] = [m(0, 1) + m(1, 0), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1)];
  const [wx, wy, wz] = [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1)];
  const products = [
    [squares[0]!, xy, xz, wx],
    [xy, squares[1]!, yz, wy],
    [xz, yz, squares[2]!, wz],
    [wx, wy, wz, squares[3]!],
  ];
  const row = products[squares.indexOf(Math.max(...squares))]!;
  const length = Math.hypot(...row) * (row[3]! < 0 ? -1 : 1);
  const [x, y, z, w] = row.map((part) => part / length);
  return { x: x!, y: y!, z: z!, w: w! };
}
