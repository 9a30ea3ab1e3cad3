/** Frames of other sensors than an HDL-64E as points in metres (docs/sensors.md, "Layouts"). */

import { DecodeError } from "../errors.js";
import { type Locate, blockPoints } from "./directions.js";
import type { ImageFrame } from "./frame.js";
import { BLOCK_MODELS } from "./models.js";
import { ousterPoints } from "./ouster.js";
import type { Plane } from "./planes.js";

export interface ImagePoints {
  readonly count: number;
  /** x, y, z of each point, one after the other: forward, left, up. */
  readonly xyz: Float32Array;
  /** Row of each point, 0 the highest beam. */
  readonly ring: Uint8Array;
  /** 1, or 2 of a second return. */
  readonly returnNumber: Uint8Array;
  /** Cell of each point in the planes, row * W + column. */
  readonly cell: Uint32Array;
  /** What else was measured, by name: `intensity`, `signal`, `near_ir`, ... */
  readonly fields: ReadonlyMap<string, Uint32Array>;
}

/** First returns column by column, in a column from the top ring down; with `both`, then the second ones in the same order,
 * those left out that are the first one sent again. Throws DecodeError where directions are not known: of an Ouster without
 * metadata, and of a model that is not known here. */
export function imagePointsOf(frame: ImageFrame, both = false): ImagePoints {
  const { planes, rows, width } = frame;
  const named = new Map(planes.map((plane) => [plane.name, plane]));
  const first = named.get("range")?.values ?? new Uint32Array();
  const second = both ? named.get("range2")?.values : undefined;
  const cells: number[] = [];
  const inOrder = (chosen: (cell: number) => boolean): void => {
    for (let column = 0; column < width; column++)
      for (let row = 0; row < rows; row++) if (chosen(row * width + column)) cells.push(row * width + column);
  };
  if (first.length) inOrder((cell) => first[cell]! > 0);
  const ones = cells.length;
  const [one, two] = [named.get("intensity")?.values, named.get("intensity2")?.values];
  if (second && first.length)
    inOrder((cell) => second[cell]! > 0 && !(second[cell] === first[cell] && (!one || !two || one[cell] === two[cell])));
  const count = cells.length;
  const xyz = new Float32Array(3 * count);
  const locate = count ? locator(frame) : undefined;
  cells.forEach((cell, at) => {
    const ranges = at < ones ? first : second!;
    xyz.set(locate!(Math.floor(cell / width), cell % width, ranges[cell]!), 3 * at);
  });
  const values = (plane: Plane): Uint32Array => {
    const again = named.get(`${plane.name}2`) ?? plane;
    return Uint32Array.from(cells, (cell, at) => (at < ones ? plane : again).values[cell]!);
  };
  const measured = planes.filter(({ role, name }) => role === "attribute" && !name.endsWith("2"));
  return {
    count,
    xyz,
    ring: Uint8Array.from(cells, (cell) => Math.floor(cell / width)),
    returnNumber: Uint8Array.from(cells, (_, at) => (at < ones ? 1 : 2)),
    cell: Uint32Array.from(cells),
    fields: new Map(measured.map((plane) => [plane.name, values(plane)])),
  };
}

function locator(frame: ImageFrame): Locate {
  const { model } = frame.sensor;
  const known = Object.hasOwn(BLOCK_MODELS, model) ? BLOCK_MODELS[model] : undefined;
  if (known) return blockPoints(frame, known);
  if (/^os(0|1|2|dome)-\d+$/.test(model)) return ousterPoints(frame);
  throw new DecodeError("version", `points of a sensor ${model} are not known here`);
}
