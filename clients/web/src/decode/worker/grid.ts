/** The cells of a point cloud whose message came without a range image, for the view. The rule is that of the package
 * (lidarcodec/sensors/clouds/grid.py): rows by ring, columns in the order in which the points come; or the turns of the azimuth as
 * rows; or lines of elevation. */

import type { Cells } from "../../../../typescript/src/clouds/columns.js";
import { nearest } from "../../../../typescript/src/clouds/geometry.js";
import { type CloudMessage, FieldType, namedField } from "../../../../typescript/src/clouds/message.js";

const MOST_ROWS = 128;
const MOST_COLUMNS = 24_576;
const MOST_CELLS = 1 << 20;
const [CELLS_PER_POINT, FEW_CELLS, OF_EACH_RING] = [8, 4096, 256];
const TURN = 2 * Math.PI;
/** Of a turn, for points in no order. */
const COLUMNS = 2048;
const [BETWEEN_LINES, FEW_LINES] = [0.0007, 4];
const [LEAST_STEP, MOST_STEP, LEAST_JUMP] = [1e-5, 0.2, 1e-4];

/** x, y and z of all points, 0 without a return, and whether each has one. */
export interface Axes {
  readonly x: Float64Array;
  readonly y: Float64Array;
  readonly z: Float64Array;
  readonly returned: Uint8Array;
}

/** Points in no order: rows by elevation, the highest first, columns by azimuth; points of one cell beside each other. Columns
 * beyond those of the cells are not shown. In Python lidarcodec/sensors/clouds/view.py. */
export function cellsByAngles({ x, y, z, returned }: Axes, rows: number): Cells {
  const points = x.length;
  const up = x.map((value, i) => Math.atan2(z[i], Math.sqrt(value * value + y[i] * y[i])));
  let [top, bottom] = [Number.NEGATIVE_INFINITY, Number.POSITIVE_INFINITY];
  for (let i = 0; i < points; i++) {
    if (!returned[i]) continue;
    top = Math.max(top, up[i]);
    bottom = Math.min(bottom, up[i]);
  }
  const span = Math.max(top - bottom, 1e-6);
  const row = new Uint8Array(points);
  const bins = new Int32Array(points);
  for (let i = 0; i < points; i++) {
    row[i] = Math.min(Math.max(Math.trunc(((top - up[i]) / span) * rows), 0), rows - 1);
    const turned = Math.atan2(-y[i], x[i]) / TURN;
    bins[i] = Math.floor((turned - Math.floor(turned)) * COLUMNS);
  }
  const order = new Uint32Array(points).map((_, i) => i).sort((a, b) => row[a] - row[b] || bins[a] - bins[b] || a - b);
  const columns = new Int32Array(points);
  let [most, next, last] = [0, 0, -1];
  for (const i of order) {
    columns[i] = row[i] === last ? Math.max(bins[i], next) : bins[i];
    most = Math.max(most, columns[i]);
    next = columns[i] + 1;
    last = row[i];
  }
  const width = Math.min(most + 1, MOST_COLUMNS, Math.floor(MOST_CELLS / rows));
  return { rows, columns: width, row, column: Uint16Array.from(columns, (at) => Math.min(at, width)) };
}

/** Rows of points, not yet in columns. */
interface Rows {
  readonly rows: number;
  readonly row: Uint8Array;
}

/** null if the points have no order. */
export function cellsOfPoints(message: CloudMessage, axes: Axes): Cells | null {
  if (!axes.returned.includes(1)) return null;
  const azimuth = azimuths(axes);
  for (const name of ["ring", "channel", "laser_id", "line"]) {
    const rings = ringsOf(message, name);
    const cells = rings && byRings(rings, azimuth, axes);
    if (cells) return cells;
  }
  const turns = byTurns(azimuth);
  if (turns) return turns;
  const lines = linesOf(axes);
  return lines && byRings(lines, azimuth, axes);
}

function ringsOf(message: CloudMessage, name: string): Rows | null {
  const field = namedField(message.head, name);
  if (!field || field.type >= FieldType.float32) return null;
  const values = message.values(field);
  const row = new Uint8Array(values.length);
  let most = 0;
  for (let i = 0; i < row.length; i++) {
    if (values[i] < 0 || values[i] >= MOST_ROWS) return null;
    row[i] = values[i];
    most = Math.max(most, row[i]);
  }
  return { rows: most + 1, row };
}

