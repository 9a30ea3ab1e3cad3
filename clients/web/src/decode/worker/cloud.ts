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

// Arrays with a number for each place: a function for each type, which is several times as quick as `from`.

function floats(count: number, of: (at: number) => number): Float64Array {
  const found = new Float64Array(count);
  for (let at = 0; at < count; at++) found[at] = of(at);
  return found;
}

function ints(count: number, of: (at: number) => number): Int32Array {
  const found = new Int32Array(count);
  for (let at = 0; at < count; at++) found[at] = of(at);
  return found;
}

function places(count: number, of: (at: number) => number): Uint32Array {
  const found = new Uint32Array(count);
  for (let at = 0; at < count; at++) found[at] = of(at);
  return found;
}

/** x, y and z of all points of a message. */
type Three = readonly [Values, Values, Values];

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
    const is = (i: number) => off(made, points, i) <= CLOSE_M + CLOSE * points.range[i];
    const close = places(chosen.length, (i) => i).filter(is);
    const at = (of: Int32Array) => ints(close.length, (i) => of[close[i]]);
    const all = chosen;
    drawn = { ...made, row: at(made.row), column: at(made.column) };
    chosen = places(close.length, (i) => all[close[i]]);
    points = pointsAt(found.axes, chosen);
  }
  return painted(drawn, points.range, intensitiesOf(message), chosen, found.place.length);
}

/** The directions of rows, for what viewers are told of a sensor. */
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
  return place.filter((at) => Math.sqrt(x[at] * x[at] + y[at] * y[at] + z[at] * z[at]) <= FARTHEST_M);
}

function pointsAt([x, y, z]: Three, chosen: Uint32Array): Points {
  const of = (values: Values) => floats(chosen.length, (i) => values[chosen[i]]);
  const [px, py, pz] = [of(x), of(y), of(z)];
  const flat = (i: number) => px[i] * px[i] + py[i] * py[i];
  const range = floats(chosen.length, (i) => Math.sqrt(flat(i) + pz[i] * pz[i]));
  const up = floats(chosen.length, (i) => Math.atan2(pz[i], Math.sqrt(flat(i))));
  return { x: px, y: py, z: pz, range, up };
}

/** Metres between a point and where it is drawn. */
function off({ row, column, elevation, rotation, azimuth }: Drawn, { x, y, z, range }: Points, i: number): number {
  const beta = radians(azimuth[column[i]]) - rotation[row[i]];
  const up = elevation[row[i]];
  const flat = range[i] * Math.cos(up);
  const [dx, dy, dz] = [flat * Math.cos(beta) - x[i], -flat * Math.sin(beta) - y[i], range[i] * Math.sin(up) - z[i]];
  return Math.sqrt(dx * dx + dy * dy + dz * dz);
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
    const of = (values: Values) => floats(points, (at) => (returned[at] ? values[at] : 0));
    const all = { x: of(x), y: of(y), z: of(z), returned };
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
  { points: count }: CloudMessage,
  all: Uint32Array,
  axes: Three,
  chosen: Uint32Array,
  points: Points,
  rows: number,
): Drawn | null {
  if (cells.columns > MOST_COLUMNS || count !== cells.row.length) return null;
  const rowOf = (at: number) => (rising ? cells.rows - 1 - cells.row[at] : cells.row[at]);
  const row = ints(chosen.length, (i) => rowOf(chosen[i]));
  const column = ints(chosen.length, (i) => cells.column[chosen[i]]);
  if (row.some((one) => one >= rows) || column.some((one) => one >= cells.columns)) return null;
  const shown = all.filter((at) => rowOf(at) < rows && cells.column[at] < cells.columns);
  const azimuth = columnAzimuths(cells, shown, axes);
  if (!isTurn(azimuth)) return null;
  const [cosine, sine, up, there] = [0, 1, 2, 3].map(() => new Float64Array(rows)) as [
    Float64Array,
    Float64Array,
    Float64Array,
    Float64Array,
  ];
  for (let i = 0; i < chosen.length; i++) {
    const turned = radians(azimuth[column[i]]) - Math.atan2(-points.y[i], points.x[i]);
    cosine[row[i]] += Math.cos(turned);
    sine[row[i]] += Math.sin(turned);
    up[row[i]] += points.up[i];
    there[row[i]]++;
  }
  const rotation = cosine.map((value, at) => Math.atan2(sine[at], value));
  const drawn = { row, column, rotation, elevation: up.map((sum, at) => sum / Math.max(there[at], 1)), azimuth };
  for (let i = 0; i < chosen.length; i++) if (off(drawn, points, i) > NEAR_M + NEAR * points.range[i]) return null;
  return drawn;
}

/** Whether higher rows look higher, by some of the points with a return. */
function rises(cells: Cells, place: Uint32Array, [x, y, z]: Three): boolean {
  if (place.length < 2) return false;
  const step = Math.max(1, Math.floor(place.length / LOOKED_AT));
  const some = place.filter((_, i) => i % step === 0);
  const up = floats(some.length, (i) => Math.atan2(z[some[i]], Math.sqrt(x[some[i]] ** 2 + y[some[i]] ** 2)));
  const row = floats(some.length, (i) => cells.row[some[i]]);
  const mean = (values: Float64Array) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const [meanUp, meanRow] = [mean(up), mean(row)];
  return up.reduce((sum, value, i) => sum + (row[i] - meanRow) * (value - meanUp), 0) > 0;
}

/** Mean direction of the points of each column; of one without points that of the one before. */
function columnAzimuths(cells: Cells, shown: Uint32Array, [x, y]: Three): Uint16Array {
  const [cosine, sine] = [new Float64Array(cells.columns), new Float64Array(cells.columns)];
  for (const at of shown) {
    const far = Math.max(Math.sqrt(x[at] ** 2 + y[at] ** 2), 1e-9);
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
  const row = ints(up.length, (i) => levels.length - 1 - below(between, up[i]));
  const column = ints(up.length, (i) => {
    const turned = (Math.atan2(-y[i], x[i]) * 18_000) / Math.PI;
    const at = nearest((turned * columns) / TURN);
    return at < 0 ? at + columns : at < columns ? at : 0;
  });
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
    means.push(rising.subarray(from, to).reduce((sum, one) => sum + one, 0) / (to - from));
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
  const values = floats(given.length, (i) => (Number.isFinite(given[i]) ? given[i] : 0));
  const most = values.reduce((sum, value) => Math.max(sum, value), 0);
  const scale = most > 0 && most <= 1 && values.some((value) => !Number.isInteger(value)) ? 255 : 1;
  return new Uint8Array(ints(values.length, (i) => Math.min(Math.max(nearest(values[i] * scale), 0), 255)));
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
  const far = range.reduce((most, one) => Math.max(most, one), 0);
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
