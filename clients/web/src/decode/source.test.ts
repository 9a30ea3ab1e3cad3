import { expect, test } from "vitest";
import { afterRefusal } from "./source";

const RIDDLE = 10;
const PREDICTIVE = 11;
const JPEG = 6;

test("what the page refused it does not ask for again and again, each time with a key frame", () => {
  const another = afterRefusal();
  expect([1, 2, 3].map(() => another({ codec: RIDDLE, streamId: "a" }))).toEqual([false, false, false]);
  expect(another({ codec: JPEG, streamId: "a" })).toBe(false);
  expect(another({ codec: PREDICTIVE, streamId: "a" })).toBe(true);
  expect(another({ codec: RIDDLE, streamId: "b" })).toBe(true);
});
