/** The range image of a point cloud that came as a message, for the view, which computes points itself. The rule is that of the
 * server (lidarcodec_server/live/cloud_image.py): rows and columns of the cells that the points were sent in, or come in, if each point is
 * drawn close to its place by them; else rows near to the directions of points, and columns in even steps, where a point
 * that is not drawn close to its place is left out. */

import type { Cells } from "../../../../typescript/src/clouds/columns.js";
import { nearest } from "../../../../typescript/src/clouds/geometry.js";
import { CloudMessage, namedField, type Values } from "../../../../typescript/src/clouds/message.js";
import { returned } from "../../../../typescript/src/clouds/points.js";
import type { Cloud } from "../../../../typescript/src/clouds/section.js";
import type { DescribedSensor } from "../../../../typescript/src/other/calibration.js";
import { cellsByAngles, cellsOfPoints } from "./grid.js";
import type { Rings } from "./native.js";

const FARTHEST_M = 1048;
const STEP_M = 0.004;
const MOST_ROWS = 128;
const COLUMNS = [2048, 4096] as const;
const MANY = 30_000;
const [NEAR_M, NEAR, CLOSE_M, CLOSE] = [0.1, 0.004, 0.15, 0.02];
const MOST_COLUMNS = 12_288;
const MOST_MESSAGE_COLUMNS = 24_576;
const MOST_CELLS = 1 << 20;
const WHOLE_TURN = 0.98;
const LOOKED_AT = 8192;
const [BETWEEN_LINES, WIDEST_LINE] = [0.0007, 0.002];
const SAME_RAD = 0.0005;
const TURN = 36_000;
const MAX_U16 = 65_535;

export interface CloudImage {
  readonly rows: number;
  readonly width: number;
  /** rows x width, in steps of `stepM`, 0 = no return. */
  readonly range: Uint16Array;
  readonly intensity: Uint8Array;
  /** Of each column, 0.01 degree, clockwise. */
  readonly azimuth: Uint16Array;
  /** Of each row, radians. */
  readonly elevation: Float64Array;
  readonly rotation: Float64Array;
  readonly stepM: number;
  /** Points with a return, drawn or not. */
  readonly points: number;
}

// What is done for each of 200,000 points stands in loops: a call for each of them, whose number is put on the heap, takes
// several times as long.

/** The values at some places. */
function picked<To extends Float64Array | Int32Array | Uint32Array>(to: To, values: Values, at: Uint32Array): To {
  for (let i = 0; i < at.length; i++) to[i] = values[at[i]];
  return to;
}

/** x, y and z of all points of a message. */
type Three = readonly [Values, Values, Values];
type ThreeFloats = [Float64Array, Float64Array, Float64Array];

/** Points that may be drawn. */
interface Points {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly range: Float64Array;
  readonly up: Float64Array;
}

interface Drawn {
  readonly row: Int32Array;
  readonly column: Int32Array;
  readonly elevation: Float64Array;
  readonly rotation: Float64Array;
  readonly azimuth: Uint16Array;
}

/** rows: of the sensor */
export function cloudImage(cloud: Cloud, rows: number): CloudImage {
  const message = CloudMessage.of(cloud.payload);
  const found = returned(message);
  if (!message || !found || found.place.length === 0) return empty(rows, 0);
  let chosen = near(found.axes, found.place);
  if (chosen.length === 0) return empty(rows, found.place.length);
  let points = pointsAt(found.axes, chosen);
  const cells = cellsOf(cloud, message, found.place, found.axes, rows);
  let drawn = ofMessage(cells, message, found.place, found.axes, chosen, points, rows);
  if (!drawn) {
    const made = ofDirections(points);
    const close = drawnClose(made, points, CLOSE_M, CLOSE);
    const at = (of: Int32Array) => picked(new Int32Array(close.length), of, close);
    drawn = { ...made, row: at(made.row), column: at(made.column) };
    chosen = picked(new Uint32Array(close.length), chosen, close);
    points = pointsAt(found.axes, chosen);
  }
  return painted(drawn, points.range, intensitiesOf(message), chosen, found.place.length);
}

/** The directions of rows, for the facts about a sensor that viewers get. */
export function ringsOf(
  { name, model, hash }: DescribedSensor,
  { rows, rotation, elevation, stepM }: CloudImage,
): Rings {
  const values = new Float64Array(5 * rows);
  for (let row = 0; row < rows; row++) values.set([rotation[row], elevation[row]], 5 * row);
  return { name, model, hash, rangeStep: stepM, laser: Uint8Array.from({ length: rows }, (_, row) => row), values };
}

