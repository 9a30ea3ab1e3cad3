/** The interface between the page and the view. The page makes one view, opens streams in it and sets its options. */
import type { Comparison } from "./compare";
import type { Stand } from "./draw/camera";
import type { Film } from "./draw/film";
import type { Box } from "./scene/box";
import type { Beside, LegendRow } from "./scene/guests";
import type { Mount } from "./scene/mounts";

export type Colour = "height" | "intensity" | "distance" | "ring" | "stream";
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
  /** Interpolate points between sent columns. */
  fillGaps: boolean;
  /** Show the fields of the points that are clicked, and the distance of two. */
  measure: boolean;
  /** Name of the map that is drawn under the cloud; null for none. */
  map: string | null;
  /** Draw only the points in it; null draws all. */
  box: Box | null;
  /** Other streams in the same picture. */
  beside: readonly Beside[];
  /** Where the sensor of the chosen stream sits on its vehicle, if that is known. */
  mount: Mount | null;
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
  measure: false,
  map: null,
  box: null,
  beside: [],
  mount: null,
};

export interface StreamName {
  vehicle: string;
  sensor: string;
}

export interface ViewStats {
  /** Measured points of the newest shown cloud; 0 before the first. */
  points: number;
  /** Interpolated points. */
  madeUp: number;
  /** Frames that came in the last second or so. */
  fps: number;
  /** Time from a frame's last packet to its picture; null if the clocks differ, or before the first frame. */
  age_ms: number | null;
  frameIndex: number | null;
  /** No frame came for two seconds, although the socket is open or being reopened. */
  stale: boolean;
  /** Seconds since the last frame; null before the first. */
  silent_s: number | null;
  /** State of the socket. `refused`: the server refused it, `problem` says why, and the page does not try again.
   * `unable`: this browser cannot draw, and `problem` says why. */
  connection: "closed" | "opening" | "open" | "waiting" | "refused" | "unable";
  problem: string | null;
  /** A note that is not a problem: the server decodes because the page cannot, or why the map is not drawn. */
  note: string | null;
  /** From the socket's events: whether the vehicle's publisher is online; null while unknown. */
  alive: boolean | null;
  /** Pictures drawn in the last second: as many as frames while nothing moves, up to the screen's rate while it does. */
  drawn: number;
  /** Comparison of original and decoded; null without one. */
  comparison: Comparison | null;
  /** Measured points in the box, of all streams; null without a box. */
  inBox: number | null;
  /** Measured points of all streams that are shown. */
  allPoints: number;
  /** The streams in the picture, the chosen one first; empty for a stream alone. */
  streams: readonly LegendRow[];
  /** Memory of textures on the graphics card. */
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
  /** The view as it is now, as a PNG with a caption; null before the first frame. caption: from the frame's stamp */
  picture(caption: (stampMs: number) => string): Promise<Blob | null>;
  /** Where the camera stands. */
  stand(): Stand;
  /** Send the camera there. */
  goTo(stand: Stand): void;
  /** Begin a clip of the view, with a caption; null if this browser makes none, or before the first frame. */
  film(caption: (stampMs: number) => string): Film | null;
  /** Free everything; the host is empty afterwards. */
  dispose(): void;
}
