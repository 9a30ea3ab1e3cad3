/** Where the picture is taken from: around a point, with smooth movement towards where it was sent. */
import { lookAt, type Matrix, perspective, type Vector } from "../matrix";
import type { Camera as Kind } from "../types";

export interface Stand {
  /** Radians about z, counter-clockwise from straight ahead: where the camera stands, seen from the target. */
  yaw: number;
  /** Radians above the horizon. */
  pitch: number;
  distance: number;
  x: number;
  y: number;
  z: number;
}

const STANDS: Record<Kind, Stand> = {
  orbit: { yaw: Math.PI + 0.62, pitch: 0.62, distance: 52, x: 4, y: 0, z: 0 },
  follow: { yaw: Math.PI, pitch: 0.3, distance: 17, x: 7, y: 0, z: 0 },
};
const PITCH: readonly [number, number] = [-0.1, 1.55];
const DISTANCE: readonly [number, number] = [2, 400];
const REACH = 300;
const FOV = 0.9;
export const NEAR = 0.5;
export const FAR = 900;
/** Time in which two thirds of a movement are done. */
const SMOOTH_S = 0.07;

const clamp = (value: number, [least, most]: readonly [number, number]) => Math.min(Math.max(value, least), most);

export class Camera {
  kind: Kind = "orbit";
  readonly #now: Stand = { ...STANDS.orbit };
  readonly #goal: Stand = { ...STANDS.orbit };
  readonly #eye: Vector = [0, 0, 0];
  readonly #target: Vector = [0, 0, 0];
  /** How far the vehicle has turned since the camera was put up: an orbiting camera does not turn with it. */
  heading = 0;

  /** Stand where this kind of camera begins. */
  reset(kind: Kind, at_once = false): void {
    this.kind = kind;
    this.send(STANDS[kind]);
    if (at_once) Object.assign(this.#now, this.#goal);
  }

  /** Stand there: where the camera was sent before, or what somebody kept. */
  send({ yaw, pitch, distance, x, y, z }: Readonly<Stand>): void {
    const reach = [-REACH, REACH] as const;
    const goal = this.#goal;
    goal.yaw = yaw;
    goal.pitch = clamp(pitch, PITCH);
    goal.distance = clamp(distance, DISTANCE);
    [goal.x, goal.y, goal.z] = [clamp(x, reach), clamp(y, reach), clamp(z, reach)];
    this.#now.yaw += 2 * Math.PI * Math.round((yaw - this.#now.yaw) / (2 * Math.PI)); // the shorter way round
  }

  /** Where it was sent. */
  get goal(): Readonly<Stand> {
    return this.#goal;
  }

  rotate(yaw: number, pitch: number): void {
    this.#goal.yaw -= yaw;
    this.#goal.pitch = clamp(this.#goal.pitch + pitch, PITCH);
  }

  /** factor > 1: further away. */
  zoom(factor: number): void {
    this.#goal.distance = clamp(this.#goal.distance * factor, DISTANCE);
  }

  /** Move over the ground; right and away from the camera, in parts of its distance. */
  pan(right: number, away: number): void {
    const { yaw, distance } = this.#goal;
    const c = Math.cos(yaw) * distance;
    const s = Math.sin(yaw) * distance;
    this.#goal.x = clamp(this.#goal.x - right * s - away * c, [-REACH, REACH]);
    this.#goal.y = clamp(this.#goal.y + right * c - away * s, [-REACH, REACH]);
  }

  /** Go on towards the goal. True while there is some way left. */
  move(seconds: number): boolean {
    const part = 1 - Math.exp(-Math.min(seconds, 0.2) / SMOOTH_S);
    let left = 0;
    for (const name of ["yaw", "pitch", "distance", "x", "y", "z"] as const) {
      const way = this.#goal[name] - this.#now[name];
      this.#now[name] += way * part;
      left = Math.max(left, Math.abs(way) / (name === "distance" ? this.#now.distance : 1));
    }
    if (left < 2e-4) {
      Object.assign(this.#now, this.#goal);
      return false;
    }
    return true;
  }

  /** World to camera, and camera to screen. */
  matrices(view: Matrix, projection: Matrix, aspect: number, ground: number): void {
    const { yaw, pitch, distance, x, y, z } = this.#now;
    const turned = this.kind === "orbit" ? -this.heading : 0;
    const c = Math.cos(turned);
    const s = Math.sin(turned);
    this.#target[0] = c * x - s * y;
    this.#target[1] = s * x + c * y;
    this.#target[2] = ground + 1 + z;
    const flat = distance * Math.cos(pitch);
    this.#eye[0] = this.#target[0] + flat * Math.cos(yaw + turned);
    this.#eye[1] = this.#target[1] + flat * Math.sin(yaw + turned);
    this.#eye[2] = this.#target[2] + distance * Math.sin(pitch);
    lookAt(view, this.#eye, this.#target);
    // upright windows see as much to the sides as square ones
    const fov = aspect >= 1 ? FOV : 2 * Math.atan(Math.tan(FOV / 2) / Math.max(aspect, 0.3));
    perspective(projection, Math.min(fov, 2), aspect, NEAR, FAR);
  }

  get stand(): Readonly<Stand> {
    return this.#now;
  }
}
