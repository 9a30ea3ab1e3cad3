import { describe, expect, test } from "vitest";
import { MAPS, mapOf, STEPS } from "./colours";

const light = (map: Uint8Array, step: number) => {
  const part = (at: number) => {
    const value = (map[4 * step + at] as number) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  };
  return 0.2126 * part(0) + 0.7152 * part(1) + 0.0722 * part(2);
};

describe.each([true, false])("colour maps on a dark ground: %s", (dark) => {
  test.each(MAPS)("%s can be told from the ground at every step", (name) => {
    const map = mapOf(name, dark);
    for (let step = 0; step < STEPS; step++) {
      const contrast = dark ? (light(map, step) + 0.05) / 0.0585 : 1.02 / (light(map, step) + 0.05);
      expect(contrast, `step ${step}`).toBeGreaterThan(1.5);
    }
  });

  test.each(MAPS)("%s has no jump that would look like an edge", (name) => {
    const map = mapOf(name, dark);
    for (let at = 0; at < 4 * (STEPS - 1); at++) {
      expect(Math.abs((map[at + 4] as number) - (map[at] as number)), `step ${at >> 2}`).toBeLessThan(16);
    }
  });

  test("the ends of a scale are colours of their own", () => {
    for (const name of ["height", "intensity", "distance", "error"] as const) {
      const map = mapOf(name, dark);
      expect(Math.abs(light(map, 0) - light(map, STEPS - 1)), name).toBeGreaterThan(0.08);
    }
  });
});
