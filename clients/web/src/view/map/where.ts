/** Where a program that finds the sensor in a map says that it is (docs/live-sockets.md, event `pose`). */
import { headingOf, type Pose } from "../matrix";

/** The event `pose`. Numbers are null unless it is tracking. */
export interface PoseEvent {
  receiver: string;
  stamp_ns: number;
  state: "searching" | "tracking" | "lost";
  map: string;
  T_world_sensor: number[] | null;
  /** Standard deviations along x, y and z of the map, and of the rotation about them. */
  sigma_m: number[] | null;
  sigma_deg: number[] | null;
}

/** What was said so long ago is not true any more. */
const FRESH_MS = 2000;
/** Poses are carried on by their motion for at most so long. */
const CARRIED_MS = 500;
const MOST_PROGRAMS = 8;
const STAMPS = 16;
/** Poses of a program that say how long after a frame's stamp theirs is. */
const OFFSETS = 8;

interface Heard {
  told: PoseEvent;
  at: number;
  stampMs: number;
  pose: Pose | null;
  /** Metres and radians in a millisecond; zeros while unknown. */
  velocity: [number, number, number];
  turning: number;
  /** Of its last poses: from the stamp of a frame, its first packet, to that of its pose, the middle of its returns. */
  offsetsMs: readonly number[];
}

export class Where {
  readonly #heard = new Map<string, Heard>();
  readonly #stamps: number[] = [];

  /** Something was said at `now` (ms, any clock that runs on). */
  take(told: PoseEvent, now: number): void {
    const { receiver, T_world_sensor: numbers, state } = told;
    const stampMs = told.stamp_ns / 1e6;
    const pose = state === "tracking" && numbers?.length === 12 ? new Float64Array(numbers) : null;
    const before = this.#heard.get(receiver);
    const first = Math.max(...this.#stamps.filter((stamp) => stamp <= stampMs));
    const offsets = [...(before?.offsetsMs ?? []), ...(stampMs - first < 1000 ? [stampMs - first] : [])];
    const offsetsMs = offsets.slice(-OFFSETS);
    const heard: Heard = { told, at: now, stampMs, pose, velocity: [0, 0, 0], turning: 0, offsetsMs };
    const passed = before ? stampMs - before.stampMs : 0;
    if (before?.pose && pose && before.told.map === told.map && passed > 5 && passed < 1000) {
      for (let axis = 0; axis < 3; axis++)
        heard.velocity[axis] = ((pose[4 * axis + 3] as number) - (before.pose[4 * axis + 3] as number)) / passed;
      const turned = headingOf(pose) - headingOf(before.pose);
      heard.turning = (turned - 2 * Math.PI * Math.round(turned / (2 * Math.PI))) / passed;
    }
    for (const [name, { at }] of this.#heard) if (now - at > FRESH_MS) this.#heard.delete(name);
    if (!this.#heard.has(receiver) && this.#heard.size >= MOST_PROGRAMS) return;
    this.#heard.set(receiver, heard);
  }

  /** A frame is shown. */
  frame(stampMs: number): void {
    this.#stamps.push(stampMs);
    if (this.#stamps.length > STAMPS) this.#stamps.shift();
  }

  reset(): void {
    this.#heard.clear();
    this.#stamps.length = 0;
  }

  /** Whether a program says now where the sensor is in this map, or that it does not know. */
  said(map: string, now: number): boolean {
    return this.#of(map, now)?.told.map === map;
  }

  /** The pose in this map at the time of the newest frame; null while it is not known. */
  pose(map: string, now: number): Pose | null {
    const heard = this.#of(map, now);
    if (!heard?.pose || heard.told.map !== map) return null;
    const newest = this.#stamps.at(-1) ?? heard.stampMs;
    const late = newest + (heard.offsetsMs.length ? Math.min(...heard.offsetsMs) : 0) - heard.stampMs;
    if (Math.abs(late) > CARRIED_MS) return null;
    return carried(heard.pose, heard.velocity, heard.turning, late);
  }

  /** A line for people; empty while nobody says anything. map: the one that is drawn */
  line(map: string | null, now: number): string {
    const heard = this.#of(map, now);
    if (!heard) return "";
    const { told, pose } = heard;
    if (!pose) return told.state === "searching" ? `Not found yet in map ${told.map}` : `Lost in map ${told.map}`;
    const [x, y] = [pose[3] as number, pose[7] as number].map((value) => value.toFixed(2));
    const degrees = ((headingOf(pose) * 180) / Math.PI).toFixed(1);
    const [m, deg] = [Math.max(...(told.sigma_m ?? [])), Math.max(...(told.sigma_deg ?? []))];
    const off = Number.isFinite(m) && Number.isFinite(deg) ? ` ± ${length(m)}, ± ${deg.toFixed(2)}°` : "";
    return `In map ${told.map}: x ${x} m, y ${y} m, yaw ${degrees}°${off}`;
  }

  /** Whether it is lost, or was not found yet. */
  lost(map: string | null, now: number): boolean {
    return this.#of(map, now)?.pose === null;
  }

  /** What counts: a report in the map that is drawn before all else, then a known pose, then the newest. */
  #of(map: string | null, now: number): Heard | null {
    let found: Heard | null = null;
    const rank = ({ told, pose }: Heard) => (told.map === map ? 2 : 0) + (pose ? 1 : 0);
    for (const heard of this.#heard.values()) {
      if (now - heard.at > FRESH_MS) continue;
      const more = found === null ? 1 : rank(heard) - rank(found) || heard.at - found.at;
      if (more > 0) found = heard;
    }
    return found;
  }
}

const length = (m: number) => (m < 0.095 ? `${(100 * m).toFixed(1)} cm` : `${m.toFixed(2)} m`);

/** A pose after some milliseconds of the same motion. */
function carried(pose: Pose, velocity: readonly number[], turning: number, ms: number): Pose {
  const out = new Float64Array(pose);
  const [c, s] = [Math.cos(turning * ms), Math.sin(turning * ms)];
  for (let column = 0; column < 3; column++) {
    const [x, y] = [pose[column] as number, pose[4 + column] as number];
    out[column] = c * x - s * y;
    out[4 + column] = s * x + c * y;
  }
  for (let axis = 0; axis < 3; axis++)
    out[4 * axis + 3] = (pose[4 * axis + 3] as number) + (velocity[axis] as number) * ms;
  return out;
}
