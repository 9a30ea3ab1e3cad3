/** A frame as points in metres (docs/live-sockets.md, "From a range image to points"). */

import type { Frame } from "./decoder.js";
import { Field, ROWS, type Sensor, rowValues } from "./sensor.js";

const FAR = 25.04;
const NEAR_ACROSS = 2.4;
const NEAR_ALONG = 1.93;

export interface Points {
  readonly count: number;
  /** x, y, z of each point, one after the other: forward, left, up. */
  readonly xyz: Float32Array;
  readonly intensity: Uint8Array;
  /** Row of each point, 0 the highest beam. */
  readonly ring: Uint8Array;
  /** 1 for a point interpolated between sent columns. */
  readonly filled: Uint8Array;
}

function scaled(sensor: Sensor, field: number, unit: number): Float64Array {
  return Float64Array.from(rowValues(sensor, field), (steps) => steps * unit);
}

/** Points of the returns, including interpolated ones, column by column, in a column from the top ring down. */
export function pointsOf(frame: Frame): Points {
  const { width, sensor, range, mask } = frame;
  const rot = scaled(sensor, Field.rotation, 1e-8);
  const vert = scaled(sensor, Field.vertical, 1e-8);
  const [dist, distX, distY, up, aside] = [
    Field.distance,
    Field.distanceX,
    Field.distanceY,
    Field.verticalOffset,
    Field.horizontalOffset,
  ].map((field) => scaled(sensor, field, 1e-7));
  const ros = sensor.convention === "ros";
  const all = frame.returns + frame.madeUp;
  const xyz = new Float32Array(3 * all);
  const intensity = new Uint8Array(all);
  const ring = new Uint8Array(all);
  const made = new Uint8Array(all);
  let count = 0;
  for (let column = 0; column < width; column++)
    for (let row = 0; row < ROWS; row++) {
      const cell = row * width + column;
      const madeUp = frame.filled?.[cell] ?? 0;
      if (!mask[cell] && !madeUp) continue;
      const beta = (frame.azimuth[sensor.half[row] * width + column] * Math.PI) / 18000 - rot[row];
      const [cosB, sinB, cosV, sinV] = [Math.cos(beta), Math.sin(beta), Math.cos(vert[row]), Math.sin(vert[row])];
      const distance = range[cell] * sensor.rangeStep + dist[row];
      const flat = distance * cosV - (ros ? up[row] * sinV : 0);
      let x = flat * cosB + aside[row] * sinB;
      let y = aside[row] * cosB - flat * sinB;
      let z = distance * sinV + up[row] * (ros ? cosV : 1);
      if (ros) {
        const along = ((distY[row] - dist[row]) / (FAR - NEAR_ALONG)) * Math.max(FAR - Math.abs(x), 0);
        const across = ((distX[row] - dist[row]) / (FAR - NEAR_ACROSS)) * Math.max(FAR - Math.abs(y), 0);
        x += along * cosV * cosB;
        y -= across * cosV * sinB;
        z += along * sinV;
      }
      xyz.set([x, y, z], 3 * count);
      intensity[count] = frame.intensity[cell];
      ring[count] = row;
      made[count] = madeUp;
      count++;
    }
  return { count, xyz, intensity, ring, filled: made };
}
