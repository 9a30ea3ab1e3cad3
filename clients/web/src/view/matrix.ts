/** 4x4 matrices, column by column for the graphics card. Results are written into given arrays. */

export type Matrix = Float32Array;
export type Vector = [number, number, number];

export function identity(): Matrix {
  const out = new Float32Array(16);
  out[0] = out[5] = out[10] = out[15] = 1;
  return out;
}

/** Perspective with an opening of `fov` radians from top to bottom; depth goes to -1..1. */
export function perspective(out: Matrix, fov: number, aspect: number, near: number, far: number): Matrix {
  const f = 1 / Math.tan(fov / 2);
  out.fill(0);
  out[0] = f / aspect;
  out[5] = f;
  out[10] = (far + near) / (near - far);
  out[11] = -1;
  out[14] = (2 * far * near) / (near - far);
  return out;
}

/** World to camera, for a camera at `eye` that looks at `target` with z up. */
export function lookAt(out: Matrix, eye: Readonly<Vector>, target: Readonly<Vector>): Matrix {
  let fx = target[0] - eye[0];
  let fy = target[1] - eye[1];
  let fz = target[2] - eye[2];
  const f = 1 / Math.max(Math.hypot(fx, fy, fz), 1e-9);
  fx *= f;
  fy *= f;
  fz *= f;
  // right = forward x up; a camera that looks straight down is turned by its caller before it comes so far
  const s = 1 / Math.max(Math.hypot(fx, fy), 1e-9);
  const sx = fy * s;
  const sy = -fx * s;
  const ux = sy * fz;
  const uy = -sx * fz;
  const uz = sx * fy - sy * fx;
  out[0] = sx;
  out[4] = sy;
  out[8] = 0;
  out[1] = ux;
  out[5] = uy;
  out[9] = uz;
  out[2] = -fx;
  out[6] = -fy;
  out[10] = -fz;
  out[12] = -(sx * eye[0] + sy * eye[1]);
  out[13] = -(ux * eye[0] + uy * eye[1] + uz * eye[2]);
  out[14] = fx * eye[0] + fy * eye[1] + fz * eye[2];
  out[3] = out[7] = out[11] = 0;
  out[15] = 1;
  return out;
}

/** out = a b; out may be neither of them. */
export function multiply(out: Matrix, a: Matrix, b: Matrix): Matrix {
  for (let column = 0; column < 16; column += 4) {
    const b0 = b[column] as number;
    const b1 = b[column + 1] as number;
    const b2 = b[column + 2] as number;
    const b3 = b[column + 3] as number;
    for (let row = 0; row < 4; row++) {
      out[column + row] =
        (a[row] as number) * b0 +
        (a[row + 4] as number) * b1 +
        (a[row + 8] as number) * b2 +
        (a[row + 12] as number) * b3;
    }
  }
  return out;
}

/** out = matrix (x, y, z, 1). */
export function transformed(out: [number, number, number, number], m: Matrix, [x, y, z]: Readonly<Vector>): void {
  for (let row = 0; row < 4; row++) {
    out[row] =
      (m[row] as number) * x + (m[row + 4] as number) * y + (m[row + 8] as number) * z + (m[row + 12] as number);
  }
}

/** A pose: the upper three rows of a rigid transform, row by row, in double precision. */
export type Pose = Float64Array;

/** out = inverse(to) from: transforms points from the frame of pose `from` to the frame of pose `to`.
 *
 * World coordinates may be thousands of kilometres, so the difference is computed in double precision before rounding. */
export function between(out: Matrix, to: Pose, from: Pose): Matrix {
  const dx = (from[3] as number) - (to[3] as number);
  const dy = (from[7] as number) - (to[7] as number);
  const dz = (from[11] as number) - (to[11] as number);
  for (let row = 0; row < 3; row++) {
    const r0 = to[row] as number;
    const r1 = to[row + 4] as number;
    const r2 = to[row + 8] as number;
    for (let column = 0; column < 3; column++) {
      out[column * 4 + row] =
        r0 * (from[column] as number) + r1 * (from[column + 4] as number) + r2 * (from[column + 8] as number);
    }
    out[12 + row] = r0 * dx + r1 * dy + r2 * dz;
  }
  out[3] = out[7] = out[11] = 0;
  out[15] = 1;
  return out;
}

/** The heading of a pose: the angle of its x axis about z, radians, counter-clockwise. */
export function headingOf(pose: Pose): number {
  return Math.atan2(pose[4] as number, pose[0] as number);
}
