/** The view of a stream: a point cloud, its range image, and original against decoded. */
import { LiveView } from "./live";
import type { View, ViewOptions } from "./types";
import "./view.css";

export type { Comparison } from "./compare";
export type { Stand } from "./draw/camera";
export { type Film, filmType, LONGEST_S } from "./draw/film";
export { type Box, checkedBox, THINNEST_M, WIDEST } from "./scene/box";
export type { Beside } from "./scene/guests";
export { MOST_STREAMS, type Mount } from "./scene/mounts";
export type { Camera, Colour, StreamName, View, ViewOptions, ViewStats } from "./types";

export function createView(host: HTMLElement, options: ViewOptions): View {
  return new LiveView(host, options);
}
