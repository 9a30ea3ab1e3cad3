/** Decoder of lidarcodec messages, format 1, codecs raw and zstd. README.md shows it at work. */

export { Decoder, type Frame } from "./decoder.js";
export { CloudMessage, FieldType, type CloudField, type CloudHead, type Values } from "./clouds/message.js";
export { cloudPointsOf, type CloudPoints } from "./clouds/points.js";
export type { Cloud } from "./clouds/section.js";
export { DecodeError, type ErrorCode } from "./errors.js";
export { filled } from "./filling.js";
export { Codec, Section, readMessage, type Message } from "./message.js";
export type { DescribedSensor } from "./other/calibration.js";
export { type ImageFrame, isImageFrame } from "./other/frame.js";
export { imagePointsOf, type ImagePoints } from "./other/points.js";
export type { Plane } from "./other/planes.js";
export type { Rest } from "./other/rest.js";
export { pointsOf, type Points } from "./points.js";
export type { Sensor } from "./sensor.js";
