import { expect, test } from "vitest";
import { captionOf, pictureName } from "./caption";

test("a saved picture says what it shows, when, and what of it was not measured", () => {
  const told = { points: 105_147, madeUp: 4000, frameIndex: 7, inBox: null, allPoints: 105_147, streams: [] };
  expect(captionOf("car-7/lidar", told, "pcodec", 1.767e12, "")).toBe(
    "car-7/lidar · 2025-12-29 09:20:00.000Z · frame 7 · pcodec · 105,147 points measured · 4,000 filled in",
  );
  expect(captionOf("car-7/lidar", { ...told, madeUp: 0 }, null, 0, "last frame 9 s ago")).toMatch(
    /^car-7\/lidar · last frame 9 s ago · .* · frame 7 · 105,147 points measured$/,
  );
  expect(pictureName("car-7/lidar", 7)).toBe("car-7_lidar_7.png");
  expect(pictureName("car-7/lidar", null, "webm")).toBe("car-7_lidar_0.webm");
});

test("other streams in the picture are named with their points and with what makes them doubtful", () => {
  const row = (name: string, points: number, note: string) => ({ name, points, note, colour: [1, 1, 1] as const });
  const streams = [
    row("car-7/roof", 100_000, "no mounting: drawn at the vehicle's origin"),
    row("car-7/left", 2345, "no frame for 60 s"),
    row("car-7/rear", 20_000, ""),
    row("car-8/roof", 90_000, "no pose: drawn as if it were on car-7"),
  ];
  const told = { points: 100_000, madeUp: 0, frameIndex: 7, inBox: 1200, allPoints: 212_345, streams };
  expect(captionOf("car-7/roof", told, null, 0, "").split(" · ")).toEqual([
    "car-7/roof",
    "no mounting: drawn at the vehicle's origin",
    "1970-01-01 00:00:00.000Z",
    "frame 7",
    "100,000 points measured",
    "with car-7/left: 2,345 points, no frame for 60 s",
    "with car-7/rear: 20,000 points",
    "with car-8/roof: 90,000 points, no pose: drawn as if it were on car-7",
    "box: 1,200 of 212,345 points",
  ]);
});
