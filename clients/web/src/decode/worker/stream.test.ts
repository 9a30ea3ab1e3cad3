/** What a viewer would lose: the same frame as from the server, whatever codec, and a page that goes on, whatever bytes. */

import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { beforeAll, describe, expect, it, vi } from "vitest";
import { crc32c } from "../../../../typescript/src/crc32c.js";
import { DecodeError } from "../../../../typescript/src/errors.js";
import { sha256 } from "../../../../typescript/src/sha256.js";
import { zstdReady } from "../../../../typescript/src/zstd.js";
import { numbers } from "../../../../typescript/test/numbers.js";
import {
  cloudVectors,
  digest,
  type Expected,
  type ExpectedCloud,
  type ExpectedOther,
  otherVectors,
  type Vector,
  vectors,
} from "../../../../typescript/test/vectors.js";
import { parseFrame } from "../../view/stream/frame";
import { sensorTable } from "../../view/stream/sensor";
import { DECODED_HERE } from "../index";
import { DECODES, type Decoded, StreamDecoder } from "./stream";

const FOLDER = import.meta.dirname;
const WEIGHTS = join(FOLDER, "../../../../../lidarcodec/network/weights");
const SHIPPED = readdirSync(WEIGHTS).map((name) => new Uint8Array(readFileSync(join(WEIGHTS, name))));
const NOW = 1_700_000_000_000;
const ALL = vectors(/./);

vi.setConfig({ testTimeout: 120_000, hookTimeout: 120_000 }); // of a busy machine

let module: WebAssembly.Module;
let fetched: string[] = [];

beforeAll(async () => {
  await zstdReady();
  module = await WebAssembly.compile(new Uint8Array(readFileSync(join(FOLDER, "decoder.wasm"))));
});

function decoder(): StreamDecoder {
  fetched = [];
  const weights = async (name: string) => {
    fetched.push(name);
    return SHIPPED.find((data) => Buffer.from(sha256(data).subarray(0, 8)).toString("hex") === name) ?? null;
  };
  return new StreamDecoder(module, weights, () => NOW);
}

function vector(name: string): Vector {
  return ALL.find((one) => one.name === name) as Vector;
}

function check({ data, sensor }: Decoded, expected: Expected): void {
  const columns = new DataView(data).getUint16(76, true);
  expect(columns).toBe(expected.width);
  expect([sensor.name, sensor.hash, sensor.convention, sensor.range_step_m]).toEqual(expected.sensor);
  expect(sensorTable(sensor).values.length).toBe(64 * 12);
  if (columns === 0) return; // nothing to show, and no frame for the view
  const frame = parseFrame(data);
  expect(BigInt(`0x${frame.streamId}`)).toBe(BigInt(expected.stream));
  expect(frame.index).toBe(Number(expected.index));
  expect(frame.stampMs).toBeCloseTo(Number(expected.stamp_ns) / 1e6, 1);
  expect(frame.decodedMs).toBe(NOW);
  expect(frame.returns).toBe(expected.returns);
  expect(digest(frame.range)).toBe(expected.range);
  expect(digest(frame.azimuth)).toBe(expected.azimuth);
  expect(digest(frame.intensity ?? new Uint8Array(64 * columns))).toBe(expected.intensity);
  expect(frame.pose && [...frame.pose]).toEqual(expected.pose);
}

/** As the server shows the same frame. */
function checkOther({ data, sensor }: Decoded, expected: ExpectedOther): void {
  expect([sensor.name, sensor.hash, sensor.model]).toEqual([expected.sensor[0], expected.sensor[1], expected.model]);
  const { rows, width, shown } = expected;
  expect(sensorTable(sensor).rings).toBe(rows);
  expect(sensor.range_step_m).toBeCloseTo(shown.range_step_m, 12);
  const frame = parseFrame(data);
  expect([frame.rings, frame.columns, frame.index]).toEqual([rows, width, Number(expected.index)]);
  expect(frame.returns).toBe(expected.returns);
  expect(digest(frame.range)).toBe(shown.range);
  expect(digest(frame.azimuth.subarray(0, width))).toBe(expected.azimuth);
  expect(frame.azimuth.subarray(width)).toEqual(frame.azimuth.subarray(0, width));
  expect(digest(frame.intensity ?? new Uint8Array(rows * width))).toBe(shown.intensity);
  expect(frame.pose && [...frame.pose]).toEqual(expected.pose);
}

