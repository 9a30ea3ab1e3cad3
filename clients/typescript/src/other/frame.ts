/** Messages of other sensors than an HDL-64E to frames: planes, and the numbers of their packets. */

import { cloudReturns } from "../clouds/points.js";
import { type Cloud, readCloud, type ReadPlanes } from "../clouds/section.js";
import { damaged } from "../errors.js";
import type { Frame } from "../decoder.js";
import { latticeOf, widened } from "../lattice.js";
import { type Message, Section, needed } from "../message.js";
import { readPose } from "../pose.js";
import type { SensorBook } from "../sensor.js";
import type { DescribedSensor } from "./calibration.js";
import { MOST_NUMBERS, type Plane, readPlaneSection } from "./planes.js";
import { type Rest, readRest } from "./rest.js";

const POINT_CLOUD = "pointcloud2";

/** A frame as the sensor saw it: planes of `rows` rows, the highest beam first, and W columns, row after row. */
export interface ImageFrame {
  readonly streamId: bigint;
  readonly index: bigint;
  /** Host time of the first packet, ns since 1970 UTC. */
  readonly stampNs: bigint;
  readonly codec: number;
  readonly sensor: DescribedSensor;
  readonly rows: number;
  readonly width: number;
  /** The first is `range`, in range steps, 0 = no return; none if all packets are odd. */
  readonly planes: readonly Plane[];
  /** Number of first returns. */
  readonly returns: number;
  readonly rest: Rest;
  /** The message of a point cloud (model `pointcloud2`), which has no planes and no columns; null for other models. */
  readonly cloud: Cloud | null;
  /** The columns that were sent of a thinned frame, ascending; null for a whole frame. */
  readonly lattice: Uint16Array | null;
  /** T_world_sensor at the stamp, first three rows; null if the vehicle does not know it. */
  readonly pose: Float64Array | null;
  /** T_vehicle_sensor, first three rows: where the sensor sits on its vehicle; null if the stream does not say. */
  readonly mount: Float64Array | null;
}

/** Whether a frame is of another sensor than an HDL-64E. */
export function isImageFrame(frame: Frame | ImageFrame): frame is ImageFrame {
  return "planes" in frame;
}

export function readImageFrame(message: Message, sensors: SensorBook<DescribedSensor>): Omit<ImageFrame, "mount"> {
  const { streamId, index, stampNs, codec, width } = message;
  if (message.needs !== null) throw damaged("a message of planes that refers to another");
  const sensor = sensors.of(message);
  const rest = readRest(needed(message, Section.REST, "the rest of packets"), message.packets);
  if (sensor.model === POINT_CLOUD) return cloudFrame(message, sensor, rest, readPlaneSection);
  const lattice = latticeOf(message);
  if (lattice && lattice.width !== width) throw damaged(`a lattice in ${lattice.width} columns of a frame of ${width}`);
  const section = message.section(Section.PLANES);
  if (section === null && (width > 0 || rest.layout !== "")) throw damaged(`a frame of ${width} columns without planes`);
  const found = section && readPlaneSection(section, lattice ? lattice.columns.length : width);
  if (found && found.rows !== sensor.rows) throw damaged(`planes of ${found.rows} rows of a sensor with ${sensor.rows}`);
  let planes: Plane[] = found ? found.planes : [];
  if (lattice) {
    if (sensor.rows * width * planes.length > MOST_NUMBERS) throw damaged("a thinned frame of too many numbers");
    planes = planes.map((plane) => ({ ...plane, values: widened(plane.values, sensor.rows, lattice) }));
  }
  const returns = planes.length ? planes[0]!.values.reduce((sum, range) => sum + (range > 0 ? 1 : 0), 0) : 0;
  const columns = lattice && lattice.columns;
  const frame = { streamId, index, stampNs, codec, sensor, rows: sensor.rows, width, planes, returns, rest, cloud: null };
  return { ...frame, lattice: columns, pose: readPose(message) };
}

/** The frame of a message with a CLOUD section, whose planes `readPlanes` reads. */
export function readCloudFrame(message: Message, sensors: SensorBook<DescribedSensor>, readPlanes: ReadPlanes): CloudFrame {
  const sensor = sensors.of(message);
  if (sensor.model !== POINT_CLOUD) throw damaged(`a point cloud of a sensor ${sensor.model}`);
  return cloudFrame(message, sensor, readRest(needed(message, Section.REST, "the rest of packets"), message.packets), readPlanes);
}

type CloudFrame = Omit<ImageFrame, "mount"> & { readonly cloud: Cloud };

function cloudFrame(message: Message, sensor: DescribedSensor, rest: Rest, readPlanes: ReadPlanes): CloudFrame {
  const { streamId, index, stampNs, codec } = message;
  if (rest.packetNs.length !== 1 || rest.layout !== "" || rest.odd.length > 0)
    throw damaged(`a point cloud of ${rest.packetNs.length} packets, not of one message`);
  const cloud = readCloud(needed(message, Section.CLOUD, "a point cloud"), readPlanes);
  const returns = cloudReturns(cloud.payload);
  const frame = { streamId, index, stampNs, codec, sensor, rows: sensor.rows, width: 0, planes: [], returns, rest, cloud };
  return { ...frame, lattice: null, pose: readPose(message) };
}
