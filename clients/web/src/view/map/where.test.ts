import { expect, test } from "vitest";
import { type PoseEvent, Where } from "./where";

const told = (x: number, stampMs: number, more: Partial<PoseEvent> = {}): PoseEvent => ({
  receiver: "car",
  stamp_ns: stampMs * 1e6,
  state: "tracking",
  map: "town",
  T_world_sensor: [0, -1, 0, x, 1, 0, 0, 2, 0, 0, 1, 0],
  sigma_m: [0.01, 0.02, 0.005],
  sigma_deg: [0.01, 0.1, 0.2],
  ...more,
});
const lost = (map = "town", receiver = "car"): PoseEvent =>
  told(0, 1000, { state: "lost", map, receiver, T_world_sensor: null, sigma_m: null, sigma_deg: null });

test("the pose is told with the largest deviations, and is carried on to the newest frame", () => {
  const where = new Where();
  where.frame(1000);
  where.take(told(3, 1050), 0);
  expect(where.line("town", 10)).toBe("In map town: x 3.00 m, y 2.00 m, yaw 90.0° ± 2.0 cm, ± 0.20°");
  expect(where.pose("town", 10)?.[3]).toBe(3);
  where.frame(1100);
  where.take(told(4, 1150), 100);
  where.frame(1200); // the pose of this frame, 1250, has not come: a metre in 100 ms, on from 1150
  expect(where.pose("town", 110)?.[3]).toBeCloseTo(5);
  where.frame(1300 + 500);
  expect(where.pose("town", 120)).toBeNull();
});

test("the stamps of one program do not move what another one says", () => {
  const where = new Where();
  for (let at = 0; at < 12; at++) {
    where.frame(1000 + 100 * at);
    where.take(told(3 + at, 1050 + 100 * at), 100 * at); // stamps the middle of the returns, 50 ms after the first
    where.take(told(9, 1000 + 100 * at, { map: "village", receiver: "two" }), 100 * at);
  }
  where.frame(2200); // the pose of this frame is that of 2250: a metre on from 2150
  expect(where.pose("town", 1110)?.[3]).toBeCloseTo(15);
});

test("one wrong stamp counts for a few poses only", () => {
  const where = new Where();
  where.frame(900);
  where.take(told(2, 900), 0);
  for (let at = 0; at < 12; at++) {
    where.frame(1000 + 100 * at);
    where.take(told(3 + at, 1050 + 100 * at), 100 * (at + 1));
  }
  where.frame(2200);
  expect(where.pose("town", 1310)?.[3]).toBeCloseTo(15);
});

test("lost is told as lost, and a program that is silent says nothing any more", () => {
  const where = new Where();
  where.take(told(3, 1000), 0);
  where.take(lost(), 100);
  expect(where.line("town", 110)).toBe("Lost in map town");
  expect([where.lost("town", 110), where.said("town", 110), where.pose("town", 110)]).toEqual([true, true, null]);
  expect([where.line("town", 2200), where.lost("town", 2200), where.said("town", 2200)]).toEqual(["", false, false]);
});

test("what is said of the map that is drawn counts before poses in others", () => {
  const where = new Where();
  where.take(lost("town", "one"), 0);
  where.take(told(7, 1000, { map: "village", receiver: "two" }), 0);
  expect(where.line("town", 10)).toBe("Lost in map town");
  expect(where.line(null, 10)).toContain("In map village: x 7.00 m");
  expect([where.said("village", 10), where.said("hamlet", 10)]).toEqual([true, false]);
});

test("no flood of programs takes memory", () => {
  const where = new Where();
  for (let at = 0; at < 100; at++) where.take(told(at, 1000, { receiver: `car-${at}` }), 0);
  expect(where.line(null, 0)).toContain("x 0.00 m");
  for (let at = 0; at < 100; at++) where.take(told(at, 9000, { receiver: `bus-${at}` }), 9000);
  expect(where.line(null, 9000)).toContain("x 0.00 m");
});