/** Whether the points of an image are in their places with the directions of rows that a viewer has. */
export function stillHolds(told: CloudImage, image: CloudImage): boolean {
  if (told.rows !== image.rows || told.stepM !== image.stepM) return false;
  for (let row = 0; row < image.rows; row++) {
    const turned =
      Math.abs(told.elevation[row] - image.elevation[row]) > SAME_RAD ||
      Math.abs(told.rotation[row] - image.rotation[row]) > SAME_RAD;
    if (turned && image.range.subarray(row * image.width, (row + 1) * image.width).some((range) => range > 0))
      return false;
  }
  return true;
}

function empty(rows: number, points: number): CloudImage {
  const none = () => new Float64Array(rows);
  const range = new Uint16Array(rows);
  return {
    rows,
    width: 1,
    range,
    intensity: new Uint8Array(rows),
    azimuth: new Uint16Array(1),
    elevation: none(),
    rotation: none(),
    stepM: STEP_M,
    points,
  };
}

/** Those of some points that are near enough to be drawn. */
function near([x, y, z]: Three, place: Uint32Array): Uint32Array {
  const found = new Uint32Array(place.length);
  let count = 0;
  for (const at of place)
    if (Math.sqrt(x[at] * x[at] + y[at] * y[at] + z[at] * z[at]) <= FARTHEST_M) found[count++] = at;
  return found.subarray(0, count);
}

function pointsAt(axes: Three, chosen: Uint32Array): Points {
  const count = chosen.length;
  const [x, y, z] = axes.map((values) => picked(new Float64Array(count), values, chosen)) as ThreeFloats;
  const [range, up] = [new Float64Array(count), new Float64Array(count)];
  for (let i = 0; i < count; i++) {
    const flat = x[i] * x[i] + y[i] * y[i];
    range[i] = Math.sqrt(flat + z[i] * z[i]);
    up[i] = Math.atan2(z[i], Math.sqrt(flat));
  }
  return { x, y, z, range, up };
}

/** The points that are drawn within `metres` of their place, and a share of their range more. */
function drawnClose(drawn: Drawn, { x, y, z, range }: Points, metres: number, share: number): Uint32Array {
  const { row, column } = drawn;
  const [up, turned] = [wavesOf(drawn.elevation), wavesOf(drawn.rotation)];
  const ahead = wavesOf(Float64Array.from(drawn.azimuth, radians));
  const found = new Uint32Array(row.length);
  let count = 0;
  for (let i = 0; i < row.length; i++) {
    const [r, c] = [row[i], column[i]];
    const flat = range[i] * up.cosine[r];
    const dx = flat * (ahead.cosine[c] * turned.cosine[r] + ahead.sine[c] * turned.sine[r]) - x[i];
    const dy = flat * (ahead.cosine[c] * turned.sine[r] - ahead.sine[c] * turned.cosine[r]) - y[i];
    const dz = range[i] * up.sine[r] - z[i];
    if (Math.sqrt(dx * dx + dy * dy + dz * dz) <= metres + share * range[i]) found[count++] = i;
  }
  return found.subarray(0, count);
}

function wavesOf(angles: Float64Array): { cosine: Float64Array; sine: Float64Array } {
  return { cosine: angles.map(Math.cos), sine: angles.map(Math.sin) };
}

function radians(hundredths: number): number {
  return (hundredths * 0.01 * Math.PI) / 180;
}

/** Cells of points. rising: whether higher rows look higher. */
interface InOrder {
  readonly cells: Cells;
  readonly rising: boolean;
}

/** The cells that the points were sent in, else those of an organised message, those by their order, or by their angles. */
function cellsOf(cloud: Cloud, message: CloudMessage, place: Uint32Array, axes: Three, rows: number): InOrder {
  if (cloud.cells) return { cells: cloud.cells, rising: rises(cloud.cells, place, axes) };
  const [x, y, z] = axes;
  const { points } = message;
  const { height, width } = message.head;
  if (height < 2 || height > MOST_ROWS || width > MOST_MESSAGE_COLUMNS || points > MOST_CELLS) {
    const returned = new Uint8Array(points);
    for (const at of place) returned[at] = 1;
    const [allX, allY, allZ] = [x, y, z].map((values) => Float64Array.from(values)) as ThreeFloats;
    for (let at = 0; at < points; at++) if (!returned[at]) allX[at] = allY[at] = allZ[at] = 0;
    const all = { x: allX, y: allY, z: allZ, returned };
    const ordered = cellsOfPoints(message, all);
    return ordered
      ? { cells: ordered, rising: rises(ordered, place, axes) }
      : { cells: cellsByAngles(all, rows), rising: false };
  }
  const [row, column] = [new Uint8Array(points), new Uint16Array(points)];
  for (let r = 0, i = 0; r < height; r++)
    for (let c = 0; c < width; c++, i++) {
      row[i] = r;
      column[i] = c;
    }
  const cells = { rows: height, columns: width, row, column };
  return { cells, rising: rises(cells, place, axes) };
}

