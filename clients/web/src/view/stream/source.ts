/** Where frames come from: the server's cloud socket, or the page's own decoder behind the frames socket. */

import type { StreamName, ViewStats } from "../types";
import type { RangeFrame } from "./frame";
import type { SensorTable } from "./sensor";

/** What a source tells; everything is called in the main thread, between two pictures. */
export interface Sink {
  /** A frame. It is shown with the next picture; `shown` is called then, and only then may another one come. */
  frame(frame: RangeFrame, sensor: SensorTable, shown: () => void): void;
  /** The publisher was started again: what was shown belongs to another run. */
  restarted(): void;
  /** State, problem or publisher changed. */
  changed(): void;
}

export interface FrameSource {
  readonly connection: ViewStats["connection"];
  /** Why nothing comes, for people; null while all is well. */
  readonly problem: string | null;
  readonly alive: boolean | null;
  /** What a viewer should know though all is well; null or nothing otherwise. */
  readonly note?: string | null;
  /** Milliseconds by which the clock of whoever decodes is ahead of the browser's; 0 where they are one. */
  readonly clockAheadMs: number;
  close(): void;
}

export interface SourceOptions {
  stream: StreamName;
  token: string | undefined;
  /** Ask for the range image before coding, too. */
  original: boolean;
  /** Have points made up between the columns that were sent. */
  fill: boolean;
}
