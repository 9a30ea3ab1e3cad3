/** A sensor's calibration from the socket's event `sensor`, prepared for the shader. */
import { MAX_RINGS } from "./frame";

const LISTS = [
  "block",
  "rot_correction_rad",
  "vert_correction_rad",
  "dist_correction_m",
  "dist_correction_x_m",
  "dist_correction_y_m",
  "vert_offset_m",
  "horiz_offset_m",
] as const;
type List = (typeof LISTS)[number];

export interface SensorEvent extends Record<List, number[]> {
  convention: "ros" | "veloview";
  rings: number;
  range_step_m: number;
}

export const TEXELS = 3;

export interface SensorTable {
  rings: number;
  /** (rings, TEXELS, 4): of each ring cos and sin of the rotation correction, cos and sin of the elevation; distance
   * correction, vertical and horizontal offset, block; slope of the near correction along and across, rotation
   * correction, elevation. Metres and radians. */
  values: Float32Array;
  /** Whether the vertical offset is turned by the elevation, and near points are corrected. */
  ros: boolean;
}

/** Distances between the near and the far target of the two-point correction, in metres. */
const ALONG_M = 25.04 - 1.93;
const ACROSS_M = 25.04 - 2.4;

/** The table from an event. Throws if the event lacks a value that points need. */
export function sensorTable(event: Partial<SensorEvent>): SensorTable {
  const { rings } = event;
  if (!Number.isInteger(rings) || (rings as number) < 1 || (rings as number) > MAX_RINGS) {
    throw new Error(`a sensor of ${rings} rings cannot be shown`);
  }
  for (const name of LISTS) {
    const list = event[name];
    if (!Array.isArray(list) || list.length !== rings || !list.every(Number.isFinite)) {
      throw new Error(`the sensor's table has no ${name} for ${rings} rings`);
    }
  }
  const given = event as SensorEvent;
  const values = new Float32Array(given.rings * TEXELS * 4);
  for (let ring = 0; ring < given.rings; ring++) {
    const of = (name: List) => given[name][ring] as number;
    const turn = of("rot_correction_rad");
    const up = of("vert_correction_rad");
    const far = of("dist_correction_m");
    const row = [Math.cos(turn), Math.sin(turn), Math.cos(up), Math.sin(up)];
    row.push(far, of("vert_offset_m"), of("horiz_offset_m"), of("block"));
    row.push((of("dist_correction_y_m") - far) / ALONG_M, (of("dist_correction_x_m") - far) / ACROSS_M, turn, up);
    values.set(row, ring * TEXELS * 4);
  }
  return { rings: given.rings, values, ros: given.convention !== "veloview" };
}
