import { expect, test } from "vitest";
import { titleOf } from "./title";

test("the title tells the points in plain digits, once there are any", () => {
  expect(titleOf(0)).toBe("lidarcodec");
  expect(titleOf(118234)).toBe("lidarcodec — 118234 points");
});
