/** The built extension as Foxglove loads it: the text of dist/extension.js is evaluated, and `activate` called. */

import { readFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import type { ExtensionContext, ExtensionModule } from "@foxglove/extension";
import type { FrameTransform, Log, PointCloud } from "@foxglove/schemas";

export const FROM = "point_cloud_interfaces/msg/CompressedPointCloud2";
export const TOPIC = "/points/lidarcodec";
const FILE = join(dirname(fileURLToPath(import.meta.url)), "..", "extension.js");

export interface Converted {
  cloud(coded: object, topic?: string): PointCloud | undefined;
  transform(coded: object, topic?: string): FrameTransform | undefined;
  log(coded: object, topic?: string): Log | undefined;
}

type Convert = (message: unknown, event: { topic: string }) => unknown;

/** What a message is converted to. early: before the decoder is loaded */
export async function loaded(early?: (converted: Converted) => void): Promise<Converted> {
  const module = { exports: {} as ExtensionModule };
  const refused = (name: string) => {
    throw new Error(`Foxglove has no module ${name}`);
  };
  new Function("module", "require", readFileSync(FILE, "utf8"))(module, refused);
  const found = new Map<string, Convert>();
  const registerMessageConverter = (one: { fromSchemaName: string; toSchemaName: string; converter: Convert }) =>
    found.set(`${one.fromSchemaName} ${one.toSchemaName}`, one.converter);
  const active = module.exports.activate({ registerMessageConverter } as unknown as ExtensionContext);
  const by = (to: string) => (coded: object, topic = TOPIC) => found.get(`${FROM} ${to}`)!(coded, { topic }) as never;
  const converted = { cloud: by("foxglove.PointCloud"), transform: by("foxglove.FrameTransform"), log: by("foxglove.Log") };
  early?.(converted);
  await active;
  return converted;
}

/** A message in the type that it has in bags and on ROS 2. */
export function coded(data: Uint8Array, format = "lidarcodec"): object {
  return { header: { stamp: { sec: 7, nsec: 9 }, frame_id: "car-7/roof" }, compressed_data: data, format };
}
