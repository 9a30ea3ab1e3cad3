/** x, y and z of points from a range, a direction and the geometry of each row (docs/wire-format-clouds.md, "Positions"). All
 * operations are those of the format, in its order, so that the same bits come out. */

const { fround: f32, floor } = Math;
const TURN = 6.283185307179586;
const SHIFT = 6755399441055744; // 3 * 2^51
/** Sense and quarters by which a driver rounds directions. */
export const ANGLES = [[0, 0], [-1, 0], [1, 0], [-1, 1], [1, 1], [-1, 3], [1, 3]] as const;

export interface CloudRow {
  readonly along: number;
  readonly alongM: number;
  readonly up: number;
  readonly upM: number;
  readonly asideM: number;
  readonly turned: number;
}

export interface CloudGeometry {
  readonly stepM: number;
  readonly turn: number;
  readonly narrow: boolean;
  /** A place in ANGLES. */
  readonly angles: number;
  readonly rows: readonly CloudRow[];
}

/** x, y, z, and the distance from the axis. */
export type Place = [number, number, number, number];

/** The nearest whole number, halves to the even one; |value| below 2^51. */
export function nearest(value: number): number {
  return value + SHIFT - SHIFT;
}

const singles = new Float32Array(1);
const bits = new Int32Array(singles.buffer);

/** float32 as whole numbers in the same order. */
export function ordered(value: number): number {
  singles[0] = value;
  return bits[0]! >= 0 ? bits[0]! : -(bits[0]! & 0x7fffffff) - 1;
}

/** The bits of the float32 of a number within 32 bits. */
export function bitsOfOrdered(number: number): number {
  return number >= 0 ? number : ((-(number + 1) | 0x80000000) >>> 0);
}

export function bitsOfSingle(value: number): number {
  singles[0] = value;
  return bits[0]! >>> 0;
}

export function exponent(value: number): number {
  singles[0] = value;
  return (bits[0]! >>> 23) & 0xff;
}

/** A direction in turns as a driver has it in radians, in float32. */
export function driverRadians(turns: number, angles: number): number {
  const [sense, quarters] = ANGLES[angles]!;
  const angle = turns * sense + quarters * 0.25;
  return f32((angle - floor(angle)) * TURN);
}

/** The direction of a point in turns, as the driver has it. */
export function turnsOf(geometry: CloudGeometry, row: CloudRow, k: number): number {
  const turns = (k + row.turned) / geometry.turn;
  if (geometry.angles === 0) return turns;
  const [sense, quarters] = ANGLES[geometry.angles]!;
  return (driverRadians(turns, geometry.angles) / TURN - quarters * 0.25) * sense;
}

const SINE = [1 / 6227020800, -1 / 39916800, 1 / 362880, -1 / 5040, 1 / 120, -1 / 6, 1];
const COSINE = [1 / 479001600, -1 / 3628800, 1 / 40320, -1 / 720, 1 / 24, -1 / 2, 1];

/** Writes the point of a range n and a direction in turns in a row. */
export function placeOf(geometry: CloudGeometry, row: CloudRow, n: number, turns: number, to: Place): void {
  const quarter = turns * 4 + SHIFT - SHIFT;
  const angle = (turns - quarter * 0.25) * TURN;
  const square = angle * angle;
  let sine = -1 / 1307674368000;
  for (const factor of SINE) sine = sine * square + factor;
  sine *= angle;
  let cosine = -1 / 87178291200;
  for (const factor of COSINE) cosine = cosine * square + factor;
  const turned = quarter & 3;
  let c = turned & 1 ? sine : cosine;
  let s = turned & 1 ? cosine : sine;
  if (turned === 1 || turned === 2) c = -c;
  if (turned >= 2) s = -s;
  if (!geometry.narrow) {
    const distance = n * geometry.stepM;
    const rho = row.along * distance + row.alongM;
    to[0] = rho * c - row.asideM * s;
    to[1] = rho * s + row.asideM * c;
    to[2] = row.up * distance + row.upM;
    to[3] = rho;
    return;
  }
  const distance = f32(n * f32(geometry.stepM));
  const rho = f32(f32(f32(row.along) * distance) + f32(row.alongM));
  const aside = f32(row.asideM);
  c = f32(c);
  s = f32(s);
  to[0] = f32(f32(rho * c) - f32(aside * s));
  to[1] = f32(f32(rho * s) + f32(aside * c));
  to[2] = f32(f32(f32(row.up) * distance) + f32(row.upM));
  to[3] = rho;
}
