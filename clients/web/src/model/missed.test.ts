import { describe, expect, it } from "vitest";
import { freed, headOf, Steady, sentence } from "./missed";
import type { TargetWarning } from "./wire";

const warning = (code: string, settings: string[] = []): TargetWarning => ({
  code,
  message: "m",
  remedy: "r",
  settings,
});

describe("a target that is not kept", () => {
  it("is said at once where the settings say so, and else when it lasts", () => {
    expect(new Steady().take(warning("target_out_of_reach"), 0)?.code).toBe("target_out_of_reach");
    const steady = new Steady();
    expect(steady.take(warning("target_missed"), 0)).toBeNull();
    expect(steady.take(null, 1000)).toBeNull();
    expect(steady.take(warning("target_missed"), 2000)).toBeNull();
    expect(steady.take(warning("target_missed"), 4900)).toBeNull();
    expect(steady.take(warning("target_missed"), 5000)?.code).toBe("target_missed");
  });

  it("stays while it changes its kind, and for a moment in which all is well", () => {
    const steady = new Steady();
    steady.take(warning("target_out_of_reach"), 0);
    expect(steady.take(warning("frames_left_out"), 1000)?.code).toBe("frames_left_out");
    expect(steady.take(null, 2000)?.code).toBe("frames_left_out");
    expect(steady.take(warning("target_missed"), 3000)?.code).toBe("target_missed");
    expect(steady.take(null, 4000)).not.toBeNull();
    expect(steady.take(null, 7000)).toBeNull();
  });

  it("names the settings that are in the way as the form does", () => {
    expect(headOf(warning("target_missed"))).toBe("Target missed");
    expect(headOf(warning("target_missed", ["max_error_m"]))).toBe("Target missed: Max error (m) is in the way");
    const many = warning("frames_left_out", ["max_error_m", "intensity", "codec_settings.quality"]);
    expect(headOf(many)).toBe("Frames are left out: Max error (m), Intensity and Quality are in the way");
    expect(headOf(warning("two_publishers"))).toBe("Two publishers have one name");
    expect(headOf(warning("of a newer server"))).toBe("Target not kept");
    expect(sentence("set it back")).toBe("Set it back.");
  });

  it("is mended by what the schema says is not set, and by nothing else", () => {
    const schema = { properties: { intensity: { default: "auto" }, reduction: { default: "auto" }, max_error_m: {} } };
    const settings = { reduction: "voxel", keep_points: 9000, codec_settings: { quality: 90, effort: 2 } };
    expect(freed(["intensity", "max_error_m"], settings, schema)).toEqual({ intensity: "auto", max_error_m: null });
    expect(freed(["reduction"], settings, schema)).toEqual({ reduction: "auto", keep_points: null });
    expect(freed(["codec_settings.quality"], settings, schema)).toEqual({ codec_settings: { effort: 2 } });
  });
});
