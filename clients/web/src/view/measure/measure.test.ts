import { describe, expect, test } from "vitest";
import { identity, type Pose } from "../matrix";
import { parseFrame } from "../stream/frame";
import { type SensorEvent, sensorTable } from "../stream/sensor";
import { message } from "../testing";
import { MISSED, rows } from "./panel";
import { pick } from "./pick";
import { pointOf } from "./point";
import { onScreen, Ruler } from "./ruler";

const RINGS = 64;
const list = (value: number) => Array.from({ length: RINGS }, () => value);

function table(changed: Partial<SensorEvent> = {}) {
  return sensorTable({
    convention: "ros",
    rings: RINGS,
    range_step_m: 0.002,
    block: list(0),
    rot_correction_rad: list(0),
    vert_correction_rad: list(0),
    dist_correction_m: list(0),
    dist_correction_x_m: list(0),
    dist_correction_y_m: list(0),
    vert_offset_m: list(0),
    horiz_offset_m: list(0),
    ...changed,
  });
}

function frame(ranges: [ring: number, column: number, steps: number][], azimuths = [0, 9000]) {
  const made = parseFrame(message({ columns: 2, intensity: true, pose: true }));
  made.range.fill(0);
  for (const [ring, column, steps] of ranges) made.range[ring * 2 + column] = steps;
  made.azimuth.set([...azimuths, ...azimuths]);
  return made;
}

const near = (got: readonly number[], wanted: number[]) =>
  wanted.forEach((value, at) => {
    expect(got[at]).toBeCloseTo(value, 5);
  });

describe("a return as a point", () => {
  test("straight ahead is x, a quarter of a turn clockwise is to the right", () => {
    const one = frame([
      [0, 0, 5000],
      [0, 1, 5000],
    ]);
    near(pointOf(one, table(), 0, 0, [0, 0, 0]), [10, 0, 0]);
    near(pointOf(one, table(), 0, 1, [0, 0, 0]), [0, -10, 0]);
  });

  test("corrections of the beam count: elevation, distance, offsets", () => {
    const one = frame([[3, 0, 5000]]);
    const up = table({ convention: "veloview", vert_correction_rad: list(Math.PI / 6), dist_correction_m: list(2) });
    near(pointOf(one, up, 3, 0, [0, 0, 0]), [12 * Math.cos(Math.PI / 6), 0, 6]);
    const aside = table({ vert_offset_m: list(0.2), horiz_offset_m: list(0.03) });
    near(pointOf(one, aside, 3, 0, [0, 0, 0]), [10, 0.03, 0.2]);
  });

  test("near returns get the correction of two targets, as the shader and docs/live-sockets.md have it", () => {
    const one = frame([[0, 0, 5000]]);
    const corrected = table({
      dist_correction_m: list(1),
      dist_correction_x_m: list(1.5),
      dist_correction_y_m: list(1),
    });
    // along x the slope is that of the column x of the table: 0.5 m over 25.04 - 2.40 m, at |y|
    const [x] = pointOf(one, corrected, 0, 0, [0, 0, 0]);
    expect(x).toBeCloseTo(11, 5);
  });
});

describe("picking", () => {
  const spot = { x: 0, y: 0, reachX: 0.1, reachY: 0.1 };
  /** A camera at the origin that looks along x: right is -y, up is z, depth is x. */
  const ahead = identity().fill(0);
  ahead[4] = -1; // screen x = -y
  ahead[9] = 1; // screen y = z
  ahead[3] = 1; // w = x

  test("of returns in one line, the nearest one is meant, and what is beside is not", () => {
    const one = frame([
      [0, 0, 9000],
      [1, 0, 4000],
      [2, 1, 1000],
    ]);
    const found = pick([{ frame: one, table: table(), view: ahead }], spot);
    expect(found).toMatchObject({ ring: 1, column: 0, azimuth: 0, madeUp: false });
    expect(found?.intensity).toBe(one.intensity?.[2]);
    expect(pick([{ frame: one, table: table(), view: ahead }], { ...spot, x: 0.5 })).toBeNull();
  });

  test("a return of another stream is where that lies in the picture, and says of which it is", () => {
    const place = identity();
    place[12] = 3; // its sensor sits 3 m ahead
    const pose = new Float64Array([1, 0, 0, 100, 0, 1, 0, 0, 0, 0, 1, 0]) as Pose;
    const near = frame([[0, 0, 1000]]);
    const guest = { frame: near, table: table(), view: ahead, stream: { name: "car-7/front", place, pose } };
    const own = { frame: frame([[0, 0, 2000]]), table: table(), view: ahead };
    const found = pick([own, guest], spot);
    expect(found).toMatchObject({ stream: "car-7/front", pose });
    expect(found?.distance).toBeCloseTo(2, 5);
    expect(found?.point[0]).toBeCloseTo(5, 5);
    expect(rows(found ? [found] : [], 0, null)).toContainEqual(["stream", "car-7/front"]);
    // what the box leaves out cannot be picked: the one behind it is
    expect(pick([own, guest], spot, ([x]) => x < 4.5)).toMatchObject({ stream: null, ring: 0 });
  });

  test("a cell without a return is never picked", () => {
    expect(pick([{ frame: frame([]), table: table(), view: ahead }], spot)).toBeNull();
  });
});

describe("the ruler", () => {
  const at = (x: number, y: number, z: number, east: number) => ({
    stream: null,
    distance: Math.hypot(x, y, z),
    point: [x, y, z] as [number, number, number],
    pose: new Float64Array([1, 0, 0, east, 0, 1, 0, 0, 0, 0, 1, 0]) as Pose,
    frameIndex: 1,
    intensity: 7,
    ring: 2,
    column: 3,
    azimuth: 0,
    madeUp: true,
  });

  test("measures between places in the world, also when the vehicle drove on between the clicks", () => {
    const ruler = new Ruler();
    ruler.take(at(10, 0, 0, 100));
    expect(ruler.between).toBeNull();
    ruler.take(at(5, 3, 4, 105)); // the first is at 5, 0, 0 from here
    expect(ruler.between).toEqual({ distance: 5, flat: 3, up: 4, uncertain: false });
    ruler.take(at(1, 1, 1, 105));
    expect(ruler.picked).toHaveLength(1);
  });

  test("what is made up is said to be so, beside the fields", () => {
    const told = rows([at(10, 0, 0, 100)], -1.7, null);
    expect(told).toContainEqual(["above the road", "1.70 m"]);
    expect(told).toContainEqual(["", "filled in"]);
  });

  test("a click that meets no point is told, and what was picked stays", () => {
    expect(rows([], 0, null, true)).toEqual([[MISSED]]);
    const told = rows([at(10, 0, 0, 100)], -1.7, null, true);
    expect(told).toContainEqual([MISSED]);
    expect(told).toContainEqual(["above the road", "1.70 m"]);
  });

  test("of two frames without a pose nobody can say, and that is told", () => {
    const ruler = new Ruler();
    for (const frameIndex of [4, 5]) ruler.take({ ...at(1, 0, 0, 0), pose: null, frameIndex });
    expect(ruler.between?.uncertain).toBe(true);
    expect(rows(ruler.picked, 0, ruler.between).flat().join()).toContain("Wrong if the vehicle moved");
    for (const frameIndex of [6, 6]) ruler.take({ ...at(1, 0, 0, 0), pose: null, frameIndex });
    expect(ruler.between?.uncertain).toBe(false);
  });

  test("what is behind the camera is on no screen", () => {
    const view = identity();
    view[15] = -1;
    expect(onScreen(view, [0, 0, 0])).toBeNull();
  });
});
