import { expect, test } from "vitest";
import { HIDDEN_MS, waitOf } from "./poll";

test("a page that nobody sees asks seldom, and a server that is away is asked less often", () => {
  expect(waitOf(1000, 0, false)).toBe(1000);
  expect(waitOf(500, 0, true)).toBe(HIDDEN_MS);
  expect([1, 2, 3, 4, 50].map((failures) => waitOf(500, failures, false))).toEqual([1000, 1000, 2000, 4000, 4000]);
});