/** The geometry of the first, middle and last ring, which is fitted to the first frame. */
function checkRings({ sensor }: Decoded, { rows, shown }: ExpectedOther): void {
  for (const [i, ring] of [0, rows >> 1, rows - 1].entries()) {
    const found = [
      sensor.rot_correction_rad[ring],
      sensor.vert_correction_rad[ring],
      sensor.dist_correction_m[ring],
      sensor.vert_offset_m[ring],
      sensor.horiz_offset_m[ring],
    ];
    for (const [at, value] of found.entries()) expect(value).toBeCloseTo(shown.rings?.[i]?.[at] as number, 6);
  }
}

/** As the server shows the same cloud. */
function checkCloud({ data, sensor }: Decoded, { shown, ...expected }: ExpectedCloud): void {
  expect([sensor.name, sensor.hash, sensor.model]).toEqual([expected.sensor[0], expected.sensor[1], "pointcloud2"]);
  const frame = parseFrame(data);
  expect(frame.returns).toBe(expected.returns);
  expect(sensorTable(sensor).rings).toBe(frame.rings);
  const drawn = frame.range.reduce((count, range) => count + (range > 0 ? 1 : 0), 0);
  const sum = (values: ArrayLike<number>) => Array.from(values).reduce((all, value) => all + value, 0);
  expect([frame.rings, frame.columns, drawn]).toEqual([shown.rows, shown.columns, shown.drawn]);
  expect(frame.rangeStepM).toBeCloseTo(shown.step_m, 9);
  expect([sum(frame.range), sum(frame.intensity ?? [])]).toEqual([shown.range, shown.intensity]);
}

/** With returns made up between the columns of a thinned frame, as the server makes them up; others as they are. */
function checkFilled(decoded: Decoded, expected: Expected): void {
  const frame = parseFrame(decoded.data);
  const { returns, madeUp, filled, range, intensity } = frame;
  expect([returns, madeUp]).toEqual([expected.returns, expected.made_up]);
  expect([filled ?? new Uint8Array(), range, intensity ?? new Uint8Array()].map(digest)).toEqual(expected.filled);
  expect(digest(frame.azimuth)).toBe(expected.azimuth);
}

describe("messages of every codec that is decoded here", () => {
  it.each(ALL.map(({ name }) => name))("%s", async (name) => {
    const { messages, expected } = vector(name);
    const one = decoder();
    for (const [i, message] of messages.entries()) check(await one.decode(message), expected[i]);
    expect(fetched.length).toBeLessThan(2); // weights are asked for once
  });

  it.each(otherVectors(/./))("$name of another sensor", async ({ messages, expected }) => {
    const one = decoder();
    for (const [i, message] of messages.entries()) {
      const decoded = await one.decode(message);
      checkOther(decoded, expected[i] as ExpectedOther);
      if (i === 0) checkRings(decoded, expected[i] as ExpectedOther);
    }
  });

  it.each(cloudVectors(/./))("$name of point clouds", async ({ messages, expected }) => {
    const one = decoder();
    for (const [i, message] of messages.entries()) {
      const wanted = expected[i] as ExpectedCloud;
      const decoded = await one.decode(message);
      const again = await one.decode(message);
      expect(again.told).toBe(decoded.told); // a viewer is not told again of the same rows
      checkCloud(decoded, wanted);
    }
  });

  it("returns of other sensors are made up between columns, too", async () => {
    const [{ messages, expected }] = otherVectors(/os1-128/) as [Vector<ExpectedOther>];
    const one = decoder();
    for (const [i, message] of messages.entries()) {
      const frame = parseFrame((await one.decode(message, true)).data);
      expect(frame.returns).toBe(expected[i]?.returns);
      expect(frame.madeUp).toBeGreaterThan(frame.returns);
    }
  });

  it.each(ALL.map(({ name }) => name).filter((name) => name.endsWith("thinned")))(
    "%s, with gaps filled",
    async (name) => {
      const { messages, expected } = vector(name);
      const one = decoder();
      for (const [i, message] of messages.entries()) {
        const decoded = await one.decode(message, true);
        if (expected[i].filled) checkFilled(decoded, expected[i]);
        else check(decoded, expected[i]);
      }
    },
  );

  it("are those that the page asks for", () => {
    const found = new Set(
      ALL.map(({ messages }) => new DataView(messages[0].buffer, messages[0].byteOffset).getUint16(12, true)),
    );
    expect(found).toEqual(DECODED_HERE);
    expect(new Set(Object.keys(DECODES).map(Number))).toEqual(DECODED_HERE);
  });
});

