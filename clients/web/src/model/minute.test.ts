import { expect, test } from "vitest";
import { added, LENGTH, lacks, path, targetLine } from "./minute";
import type { FleetRow } from "./wire";

const row = (vehicle: string, kbps: number | null, minute: (number | null)[] | null = null) =>
  ({ vehicle, sensor: "roof", kbps, minute }) as FleetRow;

test("a minute is asked for once and then grows by each answer, to sixty values", () => {
  expect(lacks(new Map(), [row("a", 1)])).toBe(true);
  let minutes = added(new Map(), [row("a", 5, Array(LENGTH).fill(1))]);
  expect(lacks(minutes, [row("a", 1)])).toBe(false);
  minutes = added(minutes, [row("a", 7), row("b", 3)]);
  expect(minutes.get("a/roof")).toHaveLength(LENGTH);
  expect(minutes.get("a/roof")?.at(-1)).toBe(7);
  expect(minutes.has("b/roof")).toBe(false);
  expect(added(minutes, []).size).toBe(0);
});

test("a sparkline has gaps where nothing is known, and ends at the right", () => {
  const drawn = path([10, null, 20, 20], 59, 10, null);
  expect(drawn.match(/M/g)).toHaveLength(2);
  expect(drawn).toContain("M56.0 ");
  expect(drawn).toContain("L59.0 ");
  expect(path([], 59, 10, null)).toBe("");
});

test("a target that is not reached stands above the line", () => {
  const y = Number(path([1000], 59, 10, 4000).split(" ")[1]);
  expect(targetLine([1000], 10, 4000)).toBeLessThan(y);
});
