/** Where a stream is drawn in the frame of another one: by poses, else by mountings. */
import { between, identity, type Matrix, multiply, type Pose } from "../matrix";

/** T_vehicle_sensor as the server tells it: metres, and degrees of roll, then pitch, then yaw. */
export interface Mount {
  x_m: number;
  y_m: number;
  z_m: number;
  roll_deg: number;
  pitch_deg: number;
  yaw_deg: number;
}

/** Most streams in one picture, the chosen one included: a server lends seats to each. */
export const MOST_STREAMS = 6;

/** A sensor on its vehicle, and the pose of the sensor (T_world_sensor); null where they are not known. */
export interface Seat {
  vehicle: string;
  mount: Mount | null;
  pose: Pose | null;
}

/** The chosen stream. `pose` is where its sensor is now, `seen` where it was at its newest frame: its cloud is drawn moved
 * from there to here. */
export interface MainSeat extends Seat {
  seen: Pose | null;
}

/** How it was placed. `origin`: its mounting is not known, so it is drawn at the vehicle's origin. `guess`: it is another
 * vehicle, and one of both has no pose. */
export type Placed = "pose" | "mount" | "origin" | "guess";

const NONE: Pose = new Float64Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]);

/** The first three rows of T_vehicle_sensor: Rz(yaw) Ry(pitch) Rx(roll), as lidarcodec/mounting has it. */
export function poseOfMount(mount: Mount | null): Pose {
  if (!mount) return NONE;
  const turn = (degrees: number) => [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180)] as const;
  const [[sr, cr], [sp, cp], [sy, cy]] = [turn(mount.roll_deg), turn(mount.pitch_deg), turn(mount.yaw_deg)];
  return new Float64Array([
    ...[cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, mount.x_m],
    ...[sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, mount.y_m],
    ...[-sp, cp * sr, cp * cr, mount.z_m],
  ]);
}

const moved = identity();
const mounted = identity();

/** out: from the frame of `other` to the frame of `main`. By mountings it moves as the cloud of `main` does. */
export function place(out: Matrix, main: MainSeat, other: Seat): Placed {
  if (main.pose && other.pose) {
    between(out, main.pose, other.pose);
    return "pose";
  }
  between(mounted, poseOfMount(main.mount), poseOfMount(other.mount));
  if (main.pose && main.seen) multiply(out, between(moved, main.pose, main.seen), mounted);
  else out.set(mounted);
  if (main.vehicle !== other.vehicle) return "guess";
  return other.mount ? "mount" : "origin";
}

/** Where the frames of another stream lie. By poses each lies where it was, also each of the slabs that make a turn. */
export class Placing {
  placed: Placed = "origin";
  readonly #newest = identity();
  readonly #one = identity();
  #main: Pose | null = null;

  /** Place it for the picture that is drawn now. other: with the pose of its newest frame */
  settle(main: MainSeat, other: Seat): void {
    this.#main = main.pose;
    this.placed = place(this.#newest, main, other);
  }

  /** From the frame of a pose of its sensor to that of the picture. Overwritten at the next call. */
  of(pose: Pose | null): Matrix {
    if (this.placed !== "pose" || !this.#main || !pose) return this.#newest;
    return between(this.#one, this.#main, pose);
  }
}

/** What the legend says of a stream beside its name; empty if it lies where it should. */
export function noteOf(placed: Placed, mainVehicle: string): string {
  if (placed === "origin") return "no mounting: drawn at the vehicle's origin";
  return placed === "guess" ? `no pose: drawn as if it were on ${mainVehicle}` : "";
}
