/** What the page and the view of a stream agree on. The page makes one view, opens streams in it and sets its options. */
import type { Comparison } from "./compare";

export type Colour = "height" | "intensity" | "distance" | "ring";
export type Camera = "orbit" | "follow";

export interface ViewOptions {
  colour: Colour;
  camera: Camera;
  /** Points' size in CSS pixels. */
  pointSize: number;
  /** Frames shown behind the newest one; 0 for none. */
  trail: number;
  /** Show the range image beside the cloud. */
  rangeImage: boolean;
  /** Show original and decoded side by side, where the source is local. */
  compare: boolean;
  /** Decode messages in the page instead of on the server. */
  decodeInBrowser: boolean;
  /** Make up points between the columns that were sent. */
  fillGaps: boolean;
}

export const DEFAULT_OPTIONS: ViewOptions = {
  colour: "height",
  camera: "orbit",
  pointSize: 1.5,
  trail: 0,
  rangeImage: true,
  compare: false,
  decodeInBrowser: false,
  fillGaps: true,
};

export interface StreamName {
  vehicle: string;
  sensor: string;
}

export interface ViewStats {
  /** Points of the newest cloud shown that were measured; 0 before the first. */
  points: number;
  /** Points between them that were made up. */
  madeUp: number;
  /** Frames that came in the last second or so. */
  fps: number;
  /** From a frame's last packet to its picture; null where the clocks do not agree, or before the first frame. */
  age_ms: number | null;
  frameIndex: number | null;
  /** Nothing came for two seconds, though the socket is open or being opened again. */
  stale: boolean;
  /** Seconds since the last frame; null before the first. */
  silent_s: number | null;
  /** What the socket does. `refused`: the server said no, and `problem` says why; it is not asked again. */
  connection: "closed" | "opening" | "open" | "waiting" | "refused";
  problem: string | null;
  /** What a viewer should know though all is well: that the server decodes what the page cannot. */
  note: string | null;
  /** From the socket's events: whether the vehicle's publisher is there; null while it is not known. */
  alive: boolean | null;
  /** Pictures drawn in the last second: as many as frames while nothing moves, up to the screen's rate while it does. */
  drawn: number;
  /** Original against decoded; null while they are not compared, or no original comes. */
  comparison: Comparison | null;
  /** Memory of the graphics card that textures take. */
  gpuBytes: number;
}

export interface View {
  /** Show a stream instead of the one before. The token, if any, goes as a WebSocket subprotocol. */
  open(stream: StreamName, token?: string): void;
  /** Show nothing. */
  close(): void;
  set(options: Partial<ViewOptions>): void;
  /** Calls back when anything changed, at most ten times a second. */
  onstats(callback: (stats: ViewStats) => void): void;
  /** Free everything; the host is empty afterwards. */
  dispose(): void;
}
