/** A bag that lidarcodec wrote (LIDARCODEC_BAG), read by Foxglove's own packages. The points of each message go to the folder
 * LIDARCODEC_OUT, where the test in Python compares them with its own. */

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { zstdFrame, zstdReady } from "../../typescript/src/zstd.js";
import { FROM, loaded } from "./extension.js";

const { LIDARCODEC_BAG: bag, LIDARCODEC_OUT: out } = process.env;

test("a bag of lidarcodec has points, poses and no problems", { skip: !bag || !out }, async () => {
  await zstdReady();
  const data = readFileSync(bag!);
  const reader = await McapIndexedReader.Initialize({
    readable: {
      size: async () => BigInt(data.length),
      read: async (at, size) => new Uint8Array(data.subarray(Number(at), Number(at + size))),
    },
    decompressHandlers: { zstd: (frame, size) => zstdFrame(new Uint8Array(frame), Number(size)) },
  });
  const { cloud, transform, log } = await loaded();
  let messages = 0;
  for await (const { channelId, data: message, logTime } of reader.readMessages()) {
    const { topic, messageEncoding, schemaId } = reader.channelsById.get(channelId)!;
    const schema = reader.schemasById.get(schemaId)!;
    if (schema?.name !== FROM) continue;
    assert.deepEqual([messageEncoding, schema.encoding], ["cdr", "ros2msg"]);
    const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
    const read = new MessageReader(definition).readMessage<{ header: { stamp: { sec: number; nanosec: number } } }>(message);
    // Foxglove calls the parts of a time sec and nsec.
    const { sec, nanosec } = read.header.stamp;
    const coded = { ...read, header: { ...read.header, stamp: { sec, nsec: nanosec } } };
    assert.equal(BigInt(sec) * 1_000_000_000n + BigInt(nanosec), logTime);
    const found = cloud(coded, topic);
    assert.ok(found, log(coded, topic)?.message ?? "no points");
    writeFileSync(join(out!, `${messages++}.points`), found.data);
    writeFileSync(join(out!, `${messages - 1}.json`), JSON.stringify({ pose: transform(coded, topic) ?? null }));
  }
  assert.ok(messages > 0);
});
