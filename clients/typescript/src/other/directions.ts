/** Points of every cell of a frame of sensors that send blocks: Velodyne and Hesai (docs/sensors.md, "Layouts").
 *
 * Azimuths are computed with numbers of 32 bits where the Python package does, so that both round to the same ones. */

import { DecodeError } from "../errors.js";
import { Field } from "../sensor.js";
import type { ImageFrame } from "./frame.js";
import { type BlockModel } from "./models.js";

/** Gives x, y and z in metres of a range at a cell. */
export type Locate = (row: number, column: number, range: number) => readonly [number, number, number];

const { fround: f32 } = Math;
const TURN = 36000;
const BLOCKS = 12;
const RADIANS = f32(Math.PI / 180);
const HUNDREDTH = f32(0.01);
const [EARLY_SHOT_US, SHOT_US, SHOTS_PER_COLUMN, STAMP_US] = [8 / 3, 2.89, 20, 7];
const [EARLIEST_US, LIMIT_US] = [153, 167];

export function numbers(frame: ImageFrame, name: string): Float64Array {
  const series = frame.rest.series.get(name);
  if (!series) throw new DecodeError("section", `a frame of this sensor without the series ${name}`);
  return Float64Array.from(series, Number);
}

/** Number of packets whose values are in the images. */
export function imagedPackets(frame: ImageFrame): number {
  return frame.rest.packetNs.length - frame.rest.odd.length;
}

export function blockPoints(frame: ImageFrame, model: BlockModel): Locate {
  const { sensor, rows } = frame;
  if (model.rows.length !== rows) throw new DecodeError("section", `${rows} rows of a sensor with ${model.rows.length}`);
  const of = (field: number, unit: number): Float64Array =>
    Float64Array.from(model.rows, (laser) => sensor.table[field * rows + laser]! * unit);
  const [rot, vert] = [of(Field.rotation, 1e-8), of(Field.vertical, 1e-8)];
  const [dist, up, aside] = [Field.distance, Field.verticalOffset, Field.horizontalOffset].map((field) => of(field, 1e-7)) as
    [Float64Array, Float64Array, Float64Array];
  const azimuth = model.firing ? firedAzimuths(frame, model) : columnAzimuths(frame);
  return (row, column, range) => {
    const angle = f32(f32(HUNDREDTH * azimuth(row, column)) * RADIANS);
    const beta = angle - rot[row]!;
    const [cos, sin] = [Math.cos(beta), Math.sin(beta)];
    const distance = range * sensor.rangeStep + dist[row]!;
    const flat = distance * Math.cos(vert[row]!);
    return [flat * cos + aside[row]! * sin, aside[row]! * cos - flat * sin, distance * Math.sin(vert[row]!) + up[row]!];
  };
}

type AzimuthOf = (row: number, column: number) => number;

/** Of a Hesai: that of the column. */
function columnAzimuths(frame: ImageFrame): AzimuthOf {
  const azimuths = numbers(frame, "azimuth");
  if (azimuths.length !== frame.width) throw new DecodeError("section", `${azimuths.length} azimuths of ${frame.width} columns`);
  return (_, column) => azimuths[column]! % TURN;
}

