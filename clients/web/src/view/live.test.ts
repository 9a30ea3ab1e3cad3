import { describe, expect, test } from "vitest";
import { framesOfTurn } from "./draw/layers";
import { layout } from "./draw/layout";
import { Ground } from "./ground";
import { Motion } from "./motion";
import { Quality } from "./quality";
import { Backoff } from "./stream/backoff";
import { parseFrame } from "./stream/frame";
import { type SensorEvent, sensorTable } from "./stream/sensor";
import { Tally } from "./stream/tally";
import { message } from "./testing";

test("a turn is put together from the parts it comes in", () => {
  expect(framesOfTurn([1.0, 1.0])).toBe(1);
  expect(framesOfTurn([0.99])).toBe(1);
  expect(framesOfTurn(Array(30).fill(1 / 12))).toBe(12);
  expect(framesOfTurn([0.5])).toBe(1);
  expect(framesOfTurn([0.4, 0.4, 0.4])).toBe(2);
});

test("a socket that cannot be opened is tried again later and later, but never later than 12 s", () => {
  const backoff = new Backoff();
  expect([0, 1, 2, 3, 4, 5, 6].map(() => backoff.next(0.5))).toEqual([500, 1000, 2000, 5000, 10000, 10000, 10000]);
  expect(backoff.next(1)).toBe(12000);
  backoff.reset();
  expect(backoff.next(0)).toBe(400);
});

describe("where the sensor is between two frames", () => {
  const at = (x: number, angle: number, stampMs: number) => {
    const frame = parseFrame(message({ pose: true }));
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    return { ...frame, stampMs, pose: Float64Array.from([c, -s, 0, x, s, c, 0, 0, 0, 0, 1, 0]) };
  };

  test("it goes on as it went", () => {
    const motion = new Motion();
    motion.take(at(0, 0, 1000), 50);
    motion.take(at(1, 0, 1100), 150);
    expect(motion.predict(200)).toBe(true);
    expect(motion.pose[3]).toBeCloseTo(1.5);
    expect(motion.predict(10_000)).toBe(false);
    expect(motion.pose[3]).toBeLessThan(3);
  });

  test("it stays where it is while it stands, and nothing is drawn for that", () => {
    const motion = new Motion();
    motion.take(at(5, 1, 1000), 50);
    motion.take(at(5, 1, 1100), 150);
    expect(motion.predict(200)).toBe(false);
    expect(motion.pose[3]).toBeCloseTo(5);
  });
});

test("the road is found where the lower beams hit it", () => {
  const list = (value: number) => Array<number>(64).fill(value);
  const event: SensorEvent = {
    convention: "ros",
    rings: 64,
    range_step_m: 0.002,
    block: list(0),
    rot_correction_rad: list(0),
    vert_correction_rad: list(-0.3),
    dist_correction_m: list(0),
    dist_correction_x_m: list(0),
    dist_correction_y_m: list(0),
    vert_offset_m: list(0),
    horiz_offset_m: list(0),
  };
  const table = sensorTable(event);
  const frame = parseFrame(message({ columns: 2000 }));
  frame.range.fill(Math.round(1.9 / Math.sin(0.3) / 0.002));
  const ground = new Ground();
  ground.update(frame, table);
  expect(ground.z).toBeCloseTo(-1.9, 2);
  expect(() => sensorTable({ ...event, block: [1] })).toThrow("block");
});

test("less is drawn where pictures take too long, and only then", () => {
  const quality = new Quality();
  for (let picture = 0; picture < 100; picture++) expect(quality.took(picture % 4 === 0 ? 60 : 12)).toBe(false);
  for (let picture = 0; picture < 40; picture++) quality.took(200);
  expect(quality.level).toBe(0);
  expect(quality.ratio(1)).toBe(1);
  expect(quality.ratio(3)).toBe(1.5);
});

test("panes fill the window, and stand above one another in an upright one", () => {
  const area = (rect: { wide: number; high: number } | null) => (rect ? rect.wide * rect.high : 0);
  for (const [wide, high] of [
    [1280, 720],
    [400, 800],
  ] as const) {
    for (const panes of [1, 2] as const) {
      const made = layout(wide, high, 1, panes, true);
      expect(made.reduce((sum, { cloud, image }) => sum + area(cloud) + area(image), 0)).toBe(wide * high);
    }
  }
  expect(layout(400, 800, 1, 2, false).map(({ cloud }) => cloud.y)).toEqual([400, 0]);
});

test("a stream that brings nothing for two seconds is stale, and its age is that of its picture", () => {
  const tally = new Tally();
  expect(tally.stats(0)).toMatchObject({ points: 0, frameIndex: null, stale: false, silent_s: null, age_ms: null });
  const frame = { ...parseFrame(message()), latencyMs: 20, decodedMs: 5000 };
  tally.shown(frame, { points: 120_000, madeUp: 7 }, 100, 5030);
  expect(tally.stats(1000)).toMatchObject({ points: 120_000, madeUp: 7, frameIndex: 7, stale: false, fps: 1 });
  expect(tally.stats(1000).age_ms).toBeCloseTo(50);
  expect(tally.stats(2200)).toMatchObject({ stale: true, fps: 0, silent_s: 2.1 });
});
