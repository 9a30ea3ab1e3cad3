import { expect, test } from "vitest";
import { coded, missing, NOTHING, searchPath } from "./search";

test("fields that are empty do not choose", () => {
  expect(searchPath(NOTHING)).toBe("api/v1/archive?limit=20");
});

test("a search has vehicle, time and place, and goes on", () => {
  const path = searchPath(
    { vehicle: " car-7 ", from: "2026-11-26T12:00", to: "", x: "10", y: "-2.5", radius: "50" },
    "7-a",
  );
  const query = new URLSearchParams(path.split("?")[1]);
  expect(query.get("vehicle")).toBe("car-7");
  expect(query.get("from")).toBe(new Date("2026-11-26T12:00").toISOString());
  expect(query.has("to")).toBe(false);
  expect([query.get("around"), query.get("radius"), query.get("after")]).toEqual(["10,-2.5", "50", "7-a"]);
});

test("half a place, and a place that is no number, are said", () => {
  expect(() => searchPath({ ...NOTHING, x: "1" })).toThrow("X and Y");
  expect(() => searchPath({ ...NOTHING, x: "1", y: "north" })).toThrow("numbers");
});

test("a list that may be incomplete says so", () => {
  expect(missing(0)).toBeNull();
  expect(missing(1)).toContain("1 segment.");
  expect(missing(2)).toContain("2 segments.");
});

test("a bound is told in millimetres", () => {
  expect(coded("pcodec", 0)).toBe("pcodec, lossless");
  expect(coded("pcodec", 0.02)).toBe("pcodec, within 20 mm");
  expect(coded("png", null)).toBe("png, no bound");
});
