import { describe, expect, test } from "vitest";
import { between, identity, lookAt, type Matrix, multiply, perspective, type Vector } from "../matrix";
import { Camera } from "./camera";

function seen(camera: Camera, point: Vector, aspect = 1.6): Vector {
  const view = identity();
  const projection = identity();
  camera.matrices(view, projection, aspect, -1.73);
  return through(multiply(identity(), projection, view), point);
}

function through(matrix: Matrix, [x, y, z]: Vector): Vector {
  const row = (at: number) =>
    (matrix[at] as number) * x +
    (matrix[at + 4] as number) * y +
    (matrix[at + 8] as number) * z +
    (matrix[at + 12] as number);
  return [row(0) / row(3), row(1) / row(3), row(2) / row(3)];
}

const settle = (camera: Camera) => {
  for (let turn = 0; turn < 400 && camera.move(0.016); turn++);
};

describe("the camera", () => {
  test("following stands behind the vehicle: ahead is up, left is left", () => {
    const camera = new Camera();
    camera.reset("follow", true);
    const [x, near] = seen(camera, [0, 0, -1.73]);
    const [, far] = seen(camera, [40, 0, -1.73]);
    expect(x).toBeCloseTo(0);
    expect(far).toBeGreaterThan(near);
    expect(seen(camera, [20, 5, 0])[0]).toBeLessThan(0);
    expect(seen(camera, [20, 0, 3])[1]).toBeGreaterThan(seen(camera, [20, 0, 0])[1]);
  });

  test("orbiting stays where it is while the vehicle turns below it", () => {
    const still = new Camera();
    const turned = new Camera();
    turned.heading = 0.5;
    // what stands still in the world is turned back in the frame of a sensor that has turned
    const [c, s] = [Math.cos(-0.5), Math.sin(-0.5)];
    const seenBefore = seen(still, [20, 3, 0]);
    const seenAfter = seen(turned, [c * 20 - s * 3, s * 20 + c * 3, 0]);
    seenBefore.forEach((value, axis) => {
      expect(seenAfter[axis]).toBeCloseTo(value, 4);
    });
  });

  test("moves smoothly and comes to rest, so that a still picture costs nothing", () => {
    const camera = new Camera();
    const before = camera.stand.yaw;
    camera.rotate(0.5, 0.1);
    expect(camera.move(0.016)).toBe(true);
    expect(Math.abs(camera.stand.yaw - before)).toBeLessThan(0.3);
    settle(camera);
    expect(camera.stand.yaw).toBeCloseTo(before - 0.5);
    expect(camera.move(0.016)).toBe(false);
  });

  test("never goes below the road or into the middle, however it is sent", () => {
    const camera = new Camera();
    camera.rotate(0, -10);
    camera.zoom(1e-9);
    settle(camera);
    expect(camera.stand.pitch).toBeGreaterThan(-0.2);
    expect(camera.stand.distance).toBeGreaterThan(1);
    camera.rotate(0, 20);
    camera.zoom(1e9);
    settle(camera);
    for (const value of seen(camera, [1, 1, 0])) expect(Number.isFinite(value)).toBe(true);
  });
});

test("matrices: a point at the target is in the middle, and depth grows away from the camera", () => {
  const both = multiply(identity(), perspective(identity(), 1, 1, 0.5, 100), lookAt(identity(), [-5, 0, 3], [2, 0, 0]));
  const middle = through(both, [2, 0, 0]);
  expect(middle[0]).toBeCloseTo(0);
  expect(middle[1]).toBeCloseTo(0);
  expect(through(both, [9, 0, -3])[2]).toBeGreaterThan(middle[2]);
});

test("a frame of the trail lies where it was taken, even far from the world's middle", () => {
  const pose = (x: number, y: number, angle: number) => {
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    return Float64Array.from([c, -s, 0, x, s, c, 0, y, 0, 0, 1, 0]);
  };
  const place = between(identity(), pose(4_000_010, 5_000_000, 0), pose(4_000_000, 5_000_000, Math.PI / 2));
  const [x, y, z] = through(place, [2, 0, 1]);
  expect(x).toBeCloseTo(-10, 5);
  expect(y).toBeCloseTo(2, 5);
  expect(z).toBeCloseTo(1, 5);
});