/** Direction of each point; of one without a return that of the one before. */
function azimuths({ x, y, returned }: Axes): Float64Array {
  const found = new Float64Array(x.length);
  let last = 0;
  for (let i = 0; i < found.length; i++) {
    if (returned[i]) last = Math.atan2(y[i], x[i]);
    found[i] = last;
  }
  return found;
}

function wrapped(angle: number): number {
  return angle - nearest(angle / TURN) * TURN;
}

function modulo(value: number): number {
  const rest = value % TURN;
  return rest < 0 ? rest + TURN : rest;
}

function median(values: number[]): number {
  const sorted = Float64Array.from(values).sort();
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

function fits(rows: number, columns: number, points: number): boolean {
  const cells = rows * columns;
  return columns <= MOST_COLUMNS && cells <= Math.max(CELLS_PER_POINT * points, FEW_CELLS) && cells <= MOST_CELLS;
}

/** Points that come column by column, or, where that needs too many columns, row by row. */
function byRings(rings: Rows, azimuth: Float64Array, axes: Axes): Cells | null {
  const { rows, row } = rings;
  const points = row.length;
  let same = 0;
  for (let i = 1; i < points; i++) same += row[i] === row[i - 1] ? 1 : 0;
  if (points > 1 && same / (points - 1) > 0.5) return rowByRow(rings, azimuth);
  const rank = new Uint8Array(rows);
  firingOrder(rings).forEach((ring, place) => {
    rank[ring] = place;
  });
  const anew = new Uint8Array(points).fill(1);
  for (let i = 1; i < points; i++) anew[i] = rank[row[i]] <= rank[row[i - 1]] ? 1 : 0;
  const begins = anew.slice();
  const offset = new Float64Array(rows);
  const steps = new Float64Array(points);
  let jump = Number.POSITIVE_INFINITY;
  for (let round = 0; round < 3; round++) {
    // rings look in different directions: learn by how much, then cut where the direction jumps
    for (let again = 0; again < 2; again++) addMedians(rings, azimuth, begins, offset);
    for (let i = 1; i < points; i++)
      steps[i] = Math.abs(wrapped(azimuth[i] - offset[row[i]] - (azimuth[i - 1] - offset[row[i - 1]])));
    jump = jumpOf(steps, anew);
    for (let i = 0; i < points; i++) begins[i] = anew[i] || steps[i] > jump ? 1 : 0;
  }
  const column = columnsOfFiring(row, rank, offset, jump, axes);
  const columns = (column.at(-1) as number) + 1;
  return fits(rows, columns, points) ? { rows, columns, row, column: Uint16Array.from(column) } : null;
}

/** Adds to the offset of each ring the median of some of its angles, each less that with which its column began. */
function addMedians({ row }: Rows, azimuth: Float64Array, begins: Uint8Array, offset: Float64Array): void {
  const ofRing: number[][] = Array.from(offset, () => []);
  const step = Math.max(1, Math.floor(row.length / (OF_EACH_RING * offset.length)));
  let begun = 0;
  for (let i = 0; i < row.length; i++) {
    const level = azimuth[i] - offset[row[i]];
    if (begins[i]) begun = level;
    if (i % step === 0) ofRing[row[i]].push(wrapped(level - begun));
  }
  ofRing.forEach((angles, ring) => {
    if (angles.length) offset[ring] += median(angles);
  });
}

/** Radians from which on a point is in another direction than the one before: more than half a column. */
function jumpOf(steps: Float64Array, anew: Uint8Array): number {
  const between: number[] = [];
  let begins = 0;
  for (let i = 0; i < steps.length; i++) {
    begins += anew[i];
    if (i > 0 && anew[i]) between.push(steps[i]);
  }
  const jump = Math.max(between.length ? 0.6 * median(between) : Number.POSITIVE_INFINITY, LEAST_JUMP);
  let jumps = 0;
  for (let i = 0; i < steps.length; i++) jumps += !anew[i] && steps[i] > jump ? 1 : 0;
  // Lasers beside the axis look in directions that depend on the range: then these are no jumps.
  return jumps < 0.3 * begins ? jump : Number.POSITIVE_INFINITY;
}

/** Rings in the order in which they fire: mostly, each is followed by the next. */
function firingOrder({ rows, row }: Rows): number[] {
  const follows = Array.from({ length: rows }, () => new Uint32Array(rows));
  for (let i = 1; i < row.length; i++) if (row[i] !== row[i - 1]) follows[row[i - 1]][row[i]]++;
  const after = follows.map((counts) => counts.indexOf(counts.reduce((most, count) => Math.max(most, count), 0)));
  const chain: number[] = [];
  const within = new Set<number>();
  for (let ring = row[0]; !within.has(ring); ring = after[ring]) {
    chain.push(ring);
    within.add(ring);
  }
  const next = () => {
    for (let ring = rows - 1; ring >= 0; ring--)
      if (!within.has(ring) && within.has(after[ring]) && follows[ring].some((count) => count > 0)) return ring;
    return -1;
  };
  for (let ring = next(); ring >= 0; ring = next()) {
    chain.splice(chain.indexOf(after[ring]), 0, ring);
    within.add(ring);
  }
  for (let ring = 0; ring < rows; ring++) if (!within.has(ring)) chain.push(ring);
  return chain;
}

function columnsOfFiring(
  row: Uint8Array,
  rank: Uint8Array,
  turned: Float64Array,
  jump: number,
  axes: Axes,
): Uint32Array {
  const { fround } = Math;
  const found = new Uint32Array(row.length);
  let [now, azimuth, level, last] = [0, 0, 0, -1];
  for (let i = 0; i < row.length; i++) {
    if (axes.returned[i]) azimuth = fround(Math.atan2(fround(axes.y[i]), fround(axes.x[i])));
    const here = azimuth - turned[row[i]];
    if (i > 0 && (rank[row[i]] <= last || Math.abs(wrapped(here - level)) > jump)) now++;
    found[i] = now;
    last = rank[row[i]];
    level = here;
  }
  return found;
}

/** Points that come ring by ring: columns by azimuth, at least one after the point before. */
function rowByRow({ rows, row }: Rows, azimuth: Float64Array): Cells | null {
  const ways: number[] = [];
  for (let i = 1; i < row.length; i++) {
    if (row[i] < row[i - 1]) return null;
    if (row[i] === row[i - 1]) ways.push(wrapped(azimuth[i] - azimuth[i - 1]));
  }
  const step = ways.length ? median(ways.map(Math.abs)) : 0;
  if (!(step > LEAST_STEP && step < MOST_STEP)) return null;
  const forward = Math.sign(median(ways)) || 1;
  const column = new Int32Array(row.length);
  let [least, most, next] = [Number.POSITIVE_INFINITY, 0, 0];
  for (let i = 0; i < row.length; i++) {
    const at = Math.floor(modulo((azimuth[i] - azimuth[0]) * forward + 0.25) / step);
    column[i] = i > 0 && row[i] === row[i - 1] ? Math.max(at, next) : at;
    least = Math.min(least, column[i]);
    most = Math.max(most, column[i]);
    next = column[i] + 1;
  }
  const columns = most - least + 1;
  return fits(rows, columns, row.length)
    ? { rows, columns, row, column: Uint16Array.from(column, (at) => at - least) }
    : null;
}

/** Points that come turn by turn: a row ends where the azimuth has passed that of the first point. */
function byTurns(azimuth: Float64Array): Cells | null {
  const steps: number[] = [];
  for (let i = 1; i < azimuth.length; i++) steps.push(wrapped(azimuth[i] - azimuth[i - 1]));
  const forward = steps.length ? Math.sign(median(steps)) : 0;
  const along = steps.reduce((sum, step) => sum + (Math.sign(step) === forward ? 1 : 0), 0);
  if (forward === 0 || along / steps.length < 0.8) return null;
  const row = new Uint8Array(azimuth.length);
  let [now, before] = [0, 0];
  for (let i = 0; i < azimuth.length; i++) {
    const turned = modulo((azimuth[i] - azimuth[0]) * forward);
    if (turned - before < -Math.PI && ++now >= MOST_ROWS) return null;
    row[i] = now;
    before = turned;
  }
  return rowByRow({ rows: now + 1, row }, azimuth);
}

/** The line of elevation of each point, the highest first; null if they form no lines. */
function linesOf({ x, y, z }: Axes): Rows | null {
  const elevation = z.map((height, i) => Math.atan2(height, Math.sqrt(x[i] * x[i] + y[i] * y[i])));
  const rising = elevation.slice().sort();
  const begins: number[] = [];
  for (let i = 1; i < rising.length; i++)
    if (rising[i] - rising[i - 1] > BETWEEN_LINES && begins.push(rising[i]) >= MOST_ROWS) return null;
  if (begins.length + 1 < FEW_LINES) return null;
  const row = new Uint8Array(elevation.length);
  for (let i = 0; i < row.length; i++) {
    let line = begins.length;
    while (line > 0 && elevation[i] < begins[line - 1]) line--;
    row[i] = begins.length - line;
  }
  return { rows: begins.length + 1, row };
}
