import { expect, test } from "vitest";
import { fillsFor } from "./filling";

test("gaps are filled for people who look, and not in recordings or for programs", () => {
  const live = { playback: null };
  expect(fillsFor(null, null)).toBe(true);
  expect(fillsFor(live, { settings: null })).toBe(true);
  for (const purpose of ["look", "archive"]) expect(fillsFor(live, { settings: { purpose } })).toBe(true);
  for (const purpose of ["localise", "detect"]) expect(fillsFor(live, { settings: { purpose } })).toBe(false);
  expect(fillsFor({ playback: "20261124-1" }, { settings: { purpose: "look" } })).toBe(false);
});
