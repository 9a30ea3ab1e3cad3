import { expect, test } from "vitest";
import { bytes, carried, clock, kbps, label, moment, ms, ordinal, plain, span } from "./format";

test("figures are short, and a dash stands for what is not known", () => {
  expect([kbps(null), kbps(3120.4), kbps(12_400)]).toEqual(["–", "3,120", "12,400"]);
  expect([ms(undefined), ms(3.21), ms(1234.5)]).toEqual(["–", "3.2 ms", "1,235 ms"]);
  expect([bytes(12), bytes(999_950), bytes(4_200_000)]).toEqual(["12 B", "1000 kB", "4.2 MB"]);
  expect([span(4.9), span(120), span(7200), span(200_000)]).toEqual(["4 s", "2 min", "2 h", "2 d"]);
  expect([clock(42.9), clock(3723)]).toEqual(["0:42", "1:02:03"]);
});

test("a moment of today has no date", () => {
  const now = new Date(2026, 10, 21, 12);
  expect(moment(new Date(2026, 10, 21, 10, 5, 6).toISOString(), now)).toBe("10:05:06");
  expect(moment(new Date(2026, 10, 20, 10, 5, 6).toISOString(), now)).toBe("2026-11-20 10:05:06");
});

test("settings are told as people read them", () => {
  expect([label("max_error_m"), label("target_kbps"), label("mask_history")]).toEqual([
    "Max error (m)",
    "Target (kbit/s)",
    "Mask history",
  ]);
  expect([plain(null), plain({}), plain({ level: 3, fast: true })]).toEqual(["–", "defaults", "level=3, fast=true"]);
});

test("which column is sent is said in English", () => {
  expect([1, 2, 3, 4, 11, 12, 13, 21, 32].map(ordinal)).toEqual([
    "1st",
    "2nd",
    "3rd",
    "4th",
    "11th",
    "12th",
    "13th",
    "21st",
    "32nd",
  ]);
});

test("what the path carries is told, for long where that is less", () => {
  expect(carried({ capacity_kbps: 9000.4, sustained_kbps: 2100 })).toBe(
    "The path carries 2,100 kbit/s for long; bursts pass at 9,000.",
  );
  expect(carried({ capacity_kbps: 9000, sustained_kbps: null })).toBe("The path carries 9,000 kbit/s.");
  expect([carried({ capacity_kbps: null, sustained_kbps: null }), carried(undefined)]).toEqual(["", ""]);
});
