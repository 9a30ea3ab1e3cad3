import { expect, test } from "vitest";
import { outcomeOf, sentenceOf } from "./outcome";

test("what became of a change says from which frame on, and whether that frame is shown", () => {
  const change = { codec: "jxl" };
  const applied = outcomeOf(200, { applied: change, desired: change, first_frame: 812 }, change);
  expect(sentenceOf(applied, 800)).toBe("Applied from frame 812 on: codec = jxl.");
  expect(sentenceOf(applied, 812)).toBe("Applied from frame 812 on (now shown): codec = jxl.");
  const kept = outcomeOf(202, { applied: null, desired: change, first_frame: null }, change);
  expect(sentenceOf(kept, null)).toContain("The vehicle is not connected");
  expect(sentenceOf({ kind: "refused", text: "no such codec", field: "codec", status: 422 }, null)).toBe(
    "Refused: no such codec",
  );
});
