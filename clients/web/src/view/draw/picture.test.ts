import { expect, test } from "vitest";
import { fitted } from "./picture";

/** Letters are half as wide as high. */
const pen = () => ({
  font: "",
  measureText(text: string) {
    return { width: (text.length * Number.parseFloat(this.font)) / 2 } as TextMetrics;
  },
});
const SIZE = 12;
const high = (lines: number) => SIZE * (1.4 * lines + 0.6);

test("the parts of a caption stand in lines that fit", () => {
  const { size, lines } = fitted(pen(), "car-7/roof · frame 7 · pcodec · 100 points", 160, high(2), SIZE);
  expect(lines).toEqual(["car-7/roof · frame 7", "pcodec · 100 points"]);
  expect(size).toBe(SIZE);
});

test("a part that is longer than a line is broken, and nothing falls off", () => {
  const caption = "car-7 · with car-8: 5 points, no pose: drawn as if it were on car-7 · frame 7";
  const { lines } = fitted(pen(), caption, 160, high(4), SIZE);
  expect(Math.max(...lines.map(({ length }) => length))).toBeLessThanOrEqual(24);
  expect(lines.join(" ").replaceAll(" · ", " ")).toBe(caption.replaceAll(" · ", " "));
});

test("a caption that gets longer than its clip has room for gets smaller letters, and stays whole", () => {
  const parts = [
    "car-7/roof",
    "The picture is old: the vehicle is not connected.",
    "frame 7",
    "1,000 filled in",
    "box: 1 of 2 points",
  ];
  const { size, lines } = fitted(pen(), parts.join(" · "), 260, high(2), SIZE);
  expect(size).toBeLessThan(SIZE);
  expect(size * (1.4 * lines.length + 0.6)).toBeLessThanOrEqual(high(2) + 1);
  for (const part of parts) expect(lines.some((line) => line.includes(part))).toBe(true);
});
