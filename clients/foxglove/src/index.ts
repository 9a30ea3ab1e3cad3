/** Foxglove's entry point: registers what the extension converts, then loads the decoder. */

import type { ExtensionContext } from "@foxglove/extension";
import weights from "../../../lidarcodec/network/weights/riddle-sim.lcrw";
import { zstdReady } from "../../typescript/src/zstd.js";
import wasm from "../../web/src/decode/worker/decoder.wasm";
import { type CompressedCloud, Converters } from "./converters.js";
import { Core } from "./stream.js";

/** As files of ROS 2 name it, and as converted bags of ROS 1 do. */
const FROM = ["point_cloud_interfaces/msg/CompressedPointCloud2", "point_cloud_interfaces/CompressedPointCloud2"];

export async function activate(context: ExtensionContext): Promise<void> {
  const converters = new Converters();
  for (const fromSchemaName of FROM) {
    const register = (toSchemaName: string, convert: (coded: CompressedCloud, topic: string) => unknown) =>
      context.registerMessageConverter<CompressedCloud>({
        type: "schema",
        fromSchemaName,
        toSchemaName,
        converter: (coded, { topic }) => convert(coded, topic),
      });
    register("foxglove.PointCloud", (coded, topic) => converters.cloud(coded, topic));
    register("foxglove.FrameTransform", (coded) => converters.transform(coded));
    register("foxglove.Log", (coded, topic) => converters.log(coded, topic));
  }
  try {
    const [module] = await Promise.all([WebAssembly.compile(wasm), zstdReady()]);
    converters.ready(new Core(module, [weights]));
  } catch (error) {
    converters.ready(error instanceof Error ? error : new Error(String(error)));
  }
}
