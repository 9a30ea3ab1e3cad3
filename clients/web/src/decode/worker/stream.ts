/** Messages of a stream to range images: the module decodes them, with what only the page has given to it. */

import { DecodeError, damaged } from "../../../../typescript/src/errors.js";
import { fill as filled } from "../../../../typescript/src/filling.js";
import { Referable } from "../../../../typescript/src/history.js";
import { latticeOf } from "../../../../typescript/src/lattice.js";
import { Codec, type Message, needed, readMessage, Section } from "../../../../typescript/src/message.js";
import { type DescribedSensor, readDescribed } from "../../../../typescript/src/other/calibration.js";
import { readCloudFrame } from "../../../../typescript/src/other/frame.js";
import { Reader } from "../../../../typescript/src/other/reader.js";
import { splitStep } from "../../../../typescript/src/planes.js";
import { readPose } from "../../../../typescript/src/pose.js";
import { ROWS, SensorBook } from "../../../../typescript/src/sensor.js";
import { type CloudImage, cloudImage, ringsOf, stillHolds } from "./cloud.js";
import { factsOf, factsOfRings, packImage, type SensorFacts } from "./image.js";
import { NativeStream } from "./native.js";
import { readPng } from "./png.js";

export interface Decoded {
  /** As the cloud socket sends it, form range with intensities. */
  readonly data: ArrayBuffer;
  readonly sensor: SensorFacts;
  /** Number of these facts about the sensor: it changes when they do. */
  readonly told: number;
}

const LARGEST_STEP = 40_001;
/** Weight files that are kept, beside those that the stream brings. */
const KEPT = 4;

export class StreamDecoder {
  readonly #module: WebAssembly.Module;
  readonly #fetched: (name: string) => Promise<Uint8Array | null>;
  readonly #now: () => number;
  readonly #weights = new Map<string, Uint8Array>();
  #of = "";
  #native: NativeStream | null = null;
  readonly #referable = new Referable<true>();
  /** The stream's calibration, for the module that follows one that failed. */
  #calibration: Uint8Array | null = null;
  #facts: SensorFacts | null = null;
  #fitted = false;
  #told = 0;
  /** Sensors of point clouds, and the image that `#facts` were made of, of a point cloud. */
  #clouds = new SensorBook<DescribedSensor>([3], readDescribed);
  #cloud: CloudImage | null = null;

  constructor(module: WebAssembly.Module, fetched: (name: string) => Promise<Uint8Array | null>, now: () => number) {
    this.#module = module;
    this.#fetched = fetched;
    this.#now = now;
  }

  /** The frame of a message. Throws DecodeError, whatever the bytes, and goes on with the next message.
   *
   * fill: make up returns between the columns of a thinned frame */
  async decode(data: Uint8Array, fill = false): Promise<Decoded> {
    const message = readMessage(data);
    const { codec, streamId } = message;
    if (!(codec in DECODES)) throw new DecodeError("version", `codec ${codec} is not decoded here`);
    if (this.#of !== `${codec} ${streamId} ${message.planes}`) {
      this.#forget();
      this.#calibration = null;
      this.#clouds = new SensorBook<DescribedSensor>([3], readDescribed);
      this.#of = `${codec} ${streamId} ${message.planes}`;
    }
    this.#referable.of(message); // asked first, as an error of the module ends it
    try {
      const decoded = await this.#decode(message, data, fill);
      this.#referable.took(message, true, message.planes);
      return decoded;
    } catch (error) {
      this.#forget(); // an error that left the module has left it in the middle of something
      if (error instanceof DecodeError) throw error;
      throw damaged(`the decoder failed: ${error instanceof Error ? error.message : error}`);
    }
  }

