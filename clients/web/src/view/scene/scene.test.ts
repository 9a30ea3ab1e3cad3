import { describe, expect, test } from "vitest";
import { Camera } from "../draw/camera";
import { between, identity, type Pose, transformed } from "../matrix";
import { pointOf } from "../measure/point";
import { parseFrame } from "../stream/frame";
import { type SensorEvent, sensorTable } from "../stream/sensor";
import { message } from "../testing";
import { checkedBox, countInside, THINNEST_M, WIDEST } from "./box";
import { type Mount, noteOf, Placing, place, poseOfMount } from "./mounts";

const RINGS = 64;
const list = (value: (ring: number) => number) => Array.from({ length: RINGS }, (_, ring) => value(ring));
const sensor: SensorEvent = {
  convention: "ros",
  rings: RINGS,
  range_step_m: 0.002,
  block: list((ring) => ring % 2),
  rot_correction_rad: list((ring) => 0.01 * (ring % 5)),
  vert_correction_rad: list((ring) => 0.03 - 0.007 * ring),
  dist_correction_m: list(() => 1.1),
  dist_correction_x_m: list(() => 1.3),
  dist_correction_y_m: list(() => 1.2),
  vert_offset_m: list(() => 0.2),
  horiz_offset_m: list(() => 0.03),
};
const ROOF: Mount = { x_m: 1.5, y_m: 0, z_m: 1.8, roll_deg: 0, pitch_deg: 0, yaw_deg: 90 };
const FRONT: Mount = { x_m: 3, y_m: 0.5, z_m: 0.6, roll_deg: 0, pitch_deg: 0, yaw_deg: 0 };

function moved(matrix: Float32Array, point: [number, number, number]): number[] {
  const out: [number, number, number, number] = [0, 0, 0, 0];
  transformed(out, matrix, point);
  return out.slice(0, 3).map((value) => Math.round(1e4 * value) / 1e4 + 0);
}

describe("the box", () => {
  test.each(["ros", "veloview"] as const)("counts the returns that the shader draws, with %s", (convention) => {
    const table = sensorTable({ ...sensor, convention });
    const frame = parseFrame(message({ columns: 32, filled: true }));
    frame.range.forEach((_, cell) => {
      frame.range[cell] = cell % 7 === 0 ? 0 : 500 + 37 * (cell % 400);
    });
    const at = identity();
    place(at, { vehicle: "a", mount: ROOF, pose: null, seen: null }, { vehicle: "a", mount: FRONT, pose: null });
    const box = { least: [-4, -30, -1], greatest: [25, 6, 3] } as const;
    let wanted = 0;
    for (let ring = 0; ring < RINGS; ring++)
      for (let column = 0; column < 32; column++) {
        const cell = ring * 32 + column;
        if (frame.range[cell] === 0 || frame.filled?.[cell]) continue;
        const out: [number, number, number, number] = [0, 0, 0, 0];
        transformed(out, at, pointOf(frame, table, ring, column, [0, 0, 0]));
        const above = [out[0], out[1], out[2] + 1.7];
        const inside = above.every(
          (value, axis) => value >= (box.least[axis] as number) && value <= (box.greatest[axis] as number),
        );
        if (inside) wanted++;
      }
    const found = countInside(frame, table, at, { least: [...box.least], greatest: [...box.greatest] }, -1.7);
    expect(wanted).toBeGreaterThan(100);
    expect(found).toBe(wanted);
  });

  test("what was kept or sent is brought into its limits, and what is no box is none", () => {
    expect(checkedBox({ least: [-500, 0, 0], greatest: [10, -5, 400] })).toEqual({
      least: [WIDEST.least[0], 0, 0],
      greatest: [10, THINNEST_M, WIDEST.greatest[2]],
    });
    for (const wrong of [null, 5, {}, { least: [0, 0, 0] }, { least: [0, 0], greatest: [1, 1, 1] }])
      expect(checkedBox(wrong)).toBeNull();
    expect(checkedBox({ least: [0, 0, Number.NaN], greatest: [1, 1, 1] })).toBeNull();
  });
});

