import { expect, test } from "vitest";
import type { Recording } from "../model/wire";
import {
  asOf,
  barsOf,
  type Clip,
  lastOf,
  obstacle,
  partsOf,
  percentOf,
  recorded,
  rowText,
  type Span,
  secondsOf,
  stateText,
} from "./spans";

const SECOND = 1e9;
const at = (seconds: number) => 1_700_000_000 * SECOND + seconds * SECOND;

function clip(changes: Partial<Clip>): Clip {
  const span = { from_ns: at(0), to_ns: at(30), clip: null, gaps: [], missing_frames: 0, playing: null };
  return {
    id: "20261126T120000Z-3fa2c9",
    vehicle: "car-7",
    sensor: "roof",
    state: "running",
    by: "me",
    reason: null,
    size_bytes: 0,
    progress: null,
    ...span,
    ...changes,
  };
}

test("the last seconds end with the newest frame that the vehicle keeps, by its own clock", () => {
  const kept = {
    vehicle: [[at(-50), at(-40)] as Span, [at(-30), at(7)] as Span],
    age_s: 0,
    here: [],
    marks: [],
  };
  expect(lastOf(kept, 30)).toEqual({ from: "1699999977000000000", to: "1700000007000000000" });
  const parked: Span[] = [
    [at(-5), at(7)],
    [at(-50), at(-40)],
  ];
  expect(lastOf({ ...kept, vehicle: parked }, 30)).toEqual({ from: "1699999995000000000", to: "1700000007000000000" });
  expect(lastOf({ ...kept, vehicle: [[at(7), at(7)]] }, 30)?.from).toBe("1700000006999000000");
  expect(lastOf({ ...kept, vehicle: null }, 30)).toBeNull();
  expect(lastOf(null, 30)).toBeNull();
});

test("what a vehicle told a while ago is shown with its time, and is not fetched as the last seconds", () => {
  const told = { kept: { vehicle: [[at(0), at(60)] as Span], age_s: 0, here: [], marks: [] }, toldMs: 1_000_000 };
  expect([asOf(told, 1_010_000), obstacle(told, 1_010_000)]).toEqual(["", null]);
  expect(asOf(told, 1_030_000)).toMatch(/^ as of .*\d\d:\d\d:\d\d$/);
  expect(obstacle(told, 1_030_000)).toBeNull();
  expect(obstacle(told, 1_700_000)).toMatch(/^The vehicle does not answer: what is shown is what it kept as of .*\.$/);
  expect(obstacle({ ...told, toldMs: null }, 1_010_000)).toContain("not known");
  expect(obstacle(null, 1_010_000)).toContain("not known");
  expect(asOf(null, 1_010_000)).toBe("");
});

test("a time line shows what is inside it, and short clips can be seen", () => {
  const line: [number, number] = [at(0) / 1e6, at(100) / 1e6];
  expect(barsOf([[at(-10), at(25)]], ...line)).toEqual([{ left: 0, width: 25 }]);
  expect(barsOf([[at(-10), at(-1)]], ...line)).toEqual([]);
  const [end] = barsOf([[at(99.99), at(100)]], ...line);
  expect((end?.left ?? 0) + (end?.width ?? 0)).toBeCloseTo(100);
  expect(end?.width).toBeGreaterThan(0.1);
});

test("what overlaps counts once, and nothing is said to be nothing", () => {
  expect(
    secondsOf([
      [at(0), at(20)],
      [at(10), at(30)],
      [at(40), at(50)],
    ]),
  ).toBe(40);
  expect(rowText([])).toBe("nothing");
  expect(
    rowText([
      [at(0), at(20)],
      [at(60), at(80)],
    ]),
  ).toMatch(/^40 s in 2 parts, .* to /);
});

test("a recording that was interrupted has no known end, and is not shown as if it went on", () => {
  const one = { vehicle: "car-7", sensor: "roof", started: "2026-11-26T12:00:00Z", ended: null } as Recording;
  const now = Date.parse("2026-11-26T12:00:10Z");
  expect(secondsOf(recorded([{ ...one, state: "recording" }], "car-7", "roof", now))).toBe(10);
  expect(recorded([{ ...one, state: "interrupted" }], "car-7", "roof", now)).toEqual([]);
  expect(recorded([{ ...one, state: "recording" }], "car-7", "front", now)).toEqual([]);
});

test("a clip of which the vehicle kept a part only does not claim the rest", () => {
  const gaps: Span[] = [
    [at(0), at(10)],
    [at(12), at(20)],
  ];
  const one = clip({ state: "complete", size_bytes: 8_000_000, gaps });
  expect(partsOf(one)).toEqual([
    [at(10), at(12)],
    [at(20), at(30)],
  ]);
  expect(stateText(one)).toBe("12.0 of 30.0 s are here, exactly: 8.0 MB. The vehicle has nothing of the rest.");
  expect(stateText({ ...one, gaps: [] })).toBe("Here, exactly: 8.0 MB.");
  expect(stateText({ ...one, gaps: [], missing_frames: 12 })).toBe(
    "Here, exactly: 8.0 MB. 12 frames in between are missing: the vehicle did not keep them.",
  );
  const progress = { listed: true, bytes: 1, bytes_done: 0, gaps: [[at(0), at(18)] as Span], waiting: null };
  expect(partsOf(clip({ progress }))).toEqual([[at(18), at(30)]]);
});

test("a fetch says how far it is, what it waits for, and why it failed", () => {
  const progress = { listed: true, bytes: 2_000_000, bytes_done: 500_000, gaps: [], waiting: null };
  expect(percentOf(progress)).toBe(25);
  expect(stateText(clip({ progress }))).toBe("Fetching: 25 % of 2.0 MB.");
  expect(stateText(clip({ progress: { ...progress, waiting: "for the vehicle to answer" } }))).toBe(
    "Waiting for the vehicle to answer, 25 % are here.",
  );
  expect(percentOf({ ...progress, listed: false })).toBeNull();
  expect(stateText(clip({ progress: null }))).toContain("Asking the vehicle");
  expect(stateText(clip({ state: "failed", reason: "it kept nothing" }))).toBe("Failed: it kept nothing");
});
