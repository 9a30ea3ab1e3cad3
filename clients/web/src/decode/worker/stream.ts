/** Messages of a stream to range images: what takes time by the module, the rest here. */

import { DecodeError, damaged } from "../../../../typescript/src/errors.js";
import { fill as filled } from "../../../../typescript/src/filling.js";
import { readIntensity } from "../../../../typescript/src/intensity.js";
import { type Lattice, latticeOf, widened, widenedAzimuth } from "../../../../typescript/src/lattice.js";
import { Codec, type Message, needed, readMessage, Section } from "../../../../typescript/src/message.js";
import { splitStep } from "../../../../typescript/src/planes.js";
import { readPose } from "../../../../typescript/src/pose.js";
import { rangeOf, readZstdRanges } from "../../../../typescript/src/ranges.js";
import { readRaw } from "../../../../typescript/src/raw.js";
import { Field, ROWS, rowValues, type Sensor, SensorBook } from "../../../../typescript/src/sensor.js";
import { factsOf, type Image, packImage, type SensorFacts } from "./image.js";
import { NativeStream, type Part } from "./native.js";
import { readPng } from "./png.js";
import { hex, networksOf, readWeights, Shelf } from "./weights.js";

export interface Decoded {
  /** As the cloud socket sends it, form range with intensities. */
  readonly data: ArrayBuffer;
  readonly sensor: SensorFacts;
}

const NAME_BYTES = 8;
const MODELLED = 3;
const PLAIN = 1;

export class StreamDecoder {
  readonly #module: WebAssembly.Module;
  readonly #shelf: Shelf;
  readonly #now: () => number;
  #of = "";
  #sensors = new SensorBook();
  #native: NativeStream | null = null;
  /** The sensor that the module was told of, and what is said of it. */
  #told: { sensor: Sensor; facts: SensorFacts } | null = null;
  #last: bigint | null = null;
  /** Weights and effort that the module codes with. */
  #learned = "";

  constructor(module: WebAssembly.Module, fetched: (name: string) => Promise<Uint8Array | null>, now: () => number) {
    this.#module = module;
    this.#shelf = new Shelf(fetched);
    this.#now = now;
  }

  /** The frame of a message. Throws DecodeError, whatever the bytes, and goes on with the next message.
   *
   * fill: make up returns between the columns of a thinned frame */
  async decode(data: Uint8Array, fill = false): Promise<Decoded> {
    const message = readMessage(data);
    try {
      const { sensor, ...image } = await this.#decode(message, data);
      return { data: packImage(whole(image, latticeOf(message), fill), this.#now()), sensor };
    } catch (error) {
      // An error that left the module has left it in the middle of something; a reference that is missing has not.
      if (!(error instanceof DecodeError && error.code === "reference")) this.#forget();
      if (error instanceof DecodeError) throw error;
      throw damaged(`the decoder failed: ${error instanceof Error ? error.message : error}`);
    }
  }

  #forget(): void {
    this.#native = null;
    this.#told = null;
    this.#last = null;
    this.#learned = "";
  }

  /** As it was sent: of a thinned frame the columns that were. */
  async #decode(message: Message, data: Uint8Array): Promise<Image & { sensor: SensorFacts }> {
    const { codec, streamId, index, width } = message;
    if (!(codec in DECODES)) throw new DecodeError("version", `codec ${codec} is not decoded here`);
    if (message.frames !== 1) throw damaged("a group of frames of a codec that sends one each");
    if (this.#of !== `${codec} ${streamId}`) {
      this.#forget();
      this.#of = `${codec} ${streamId}`;
      this.#sensors = new SensorBook();
    }
    const sensor = this.#sensors.of(message);
    const follows = message.needs !== null;
    if (follows && message.needs !== this.#last)
      throw new DecodeError("reference", `frame ${index} needs frame ${message.needs}: ask for a key message`);
    if (message.packets > 0 && message.section(Section.SIDE) === null)
      throw damaged("packets without side information");
    const pose = poseOf(message);
    const common = { streamId, index, stampNs: message.stampNs, codec, width, rangeStep: sensor.rangeStep, pose };
    const facts = this.#factsOf(sensor);
    if (codec === Codec.raw) {
      const { range, azimuth, intensity } = readRaw(message, sensor);
      this.#last = index;
      return { ...common, range, azimuth, intensity, filled: null, sensor: facts };
    }
    const native = this.#native as NativeStream;
    if (codec === Codec.riddle) await this.#learn(message, native, follows);
    const part = (type: number, name: string): Part => partOf(data, needed(message, type, name));
    native.give(data);
    native.columns(part(Section.AZIMUTH, "azimuths"), width);
    const keep = message.section(Section.KEEP);
    const expects = codec === Codec.predictive || codec === Codec.riddle;
    const motion = expects ? message.section(Section.MOTION) : null;
    const mask = keep ? partOf(data, keep) : part(Section.MASK, "a mask");
    native.mask(mask, keep !== null, motion && partOf(data, motion), follows);
    const intensity = this.#intensity(message, data, native, sensor);
    const range = await this.#range(message, data, native, follows);
    native.done(follows);
    this.#last = index;
    const { azimuth } = native;
    return { ...common, range: range ?? native.range, azimuth, intensity, filled: null, sensor: facts };
  }

  #factsOf(sensor: Sensor): SensorFacts {
    this.#native ??= new NativeStream(this.#module);
    if (this.#told?.sensor !== sensor) {
      const fields = [Field.rotation, Field.vertical, Field.distance, Field.verticalOffset, Field.horizontalOffset];
      const rows = [...sensor.half, ...fields.flatMap((field) => [...rowValues(sensor, field)])];
      this.#native.sensor(Int32Array.from(rows));
      this.#told = { sensor, facts: factsOf(sensor) };
    }
    return this.#told.facts;
  }

