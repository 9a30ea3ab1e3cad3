/** Messages to frames: codecs raw and zstd. */

import type { Columns } from "./azimuth.js";
import { DecodeError, damaged } from "./errors.js";
import { MaskHistory, Referable } from "./history.js";
import { latticeOf, widened, widenedAzimuth } from "./lattice.js";
import { Codec, Section, needed, readMessage } from "./message.js";
import { type DescribedSensor, readDescribed } from "./other/calibration.js";
import { type ImageFrame, readImageFrame } from "./other/frame.js";
import { type Planes, count, readPlanes } from "./planes.js";
import { MountMemory, readPose } from "./pose.js";
import { readZstdRanges } from "./ranges.js";
import { readRaw } from "./raw.js";
import { ROWS, type Sensor, SensorBook, readSensor } from "./sensor.js";
import { zstdReady } from "./zstd.js";

/** A frame of an HDL-64E as the sensor saw it: images of 64 rows, the highest beam first, and W columns, row after row. */
export interface Frame extends Planes {
  readonly streamId: bigint;
  readonly index: bigint;
  /** Host time of the first packet, ns since 1970 UTC. */
  readonly stampNs: bigint;
  readonly codec: number;
  readonly sensor: Sensor;
  /** 64 x W, in range steps, 0 = no return. */
  readonly range: Uint16Array;
  /** 1 for cells with a measured range. */
  readonly returns: number;
  /** Ascending indices of the sent columns of a thinned frame; otherwise null. `fired` has no values for the other
   * columns. */
  readonly lattice: Uint16Array | null;
  /** 64 x W, 1 for a return that `filled` interpolated; null before that. `mask` has only measured returns. */
  readonly filled: Uint8Array | null;
  /** Number of interpolated returns. */
  readonly madeUp: number;
  /** T_world_sensor at the stamp, first three rows; null if the vehicle does not know it. */
  readonly pose: Float64Array | null;
  /** T_vehicle_sensor, first three rows: where the sensor sits on its vehicle; null if the stream does not say. */
  readonly mount: Float64Array | null;
}

/** Decodes the messages of one stream, one after the other. */
export class Decoder {
  #of = "";
  #sensors = new SensorBook<Sensor>([1, 2], readSensor);
  #described = new SensorBook<DescribedSensor>([3], readDescribed);
  /** The frames that a message may refer to, with the masks up to each. */
  readonly #referable = new Referable<Masks>();
  #mounts = new MountMemory();

  private constructor() {}

  static async create(): Promise<Decoder> {
    await zstdReady();
    return new Decoder();
  }

  /** The frame of a message; that of another sensor than an HDL-64E is an ImageFrame. Throws DecodeError, whatever the
   * bytes, and goes on with the next message. */
  decode(data: Uint8Array): Frame | ImageFrame {
    const message = readMessage(data);
    const { codec, streamId, index } = message;
    if (codec !== Codec.raw && codec !== Codec.zstd)
      throw new DecodeError("version", `codec ${codec}: this decoder reads raw (1) and zstd (2)`);
    if (message.frames !== 1) throw damaged("a group of frames of a codec that sends one each");
    if (this.#of !== `${codec} ${streamId} ${message.planes}`) {
      this.#of = `${codec} ${streamId} ${message.planes}`;
      this.#sensors = new SensorBook<Sensor>([1, 2], readSensor);
      this.#described = new SensorBook<DescribedSensor>([3], readDescribed);
      this.#referable.forget();
      this.#mounts = new MountMemory();
    }
    const mount = this.#mounts.of(message);
    if (message.planes) return { ...readImageFrame(message, this.#described), mount };
    const sensor = this.#sensors.of(message);
    const history = this.#referable.of(message)?.history() ?? null;
    const before = history && ((columns: Columns) => history.before(columns, sensor));
    const planes = codec === Codec.raw ? readRaw(message, sensor) : readPlanes(message, sensor, before);
    const range = "range" in planes ? (planes.range as Uint16Array) : readZstdRanges(needed(message, Section.RANGE, "ranges"), planes.mask);
    const pose = readPose(message);
    const lattice = latticeOf(message);
    if (message.packets > 0 && message.section(Section.SIDE) === null) throw damaged("packets without side information");
    this.#referable.took(message, new Masks(history, planes, sensor));
    const returns = count(planes.mask);
    const frame = { streamId, index, stampNs: message.stampNs, codec, sensor, returns, pose, mount, filled: null, madeUp: 0 };
    if (lattice === null) return { ...planes, ...frame, range, lattice };
    return {
      ...frame,
      width: lattice.width,
      azimuth: widenedAzimuth(planes.azimuth, lattice),
      fired: widened(planes.fired, 2, lattice),
      mask: widened(planes.mask, ROWS, lattice),
      intensity: widened(planes.intensity, ROWS, lattice),
      range: widened(range, ROWS, lattice),
      lattice: lattice.columns,
    };
  }
}

/** The masks up to a frame. They are put together once a mask refers to them: most streams never ask. */
class Masks {
  readonly #before: MaskHistory | null;
  readonly #planes: Planes;
  readonly #sensor: Sensor;
  #history: MaskHistory | null = null;

  constructor(before: MaskHistory | null, planes: Planes, sensor: Sensor) {
    this.#before = before;
    this.#planes = planes;
    this.#sensor = sensor;
  }

  history(): MaskHistory {
    if (this.#history !== null) return this.#history;
    const history = this.#before?.copy() ?? new MaskHistory();
    history.remember(this.#planes.mask, this.#planes, this.#sensor);
    this.#history = history;
    return history;
  }
}
