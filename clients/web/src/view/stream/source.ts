/** Sources of frames: the server's cloud socket, or the page's own decoder with the frames socket. */

import type { PoseEvent } from "../map/where";
import type { StreamName, ViewStats } from "../types";
import type { RangeFrame } from "./frame";
import type { SensorTable } from "./sensor";

/** Callbacks of a source. All are called in the main thread, between two pictures. */
export interface Sink {
  /** A frame. It is shown with the next picture; then `shown` is called, and only then the next frame may come. */
  frame(frame: RangeFrame, sensor: SensorTable, shown: () => void): void;
  /** The publisher was restarted: the shown frames belong to another run. */
  restarted(): void;
  /** A program says where the sensor is in a map. */
  located?(told: PoseEvent): void;
  /** State, problem or publisher changed. */
  changed(): void;
}

export interface FrameSource {
  readonly connection: ViewStats["connection"];
  /** Why no frames come, for people; null without a problem. */
  readonly problem: string | null;
  readonly alive: boolean | null;
  /** A note that is not a problem; null or undefined without one. */
  readonly note?: string | null;
  /** Milliseconds by which the decoding machine's clock is ahead of the browser's; 0 if they are the same. */
  readonly clockAheadMs: number;
  close(): void;
}

export interface SourceOptions {
  stream: StreamName;
  token: string | undefined;
  /** Also request the range image before coding. */
  original: boolean;
  /** Request interpolated points between sent columns. */
  fill: boolean;
}
