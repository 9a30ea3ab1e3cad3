import { expect, test } from "vitest";
import { captionOf, pictureName } from "./caption";

test("a saved picture says what it shows, when, and what of it was not measured", () => {
  const told = { points: 105_147, madeUp: 4000, frameIndex: 7, inBox: null, allPoints: 105_147 };
  expect(captionOf("car-7/lidar", told, "pcodec", 1.767e12, "")).toBe(
    "car-7/lidar · 2025-12-29 09:20:00.000Z · frame 7 · pcodec · 105,147 points measured · 4,000 filled in",
  );
  expect(captionOf("car-7/lidar", { ...told, madeUp: 0 }, null, 0, "last frame 9 s ago")).toMatch(
    /frame 7 · 105,147 points measured · last frame 9 s ago$/,
  );
  const boxed = { ...told, inBox: 1200, allPoints: 210_000 };
  expect(captionOf("car-7/lidar", boxed, null, 0, "", ["car-7/left", "car-8/lidar"])).toMatch(
    /^car-7\/lidar with car-7\/left, car-8\/lidar · .* · box: 1,200 of 210,000 points$/,
  );
  expect(pictureName("car-7/lidar", 7)).toBe("car-7_lidar_7.png");
  expect(pictureName("car-7/lidar", null, "webm")).toBe("car-7_lidar_0.webm");
});