  /** Null where none are sent. */
  #intensity(message: Message, data: Uint8Array, native: NativeStream, sensor: Sensor): Uint8Array | null {
    const section = message.section(Section.INTENSITY);
    if (section === null) return null;
    if (section[0] === MODELLED) {
      native.intensity(partOf(data, section.subarray(1)));
      return native.intensities.slice();
    }
    const columns = { width: message.width, azimuth: native.azimuth.slice(), fired: native.fired.slice() };
    const modelled = (coded: Uint8Array) => {
      native.intensity(partOf(data, coded));
      return native.intensities.slice();
    };
    return readIntensity(section, native.returns.slice(), columns, sensor, modelled);
  }

  /** The ranges, where they do not come from the module. */
  async #range(
    message: Message,
    data: Uint8Array,
    native: NativeStream,
    follows: boolean,
  ): Promise<Uint16Array | null> {
    const section = needed(message, Section.RANGE, "ranges");
    const [step, rest] = splitStep(section);
    if (message.codec === Codec.zstd) return readZstdRanges(section, native.returns);
    if (message.codec === Codec.png) return pngRanges(rest, step, message.width, native.returns);
    const coded = message.codec === Codec.riddle ? rest.subarray(1 + NAME_BYTES) : rest;
    native.ranges(partOf(data, coded), step, follows);
    return null;
  }

  /** Makes the module code with the networks that a message of riddle names. */
  async #learn(message: Message, native: NativeStream, follows: boolean): Promise<void> {
    const brought = message.section(Section.WEIGHTS);
    if (brought) this.#shelf.put(readWeights(brought));
    const [, rest] = splitStep(needed(message, Section.RANGE, "ranges"));
    if (rest.length < 1 + NAME_BYTES) throw new DecodeError("truncated", "ranges end within their head");
    const effort = rest[0];
    if (effort < 1 || effort > 4) throw new DecodeError("version", `ranges of effort ${effort}`);
    const name = hex(rest.subarray(1, 1 + NAME_BYTES));
    const learned = effort === PLAIN ? "plain" : `${name} ${effort}`;
    if (learned === this.#learned) return;
    if (follows) throw damaged("other weights than those of the frame before, which it goes on from");
    native.networks(effort === PLAIN ? null : networksOf(await this.#shelf.find(name), effort));
    this.#learned = learned;
  }
}

/** Numbers of the codecs that are decoded here. */
export const DECODES: Readonly<Record<number, true>> = {
  [Codec.raw]: true,
  [Codec.zstd]: true,
  [Codec.png]: true,
  [Codec.riddle]: true,
  [Codec.predictive]: true,
};

/** A frame in its own columns, with returns made up between those that were sent, if that is wanted. */
function whole(image: Image, lattice: Lattice | null, fill: boolean): Image {
  if (lattice === null) return image;
  const range = widened(image.range, ROWS, lattice);
  const intensity = image.intensity && widened(image.intensity, ROWS, lattice);
  const azimuth = widenedAzimuth(image.azimuth, lattice);
  const made = fill ? filled(range, intensity, lattice)[0] : null;
  return { ...image, width: lattice.width, range, intensity, azimuth, filled: made };
}

function partOf(data: Uint8Array, section: Uint8Array): Part {
  return { at: section.byteOffset - data.byteOffset, size: section.length };
}

/** As the message has it. */
function poseOf(message: Message): Uint8Array | null {
  return readPose(message) && message.section(Section.POSE);
}

async function pngRanges(data: Uint8Array, step: number, width: number, returns: Uint8Array): Promise<Uint16Array> {
  const ranges = new Uint16Array(returns.length);
  const mask = returns.slice();
  if (!mask.includes(1)) {
    if (data.length > 0) throw damaged("ranges where there are no returns");
    return ranges;
  }
  const indices = await readPng(data, width);
  for (let i = 0; i < ranges.length; i++) if (mask[i]) ranges[i] = rangeOf(indices[i], step);
  return ranges;
}
