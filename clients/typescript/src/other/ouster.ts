/** Points of an Ouster by its metadata, which a stream carries as the sensor's description (docs/sensors.md, "Ouster"). */

import { DecodeError } from "../errors.js";
import type { ImageFrame } from "./frame.js";
import { type Locate, numbers } from "./directions.js";

const FIRST_ORIGIN_MM = 12.163;
const ORIGINS_MM: Readonly<Record<string, number>> = { "0": 27.67, "1": 15.806, "2": 13.762 };
const FIRST_SENSOR = [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1];
const MOST = 10_000;

type Json = Readonly<Record<string, unknown>>;

function refused(what: string): DecodeError {
  return new DecodeError("section", `points of an Ouster need its metadata: ${what}`);
}

function isObject(value: unknown): value is Json {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

/** The value of a key in its section, or at the top as older firmware has it. */
function find(tree: Json, section: string, key: string): unknown {
  const inside = tree[section];
  return (isObject(inside) ? inside[key] : undefined) ?? tree[key];
}

function numbersOf(value: unknown, key: string, count: number): number[] {
  const flat: unknown[] = Array.isArray(value) ? value.flat() : [];
  if (flat.length !== count || !flat.every((one) => typeof one === "number" && Math.abs(one) <= MOST))
    throw refused(`${key} must be ${count} numbers`);
  return flat as number[];
}

export function ousterPoints(frame: ImageFrame): Locate {
  const { rows, width, sensor } = frame;
  if (!sensor.description.length) throw refused("the stream has none");
  let tree: unknown;
  try {
    tree = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(sensor.description));
  } catch {
    throw refused("what the stream has is no JSON");
  }
  if (!isObject(tree)) throw refused("what the stream has is no object");
  const altitude = numbersOf(find(tree, "beam_intrinsics", "beam_altitude_angles"), "beam_altitude_angles", rows);
  const aside = numbersOf(find(tree, "beam_intrinsics", "beam_azimuth_angles"), "beam_azimuth_angles", rows);
  const mode = /^(\d{3,4})x\d+$/.exec(String(find(tree, "config_params", "lidar_mode")));
  if (!mode) throw refused("it has no lidar_mode");
  const [originX, originZ] = originOf(tree);
  const given = find(tree, "lidar_intrinsics", "lidar_to_sensor_transform");
  const turn = given === undefined ? FIRST_SENSOR : numbersOf(given, "lidar_to_sensor_transform", 16);
  const ids = numbers(frame, "measurement_id");
  if (ids.length !== width) throw new DecodeError("section", `${ids.length} measurements of ${width} columns`);
  const encoder = ids.map((id) => (-2 * Math.PI * id) / Number(mode[1]));
  const [cosE, sinE] = [encoder.map(Math.cos), encoder.map(Math.sin)];
  const beams = altitude.map((degrees, row) => {
    const [up, to] = [(degrees * Math.PI) / 180, (aside[row]! * Math.PI) / 180];
    return [Math.cos(up) * Math.cos(to), Math.cos(up) * Math.sin(to), Math.sin(up)] as const;
  });
  const before = Math.hypot(originX, originZ);
  return (row, column, range) => {
    const [flat, across, high] = beams[row]!;
    const [cos, sin] = [cosE[column]!, sinE[column]!];
    const along = range * sensor.rangeStep * 1e3 - before;
    const x = along * (flat * cos + across * sin) + originX * cos;
    const y = along * (flat * sin - across * cos) + originX * sin;
    const z = along * high + originZ;
    const axis = (at: number): number => (turn[at]! * x + turn[at + 1]! * y + turn[at + 2]! * z + turn[at + 3]!) * 1e-3;
    return [axis(0), axis(4), axis(8)];
  };
}

/** Where beams begin, mm along x and z from the axis. */
function originOf(tree: Json): readonly [number, number] {
  const matrix = find(tree, "beam_intrinsics", "beam_to_lidar_transform");
  if (matrix !== undefined && matrix !== null) {
    const whole = numbersOf(matrix, "beam_to_lidar_transform", 16);
    return [whole[3]!, whole[11]!];
  }
  const said = find(tree, "beam_intrinsics", "lidar_origin_to_beam_origin_mm");
  if (typeof said === "number") return [said, 0];
  const product = find(tree, "sensor_info", "prod_line");
  if (typeof product !== "string" || !product) return [FIRST_ORIGIN_MM, 0];
  return [ORIGINS_MM[/^OS-?([0-9])/i.exec(product)?.[1] ?? ""] ?? 0, 0];
}