/** Cells as rows and columns, the highest row first; null if a point would be drawn elsewhere, or they are not those of a whole
 * turn, which viewers would put together of several frames. */
function ofMessage(
  { cells, rising }: InOrder,
  { points: inMessage }: CloudMessage,
  all: Uint32Array,
  axes: Three,
  chosen: Uint32Array,
  points: Points,
  rows: number,
): Drawn | null {
  if (cells.columns > MOST_COLUMNS || inMessage !== cells.row.length) return null;
  const [last, way] = rising ? [cells.rows - 1, -1] : [0, 1];
  const [row, column] = [new Int32Array(chosen.length), new Int32Array(chosen.length)];
  for (let i = 0; i < chosen.length; i++) {
    row[i] = last + way * cells.row[chosen[i]];
    column[i] = cells.column[chosen[i]];
    if (row[i] >= rows || column[i] >= cells.columns) return null;
  }
  const shown = new Uint32Array(all.length);
  let count = 0;
  for (const at of all) if (last + way * cells.row[at] < rows && cells.column[at] < cells.columns) shown[count++] = at;
  const azimuth = columnAzimuths(cells, shown.subarray(0, count), axes);
  if (!isTurn(azimuth)) return null;
  const [cosine, sine, up] = [0, 1, 2].map(() => new Float64Array(rows)) as ThreeFloats;
  const there = new Uint32Array(rows);
  const ahead = wavesOf(Float64Array.from(azimuth, radians));
  const { x, y } = points;
  for (let i = 0; i < chosen.length; i++) {
    // the direction of the column less that of the point, whose cosine and sine are x and -y
    const flat = Math.sqrt(x[i] * x[i] + y[i] * y[i]);
    const [px, py] = flat > 0 ? [x[i] / flat, -y[i] / flat] : [1, 0];
    const [r, c] = [row[i], column[i]];
    cosine[r] += ahead.cosine[c] * px + ahead.sine[c] * py;
    sine[r] += ahead.sine[c] * px - ahead.cosine[c] * py;
    up[r] += points.up[i];
    there[r]++;
  }
  const rotation = cosine.map((value, at) => Math.atan2(sine[at], value));
  const drawn = { row, column, rotation, elevation: up.map((sum, at) => sum / Math.max(there[at], 1)), azimuth };
  return drawnClose(drawn, points, NEAR_M, NEAR).length === chosen.length ? drawn : null;
}

/** Whether higher rows look higher, by some of the points with a return. */
function rises(cells: Cells, place: Uint32Array, [x, y, z]: Three): boolean {
  if (place.length < 2) return false;
  const step = Math.max(1, Math.floor(place.length / LOOKED_AT));
  const count = Math.ceil(place.length / step);
  const [up, row] = [new Float64Array(count), new Float64Array(count)];
  for (let i = 0; i < count; i++) {
    const at = place[i * step];
    up[i] = Math.atan2(z[at], Math.sqrt(x[at] * x[at] + y[at] * y[at]));
    row[i] = cells.row[at];
  }
  const mean = (values: Float64Array) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const [meanUp, meanRow] = [mean(up), mean(row)];
  return up.reduce((sum, value, i) => sum + (row[i] - meanRow) * (value - meanUp), 0) > 0;
}

/** Mean direction of the points of each column; of one without points that of the one before. */
function columnAzimuths(cells: Cells, shown: Uint32Array, [x, y]: Three): Uint16Array {
  const [cosine, sine] = [new Float64Array(cells.columns), new Float64Array(cells.columns)];
  for (const at of shown) {
    const far = Math.max(Math.sqrt(x[at] * x[at] + y[at] * y[at]), 1e-9);
    cosine[cells.column[at]] += x[at] / far;
    sine[cells.column[at]] += y[at] / far;
  }
  let last = 0;
  return Uint16Array.from(cosine, (value, at) => {
    if (value !== 0 || sine[at] !== 0 || at === 0)
      last = (nearest((Math.atan2(-sine[at], value) * 18_000) / Math.PI) + TURN) % TURN;
    return last;
  });
}

/** Whether columns are those of a whole turn. */
function isTurn(azimuth: Uint16Array): boolean {
  let sum = 0;
  for (let i = 1; i < azimuth.length; i++)
    sum += Math.abs(((azimuth[i] - azimuth[i - 1] + 1.5 * TURN) % TURN) - TURN / 2);
  return azimuth.length > 1 && (sum / (azimuth.length - 1)) * azimuth.length >= WHOLE_TURN * TURN;
}