async function failure(one: StreamDecoder, message: Uint8Array): Promise<string> {
  try {
    await one.decode(message, true);
    return "";
  } catch (error) {
    expect(error).toBeInstanceOf(DecodeError);
    return (error as DecodeError).code;
  }
}

/** A copy with changed bytes, and a checksum that fits them. */
function changed(message: Uint8Array, change: (bytes: Uint8Array) => void): Uint8Array {
  const bytes = message.slice();
  change(bytes);
  const view = new DataView(bytes.buffer);
  view.setUint32(8, bytes.length, true);
  view.setUint32(bytes.length - 4, crc32c(bytes.subarray(0, -4)), true);
  return bytes;
}

describe("what is lost or hostile", () => {
  it("a message that builds on a lost one says so, and decoding goes on with the next that needs none", async () => {
    const { messages, expected } = vector("golden_v1_riddle_lossless");
    const one = decoder();
    expect(await failure(one, messages[1])).toBe("reference");
    check(await one.decode(messages[0]), expected[0]);
    expect(await failure(one, messages[2])).toBe("reference");
    check(await one.decode(messages[1]), expected[1]);
    check(await one.decode(messages[3]), expected[3]); // a key message
    check(await one.decode(messages[4]), expected[4]);
  });

  it("a damaged message costs the frames up to the next key message, and no more", async () => {
    const { messages, expected } = vector("golden_v1_predictive_coarse");
    const one = decoder();
    check(await one.decode(messages[0]), expected[0]);
    const damaged = changed(messages[1], (bytes) => bytes.fill(0xff, bytes.length - 200, bytes.length - 100));
    expect(await failure(one, damaged)).not.toBe("");
    expect(await failure(one, messages[2])).toBe("reference");
    check(await one.decode(messages[3]), expected[3]);
  });

  it("a picture of other sides than the planes beside it is refused, and shows nothing false", async () => {
    const [{ messages, expected }] = otherVectors(/png_vlp16/) as [Vector<ExpectedOther>];
    const one = decoder();
    const first = messages[0] as Uint8Array;
    const header = Buffer.from(first).indexOf("IHDR") + 4;
    for (const [rows, columns] of [
      [expected[0]?.width, expected[0]?.rows], // as many samples
      [8, 2 * (expected[0]?.width ?? 0)],
    ]) {
      const turned = changed(first, (bytes) => {
        const view = new DataView(bytes.buffer, header);
        view.setUint32(0, columns as number);
        view.setUint32(4, rows as number);
      });
      expect(await failure(one, turned)).toBe("section");
      checkOther(await one.decode(first), expected[0] as ExpectedOther);
    }
  });

  it("a codec that is not decoded here is named", async () => {
    const other = changed(vector("zstd").messages[0], (bytes) => bytes.set([5, 0], 12));
    await expect(decoder().decode(other)).rejects.toThrow("codec 5");
    expect(await failure(decoder(), other)).toBe("version");
  });

  it("weights that the server has not are asked for with a key message", async () => {
    const one = new StreamDecoder(
      module,
      async () => null,
      () => NOW,
    );
    expect(await failure(one, vector("golden_v1_riddle_lossless").messages[0])).toBe("reference");
  });

  it.each([
    "zstd_modelled",
    "predictive_thinned",
    "golden_v1_pcodec_lossless",
    "golden_v1_png_lossless",
    "golden_v1_predictive_slabs_motion",
    "golden_v1_riddle_coarse",
  ])(
    "mutated messages of %s are errors or frames, and whole ones are decoded after them",
    async (name) => {
      const { messages, expected } = vector(name);
      const random = numbers(20261121);
      const one = decoder();
      let refused = 0;
      for (let i = 0; i < 150; i++) {
        const at = random(messages.length);
        const hostile = changed(messages[at], (bytes) => {
          for (let times = 1 + random(3); times > 0; times--)
            bytes[56 + random(bytes.length - 60)] = random(2) ? random(256) : 0xff;
        });
        refused += (await failure(one, hostile)) === "" ? 0 : 1;
        if (i % 15 === 0) check(await one.decode(messages[0]), expected[0]);
      }
      expect(refused).toBeGreaterThan(60);
    },
    120_000,
  );

  it.each(["predictive_os0-32", "zstd_os1-128", "raw_vlp16", "png_vlp16", "png_os0-16"])(
    "mutated messages of %s of another sensor, too",
    async (name) => {
      const [{ messages, expected }] = otherVectors(new RegExp(name)) as [Vector<ExpectedOther>];
      const random = numbers(20261126);
      const one = decoder();
      let refused = 0;
      for (let i = 0; i < 100; i++) {
        const hostile = changed(messages[random(messages.length)] as Uint8Array, (bytes) => {
          for (let times = 1 + random(3); times > 0; times--)
            bytes[56 + random(bytes.length - 60)] = random(2) ? random(256) : 0xff;
        });
        refused += (await failure(one, hostile)) === "" ? 0 : 1;
        if (i % 15 === 0) checkOther(await one.decode(messages[0] as Uint8Array), expected[0] as ExpectedOther);
      }
      expect(refused).toBeGreaterThan(5);
    },
  );

  it.each(["zstd", "predictive"])("mutated point clouds of %s, too", async (name) => {
    const [{ messages, expected }] = cloudVectors(new RegExp(`^${name}$`)) as [Vector<ExpectedCloud>];
    const random = numbers(20261127);
    const one = decoder();
    let refused = 0;
    for (let i = 0; i < 120; i++) {
      const hostile = changed(messages[random(messages.length)] as Uint8Array, (bytes) => {
        for (let times = 1 + random(3); times > 0; times--)
          bytes[56 + random(bytes.length - 60)] = random(2) ? random(256) : 0xff;
      });
      refused += (await failure(one, hostile)) === "" ? 0 : 1;
      if (i % 15 === 0) checkCloud(await one.decode(messages[0] as Uint8Array), expected[0] as ExpectedCloud);
    }
    expect(refused).toBeGreaterThan(20);
  });

  it("a viewer is told again where the rows of a cloud are others", async () => {
    const [{ messages }] = cloudVectors(/^zstd$/) as [Vector<ExpectedCloud>];
    const one = decoder();
    const told: number[] = [];
    for (const message of messages.slice(0, 3)) told.push((await one.decode(message)).told);
    expect(new Set(told).size).toBe(3);
  });

  it("a message that is cut is an error", async () => {
    const one = decoder();
    const { messages } = vector("golden_v1_riddle_lossless");
    for (let size = 0; size < messages[0].length; size += 211) {
      expect(await failure(one, messages[0].slice(0, size))).not.toBe("");
      if (size > 60)
        expect(
          await failure(
            one,
            changed(messages[0].slice(0, size), () => {}),
          ),
        ).not.toBe("");
    }
  });
});