/** Of a Velodyne: that of the block, and what the sensor turned until the laser fired. */
function firedAzimuths(frame: ImageFrame, model: BlockModel): AzimuthOf {
  const azimuths = numbers(frame, "azimuth");
  const packets = imagedPackets(frame);
  if (packets === 0) return () => 0;
  const eight = frame.sensor.model === "vls128";
  const columns = frame.width / packets;
  const groups = eight ? columns : BLOCKS / (frame.rest.layout === "dual" ? 2 : 1);
  const each = columns / groups;
  if (azimuths.length !== groups * packets || ![columns, each].every((count) => Number.isInteger(count) && count > 0))
    throw new DecodeError("section", `${azimuths.length} azimuths of ${frame.width} columns in ${packets} packets`);
  const timing = eight ? eightfoldTiming(frame, columns) : evenTiming(model, columns);
  const lasers = model.rows.length;
  const at = (column: number, laser: number): number => timing[column * lasers + laser]!;
  const speed = eight
    ? speedBetween(azimuths, columns, columns > 1 ? f32(at(1, 0) - at(0, 0)) : f32(f32(f32(at(0, 32) - at(0, 0)) / 4) * SHOTS_PER_COLUMN))
    : speedWithin(azimuths, groups, f32(at((groups - 1) * each, 0) - at(0, 0)));
  return (row, column) => {
    const [packet, own] = [Math.floor(column / columns), column % columns];
    const group = Math.floor(own / each);
    const since = f32(at(own, model.rows[row]!) - at(group * each, 0));
    const angle = f32(azimuths[packet * groups + group]! + f32(speed[packet]! * since));
    return ((Math.floor(f32(angle + TURN) + 0.5) % TURN) + TURN) % TURN;
  };
}

function turned(before: number, after: number): number {
  return f32((((after - before) % TURN) + TURN) % TURN);
}

/** 0.01 degree a second of each packet: from its first block to its last one. */
function speedWithin(azimuths: Float64Array, groups: number, duration: number): Float32Array {
  return Float32Array.from({ length: azimuths.length / groups }, (_, packet) =>
    turned(azimuths[packet * groups]!, azimuths[(packet + 1) * groups - 1]!) / duration,
  );
}

/** The same from the packet before to this one. More than 1.8 times the median is a gap in the stream: the median. */
function speedBetween(azimuths: Float64Array, columns: number, cycle: number): Float32Array {
  const speed = new Float32Array(azimuths.length / columns);
  for (let packet = 1; packet < speed.length; packet++)
    speed[packet] = turned(azimuths[(packet - 1) * columns]!, azimuths[packet * columns]!) / f32(cycle * columns);
  if (speed.length > 1) {
    const median = f32(middle(speed.subarray(1)));
    for (let packet = 0; packet < speed.length; packet++)
      if (speed[packet]! > f32(f32(1.8) * median)) speed[packet] = median;
    speed[0] = speed[1]!;
  } else if (columns > 1) speed[0] = turned(azimuths[0]!, azimuths[1]!) / cycle;
  return speed;
}

function middle(values: Float32Array | Float64Array): number {
  const sorted = values.slice().sort();
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half]! : f32(f32(sorted[half - 1]! + sorted[half]!) / 2);
}

function evenTiming(model: BlockModel, columns: number): Float32Array {
  const [cycleUs, shotUs, together] = model.firing!;
  const lasers = model.rows.length;
  return Float32Array.from({ length: columns * lasers }, (_, i) =>
    cycleUs * 1e-6 * Math.floor(i / lasers) + shotUs * 1e-6 * Math.floor((i % lasers) / together),
  );
}

/** Of a VLS-128, whose firmware before 5.2.3 fires faster: times between its packets tell. */
function eightfoldTiming(frame: ImageFrame, columns: number): Float32Array {
  const lasers = 128;
  const timing = Float32Array.from({ length: columns * lasers }, (_, i) => {
    const laser = i % lasers;
    const shots = SHOTS_PER_COLUMN * Math.floor(i / lasers) + Math.floor(laser / 8) + 2 * Math.floor(laser / 64);
    return shots * (SHOT_US * 1e-6) - STAMP_US * 1e-6;
  });
  const stamps = numbers(frame, "time_us");
  const between = stamps.slice(1).map((stamp, i) => stamp - stamps[i]!);
  const gap = between.length ? (middle(between) * 3) / columns : 0;
  if (gap < EARLIEST_US || gap >= LIMIT_US) return timing;
  return timing.map((seconds) => seconds * f32(EARLY_SHOT_US / SHOT_US));
}
