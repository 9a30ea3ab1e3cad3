/** The POSE and MOUNT sections (docs/wire-format.md): where the sensor was, and where it sits on its vehicle. */

import { damaged } from "./errors.js";
import { type Message, Section } from "./message.js";

/** Rows of (R | t) in row order, 12 numbers; null if the message has no pose. Throws DecodeError. */
export function readPose(message: Message): Float64Array | null {
  const data = message.section(Section.POSE);
  if (data === null) return null;
  if (data.length !== 96) throw damaged(`a pose of ${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, 96);
  const pose = Float64Array.from({ length: 12 }, (_, i) => view.getFloat64(8 * i, true));
  if (!isRigid(pose)) throw damaged("a pose that is no rigid transform");
  return pose;
}

const FARTHEST_MOUNT_M = 100;

/** Rows of T_vehicle_sensor, 12 numbers; null if the message does not say it. Throws DecodeError. */
export function readMount(message: Message): Float64Array | null {
  const data = message.section(Section.MOUNT);
  if (data === null) return null;
  if (data.length !== 96) throw damaged(`a mounting of ${data.length} bytes`);
  const view = new DataView(data.buffer, data.byteOffset, 96);
  const mount = Float64Array.from({ length: 12 }, (_, i) => view.getFloat64(8 * i, true));
  if (!isRigid(mount, 1e-6) || [3, 7, 11].some((i) => Math.abs(mount[i]!) > FARTHEST_MOUNT_M))
    throw damaged("a mounting that is no rigid transform of at most 100 m");
  return mount;
}

/** The mounting that the last key message of a stream said. */
export class MountMemory {
  #mount: Float64Array | null = null;

  /** The first three rows of T_vehicle_sensor for the frames of a message; null if it is not known. Throws DecodeError. */
  of(message: Message): Float64Array | null {
    const said = readMount(message);
    if (said !== null || message.key) this.#mount = said;
    return this.#mount;
  }
}

/** Whether 12 numbers, rows of (R | t), are a rotation, up to rounding, and a shift of less than 10^9 m. */
function isRigid(p: Float64Array, rounding = 0.1): boolean {
  const row = (i: number): number[] => [p[4 * i]!, p[4 * i + 1]!, p[4 * i + 2]!];
  const dot = (a: number[], b: number[]): number => a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
  const [x, y, z] = [row(0), row(1), row(2)];
  const across = [x[1]! * y[2]! - x[2]! * y[1]!, x[2]! * y[0]! - x[0]! * y[2]!, x[0]! * y[1]! - x[1]! * y[0]!];
  const near = (value: number, wanted: number): boolean => Math.abs(value - wanted) < rounding;
  return (
    [x, y, z].every((one) => near(dot(one, one), 1)) &&
    near(dot(x, y), 0) && near(dot(y, z), 0) && near(dot(z, x), 0) &&
    dot(across, z) > 0 &&
    [3, 7, 11].every((i) => Math.abs(p[i]!) < 1e9)
  );
}