  #forget(): void {
    this.#native = null;
    this.#referable.forget();
  }

  async #decode(message: Message, data: Uint8Array, fill: boolean): Promise<Decoded> {
    const native = this.#begun();
    if (message.section(Section.CLOUD)) return this.#decodeCloud(native, message);
    await this.#bringWeights(native, data);
    if (message.codec === Codec.png) await givePicture(native, message);
    native.push(data);
    const sensor = this.#sensor(native, message);
    const { rows, width, range, azimuth, intensity } = native.frame;
    const calibration = message.section(Section.CALIBRATION);
    if (calibration && calibration[0] > 0) this.#calibration = calibration.slice();
    const lattice = fill ? latticeOf(message) : null;
    const { streamId, index, stampNs, codec } = message;
    const rangeStep = sensor.range_step_m;
    const made = lattice && filled(range, intensity, lattice)[0];
    const image = { streamId, index, stampNs, codec, rows, width, range, azimuth, intensity, filled: made, rangeStep };
    return { data: packImage({ ...image, pose: poseOf(message) }, this.#now()), sensor, told: this.#told };
  }

  /** A point cloud, whose section is read here, and its planes by the module. */
  #decodeCloud(native: NativeStream, message: Message): Decoded {
    const readPlanes = (data: Uint8Array, columns: number) => native.planes(data, columns);
    const { streamId, index, stampNs, codec, sensor, cloud } = readCloudFrame(message, this.#clouds, readPlanes);
    const image = cloudImage(cloud, sensor.rows);
    if (this.#facts?.hash !== sensor.hash || !this.#cloud || !stillHolds(this.#cloud, image)) {
      this.#facts = factsOfRings(ringsOf(sensor, image));
      this.#cloud = image;
      this.#told++;
    }
    const { rows, width, range, intensity, stepM: rangeStep, points: measured } = image;
    const azimuth = new Uint16Array(2 * width);
    azimuth.set(image.azimuth);
    azimuth.set(image.azimuth, width);
    const shown = {
      streamId,
      index,
      stampNs,
      codec,
      rows,
      width,
      range,
      azimuth,
      intensity,
      filled: null,
      rangeStep,
      measured,
    };
    const data = packImage({ ...shown, pose: poseOf(message) }, this.#now());
    return { data, sensor: this.#facts as SensorFacts, told: this.#told };
  }

  /** What viewers know of the sensor of the frame that was pushed. The geometry of other sensors than an HDL-64E is fitted to
   * the first frame that has columns. */
  #sensor(native: NativeStream, message: Message): SensorFacts {
    const known = this.#facts?.hash === native.sensorHash ? this.#facts : null;
    if (known && (message.planes ? this.#fitted : !message.key)) return known;
    const rings = message.planes ? native.rings : null;
    if (!known || message.planes) this.#told++;
    this.#cloud = null;
    this.#facts = rings ? factsOfRings(rings) : factsOf(native.sensor);
    this.#fitted = message.width > 0;
    return this.#facts;
  }

  #begun(): NativeStream {
    if (this.#native === null) {
      this.#native = new NativeStream(this.#module);
      if (this.#calibration) this.#native.giveCalibration(this.#calibration);
    }
    return this.#native;
  }

  /** Gives the module the weights that a message names and that no message brought: a file, and what an update begins with. */
  async #bringWeights(native: NativeStream, data: Uint8Array): Promise<void> {
    for (let name = native.missingWeights(data); name !== ""; name = native.missingWeights(data)) {
      const file = this.#weights.get(name) ?? (await this.#fetched(name));
      if (!file)
        throw new DecodeError("reference", `weights ${name} are not here: they come with a key message, ask for one`);
      if (this.#weights.size >= KEPT) this.#weights.clear();
      this.#weights.set(name, file);
      native.giveWeights(file);
    }
  }
}

/** Numbers of the codecs that are decoded here. */
export const DECODES: Readonly<Record<number, true>> = {
  [Codec.raw]: true,
  [Codec.zstd]: true,
  [Codec.pcodec]: true,
  [Codec.png]: true,
  [Codec.riddle]: true,
  [Codec.predictive]: true,
};

/** As the message has it. */
function poseOf(message: Message): Uint8Array | null {
  return readPose(message) && message.section(Section.POSE);
}

/** The browser inflates the picture of a message, which the module asks for later. */
async function givePicture(native: NativeStream, message: Message): Promise<void> {
  const { data, rows, columns } = message.planes ? besidePlanes(message) : alone(message);
  if (data.length > 0) native.givePicture(await readPng(data, rows, columns));
}

interface Picture {
  readonly data: Uint8Array;
  readonly rows: number;
  readonly columns: number;
}

/** The picture of an HDL-64E. */
function alone(message: Message): Picture {
  const [, data] = splitStep(needed(message, Section.RANGE, "ranges"));
  return { data, rows: ROWS, columns: message.width };
}

/** The picture of another sensor, of the sides that its other planes have. */
function besidePlanes(message: Message): Picture {
  const planes = message.section(Section.PLANES);
  if (planes === null) return { data: new Uint8Array(), rows: 0, columns: 0 }; // no packet has an image
  const ranges = new Reader(needed(message, Section.RANGE, "ranges"));
  ranges.byte(); // bits, and the step: the module looks at them
  ranges.varint(LARGEST_STEP);
  const columns = latticeOf(message)?.columns.length ?? message.width;
  return { data: ranges.rest(), rows: (planes[1] ?? 0) + 1, columns };
}
