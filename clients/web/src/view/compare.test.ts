import { describe, expect, test } from "vitest";
import { Comparing, compared, ErrorScale, millimetres } from "./compare";
import type { RangeFrame } from "./stream/frame";

const pair = (range: number[], original: number[]) => ({
  range: Uint16Array.from(range),
  original: Uint16Array.from(original),
  rangeStepM: 0.002,
});

describe("original against decoded", () => {
  test("a lossless frame has no error", () => {
    const same = [100, 0, 65535, 3];
    expect(compared(pair(same, same))).toEqual({
      returns: 3,
      rmse_mm: 0,
      max_mm: 0,
      changed: 0,
      dropped: 0,
      invented: 0,
    });
  });

  test("errors count along the ray and in both directions, over returns that are in both", () => {
    const found = compared(pair([103, 96, 50, 0, 9], [100, 100, 50, 20, 0]));
    expect(found).toMatchObject({ returns: 3, max_mm: 8, dropped: 1, invented: 1 });
    expect(found?.changed).toBeCloseTo(2 / 3);
    expect(found?.rmse_mm).toBeCloseTo(2 * Math.sqrt(25 / 3));
  });

  test("what was made up is not compared: it was never sent", () => {
    const frame = { ...pair([100, 140, 100, 0], [100, 100, 0, 0]), filled: Uint8Array.from([0, 1, 1, 0]) };
    expect(compared(frame)).toMatchObject({ returns: 1, max_mm: 0, dropped: 1, invented: 0 });
  });

  test("without an original there is nothing to say", () => {
    expect(compared({ ...pair([1], [1]), original: null })).toBeNull();
  });
});

test("the scale of errors grows at once and shrinks only after a while, so that colours do not flicker", () => {
  const scale = new ErrorScale();
  expect(scale.update(2)).toBe(false);
  expect(scale.mm).toBe(20);
  expect(scale.update(90)).toBe(true);
  expect(scale.mm).toBe(100);
  for (let frame = 0; frame < 19; frame++) expect(scale.update(10)).toBe(false);
  expect(scale.update(90)).toBe(false);
  for (let frame = 0; frame < 19; frame++) expect(scale.update(10)).toBe(false);
  expect(scale.update(10)).toBe(true);
  expect(scale.mm).toBe(20);
});

test("a few large errors do not hide how large the others are", () => {
  const scale = new ErrorScale();
  scale.take({ max_mm: 2000, rmse_mm: 27 });
  expect(scale.mm).toBe(100);
  scale.take({ max_mm: 200, rmse_mm: 190 });
  expect(scale.mm).toBe(200);
});

test("lengths are written as people say them", () => {
  expect([0, 0.5, 2, 9.996, 20, 1250].map(millimetres)).toEqual(["0 mm", "0.5 mm", "2 mm", "10 mm", "20 mm", "1.3 m"]);
});

test("a comparison waits for the next original for a while, and a stream without originals is said to have none", () => {
  const comparing = new Comparing();
  const alone = { ...pair([100], [100]), original: null } as unknown as RangeFrame;
  const both = pair([100], [140]) as unknown as RangeFrame;
  comparing.opened(0);
  expect(comparing.passes(alone, 10)).toBe(true);
  expect([comparing.lacksOriginals(3000), comparing.lacksOriginals(3001)]).toEqual([false, true]);
  expect(comparing.passes(both, 4000)).toBe(true);
  comparing.take(both);
  expect([comparing.now?.max_mm, comparing.scale.mm]).toEqual([80, 100]);
  expect([comparing.passes(alone, 6999), comparing.passes(alone, 7000)]).toEqual([false, true]);
  comparing.take(null);
  expect([comparing.now, comparing.lacksOriginals(7000)]).toEqual([null, true]);
});