/** Rows near to the directions of the points, and columns in even steps. */
function ofDirections({ x, y, up }: Points): Drawn {
  const levels = levelsOf(up);
  const between = levels.subarray(1).map((level, i) => (level + levels[i]) / 2);
  const columns = COLUMNS[x.length > MANY ? 1 : 0];
  const [row, column] = [new Int32Array(up.length), new Int32Array(up.length)];
  for (let i = 0; i < up.length; i++) {
    row[i] = levels.length - 1 - below(between, up[i]);
    const turned = (Math.atan2(-y[i], x[i]) * 18_000) / Math.PI;
    const at = nearest((turned * columns) / TURN);
    column[i] = at < 0 ? at + columns : at < columns ? at : 0;
  }
  const azimuth = Uint16Array.from({ length: columns }, (_, i) => nearest(i * (TURN / columns)));
  return { row, column, elevation: levels.slice().reverse(), rotation: new Float64Array(levels.length), azimuth };
}

/** How many of some rising numbers are below a value. */
function below(rising: Float64Array, value: number): number {
  let [from, to] = [0, rising.length];
  while (from < to) {
    const middle = (from + to) >> 1;
    if (rising[middle] < value) from = middle + 1;
    else to = middle;
  }
  return from;
}

/** Elevations, rising: those of the lines that the points form, or, of points in no lines, half of them evenly, and half
 * where most points are. */
function levelsOf(up: Float64Array): Float64Array {
  const rising = up.slice().sort();
  const last = rising.length - 1;
  const means: number[] = [];
  let narrow = true;
  for (let from = 0, to = 1; from <= last && means.length <= MOST_ROWS; from = to++) {
    while (to <= last && rising[to] - rising[to - 1] <= BETWEEN_LINES) to++;
    narrow &&= rising[to - 1] - rising[from] <= WIDEST_LINE;
    let sum = 0;
    for (let i = from; i < to; i++) sum += rising[i];
    means.push(sum / (to - from));
  }
  if (means.length <= MOST_ROWS && narrow) return Float64Array.from(means);
  const half = MOST_ROWS / 2;
  const found: number[] = [];
  for (let i = 0; i < half; i++) {
    found.push(rising[0] + ((rising[last] - rising[0]) * i) / (half - 1));
    const at = (last * (i + 0.5)) / half;
    const lower = rising[Math.floor(at)];
    found.push(lower + (rising[Math.min(Math.floor(at) + 1, last)] - lower) * (at % 1));
  }
  return Float64Array.from(new Set(found.sort((a, b) => a - b)));
}

/** The field `intensity`, else `reflectivity` or `i`, as whole numbers up to 255; fractions of 1 count in 255ths. */
function intensitiesOf(message: CloudMessage): Uint8Array {
  const field = ["intensity", "reflectivity", "i"].map((name) => namedField(message.head, name)).find(Boolean);
  if (!field) return new Uint8Array(message.points);
  const given = message.values(field);
  const values = Float64Array.from(given);
  let [most, fractions] = [0, false];
  for (let i = 0; i < values.length; i++) {
    if (!Number.isFinite(values[i])) values[i] = 0;
    most = Math.max(most, values[i]);
    fractions ||= !Number.isInteger(values[i]);
  }
  const scale = most > 0 && most <= 1 && fractions ? 255 : 1;
  const found = new Uint8Array(values.length);
  for (let i = 0; i < found.length; i++) found[i] = Math.min(Math.max(nearest(values[i] * scale), 0), 255);
  return found;
}

/** Of points in one cell the nearest stays. */
function painted(
  drawn: Drawn,
  range: Float64Array,
  intensities: Uint8Array,
  chosen: Uint32Array,
  points: number,
): CloudImage {
  const { row, column, elevation, rotation, azimuth } = drawn;
  const [rows, width] = [elevation.length, azimuth.length];
  let far = 0;
  for (const one of range) far = Math.max(far, one);
  let stepM = STEP_M;
  while (far > stepM * MAX_U16) stepM *= 2;
  const [image, intensity] = [new Uint16Array(rows * width), new Uint8Array(rows * width)];
  const closest = new Float64Array(rows * width).fill(Number.POSITIVE_INFINITY);
  for (let i = 0; i < range.length; i++) {
    const cell = row[i] * width + column[i];
    if (range[i] > closest[cell]) continue;
    closest[cell] = range[i];
    image[cell] = Math.min(Math.max(nearest(range[i] / stepM), 1), MAX_U16);
    intensity[cell] = intensities[chosen[i]];
  }
  return { rows, width, range: image, intensity, azimuth, elevation, rotation, stepM, points };
}