describe("where another stream lies", () => {
  const pose = (x: number, y: number): Pose => new Float64Array([1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, 0]);
  const seat = (vehicle: string, mount: Mount | null, its: Pose | null) => ({ vehicle, mount, pose: its, seen: its });

  test("six numbers are the matrix that lidarcodec/mounting makes of them", () => {
    // Mounting(1, 2, 3, 10, 20, 30).T_vehicle_sensor
    const wanted = [
      0.8137976813, -0.4409696105, 0.3785223063, 1, 0.4698463104, 0.8825641192, 0.0180283112, 2, -0.3420201433,
      0.1631759112, 0.9254165784, 3,
    ];
    const found = poseOfMount({ x_m: 1, y_m: 2, z_m: 3, roll_deg: 10, pitch_deg: 20, yaw_deg: 30 });
    for (const [at, value] of wanted.entries()) expect(found[at]).toBeCloseTo(value, 9);
  });

  test("of one vehicle the mountings say it, seen from the chosen sensor", () => {
    const out = identity();
    expect(place(out, seat("a", ROOF, null), seat("a", FRONT, null))).toBe("mount");
    // 10 m ahead of the bumper is 13 m ahead of the origin: 11.5 m to the right of a roof sensor that looks left
    expect(moved(out, [10, 0, 0])).toEqual([0.5, -11.5, -1.2]);
  });

  test("each slab of a turn lies where its sensor was, as the chosen stream's do", () => {
    const placing = new Placing();
    const [main, newest, oldest] = [pose(4_000_000, 10), pose(4_000_005, 10), pose(4_000_003.5, 10)];
    placing.settle(seat("a", ROOF, main), seat("b", null, newest));
    expect(moved(placing.of(newest), [1, 0, 0])).toEqual([6, 0, 0]);
    expect(moved(placing.of(oldest), [1, 0, 0])).toEqual([4.5, 0, 0]);
    expect(moved(placing.of(null), [1, 0, 0])).toEqual([6, 0, 0]);
    placing.settle(seat("a", ROOF, null), seat("a", ROOF, newest));
    expect([placing.placed, moved(placing.of(oldest), [1, 0, 0])]).toEqual(["mount", [1, 0, 0]]);
  });

  test("by mountings it moves as the cloud of the chosen sensor does between two frames", () => {
    const out = identity();
    const [now, seen] = [pose(102, 50), pose(100, 50)];
    const main = { ...seat("a", FRONT, now), seen };
    expect(place(out, main, seat("a", { ...FRONT, y_m: -0.5 }, null))).toBe("mount");
    // a point that both see ahead: the chosen one's frame is 2 m older than the picture
    expect(moved(between(identity(), now, seen), [10, 0, 0])).toEqual([8, 0, 0]);
    expect(moved(out, [10, 1, 0])).toEqual([8, 0, 0]);
  });

  test("without a mounting it is at the vehicle's origin, and that is told", () => {
    const out = identity();
    const how = place(out, seat("a", FRONT, null), seat("a", null, null));
    expect(moved(out, [0, 0, 0])).toEqual([-3, -0.5, -0.6]);
    expect(noteOf(how, "a")).toBe("no mounting: drawn at the vehicle's origin");
  });

  test("poses of both win, also of another vehicle; without them that is a guess, and told", () => {
    const out = identity();
    const how = place(out, seat("a", ROOF, pose(4_000_000, 10)), seat("b", null, pose(4_000_005, 10)));
    expect([how, noteOf(how, "a")]).toEqual(["pose", ""]);
    expect(moved(out, [1, 0, 0])).toEqual([6, 0, 0]);
    const guess = place(out, seat("a", null, null), seat("b", null, pose(1, 1)));
    expect(noteOf(guess, "a")).toBe("no pose: drawn as if it were on a");
  });
});

test("a camera that is sent somewhere goes there within its limits, the shorter way round", () => {
  const camera = new Camera();
  camera.reset("orbit", true);
  camera.send({ yaw: 9 * Math.PI, pitch: 3, distance: 5000, x: 20, y: -900, z: 0 });
  for (let step = 0; step < 200; step++) camera.move(0.1);
  expect(camera.stand).toMatchObject({ pitch: 1.55, distance: 400, x: 20, y: -300 });
  expect(Math.cos(camera.stand.yaw)).toBeCloseTo(-1);
});
