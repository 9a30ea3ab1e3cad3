/** The points of a cloud that came as a message. */

import { CloudMessage, FieldType, MOST_POINTS, namedField, type Values } from "./message.js";

const FARTHEST_M = 1e6;

export interface CloudPoints {
  readonly count: number;
  /** x, y, z of each point, one after the other, metres. */
  readonly xyz: Float32Array;
  /** Place of each point among those of the message. */
  readonly place: Uint32Array;
  /** Names of the fields of one value, x, y and z too, each once. */
  readonly names: readonly string[];
  /** The FieldType of such a field. Throws RangeError for another name. */
  type(name: string): number;
  /** The values of such a field as the message has them, of each point. Throws RangeError for another name. */
  values(name: string): Values;
}

/** Number of points with a return. */
export function cloudReturns(payload: Uint8Array): number {
  return returned(CloudMessage.of(payload))?.place.length ?? 0;
}

/** Points with a return, in the order of the message: x, y and z are finite, not all 0, and within 1,000 km. None of a payload
 * that is no PointCloud2, has no x, y and z, or more than 1,048,576 points. */
export function cloudPointsOf(payload: Uint8Array): CloudPoints {
  const message = CloudMessage.of(payload);
  const found = returned(message);
  if (!message || !found) return { count: 0, xyz: new Float32Array(), place: new Uint32Array(), names: [], type: noField, values: noField };
  const { place, axes } = found;
  const xyz = new Float32Array(3 * place.length);
  axes.forEach((values, axis) => {
    for (let i = 0; i < place.length; i++) xyz[3 * i + axis] = values[place[i]!]!;
  });
  const { head } = message;
  const names = [...new Set(head.fields.filter(({ count }) => count === 1).map(({ name }) => name))];
  const type = (name: string): number => namedField(head, name)?.type ?? noField(name);
  const values = (name: string): Values => {
    const all = message.values(namedField(head, name) ?? noField(name));
    const chosen = all.slice(0, place.length);
    for (let i = 0; i < place.length; i++) chosen[i] = all[place[i]!]!;
    return chosen;
  };
  return { count: place.length, xyz, place, names, type, values };
}

function noField(name: string): never {
  throw new RangeError(`these points have no field ${name}`);
}

/** The places of points with a return, and x, y and z of all points; null where they are not known. */
export function returned(message: CloudMessage | null): { place: Uint32Array; axes: [Values, Values, Values] } | null {
  if (!message || message.points > MOST_POINTS) return null;
  const fields = ["x", "y", "z"].map((name) => namedField(message.head, name));
  if (!fields.every((field) => field && field.type >= FieldType.float32)) return null;
  const axes = fields.map((field) => message.values(field!)) as [Values, Values, Values];
  const [x, y, z] = axes;
  const near = (value: number) => Math.abs(value) < FARTHEST_M; // not of what is no number
  const place = new Uint32Array(x.length);
  let count = 0;
  for (let i = 0; i < x.length; i++)
    if (near(x[i]!) && near(y[i]!) && near(z[i]!) && (x[i] !== 0 || y[i] !== 0 || z[i] !== 0)) place[count++] = i;
  return { place: place.slice(0, count), axes };
}
