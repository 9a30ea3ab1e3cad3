/** Decodes the messages of one stream with the page's decoder, without waiting: a converter of Foxglove gives its answer at once.
 *
 * Foxglove plays in order, but it also jumps, and several panels ask for the same message. So results of the last messages are
 * kept, and a message whose reference was not decoded just before is refused: the next key message decodes again. */

import { DecodeError } from "../../typescript/src/errors.js";
import { Referable } from "../../typescript/src/history.js";
import { Codec, type Message, Section } from "../../typescript/src/message.js";
import { type DescribedSensor, readDescribed } from "../../typescript/src/other/calibration.js";
import { readCloudFrame } from "../../typescript/src/other/frame.js";
import { SensorBook } from "../../typescript/src/sensor.js";
import { sha256 } from "../../typescript/src/sha256.js";
import { factsOf, factsOfRings, packImage, type SensorFacts } from "../../web/src/decode/worker/image.js";
import { NativeStream } from "../../web/src/decode/worker/native.js";
import { parseFrame, type RangeFrame } from "../../web/src/view/stream/frame.js";
import { type SensorTable, sensorTable } from "../../web/src/view/stream/sensor.js";

export type Decoded = DecodedFrame | DecodedCloud;

export interface DecodedFrame {
  /** Null for a frame without columns. */
  readonly frame: RangeFrame | null;
  readonly table: SensorTable;
}

/** A point cloud that came from a driver, as its message. */
export interface DecodedCloud {
  readonly payload: Uint8Array;
}

/** Names of all codecs, by number (docs/wire-format.md). */
const NAMES: Readonly<Record<number, string>> = {
  ...Object.fromEntries(Object.entries(Codec).map(([name, number]) => [number, name])),
  7: "jpeg-layered",
  8: "h264",
  9: "h264-log",
};
const DECODED_HERE: ReadonlySet<number> = new Set([Codec.raw, Codec.zstd, Codec.pcodec, Codec.predictive, Codec.riddle]);
/** Most results that are kept for panels that ask for a message again. Each takes half a megabyte. */
const KEPT = 8;

/** Throws DecodeError for a codec that is not decoded here, with its name. */
export function checkCodec({ codec }: Message): void {
  if (DECODED_HERE.has(codec)) return;
  const name = NAMES[codec] ?? `number ${codec}`;
  throw new DecodeError(
    "version",
    `codec ${name} is not decoded here, only raw, zstd, pcodec, predictive and riddle: use \`lidarcodec bridge foxglove\`, or ` +
      "record with another codec",
  );
}

/** What every stream is given: the compiled decoder, and the weight files of riddle that messages may name. */
export class Core {
  readonly module: WebAssembly.Module;
  readonly #weights: ReadonlyMap<string, Uint8Array>;

  constructor(module: WebAssembly.Module, weights: readonly Uint8Array[]) {
    this.module = module;
    this.#weights = new Map(weights.map((file) => [hex(sha256(file).subarray(0, 8)), file]));
  }

  /** The weight file of this name. Throws DecodeError if it is not here. */
  weights(name: string): Uint8Array {
    const file = this.#weights.get(name);
    if (file) return file;
    throw new DecodeError("reference", `weights ${name} are not here: they come with the next key message`);
  }
}

export class CodedStream {
  readonly #core: Core;
  readonly #kept = new Map<string, Decoded | DecodeError>();
  readonly #referable = new Referable<true>();
  #of = "";
  #native: NativeStream | null = null;
  #calibration: Uint8Array | null = null;
  #sensor: { readonly facts: SensorFacts; readonly table: SensorTable; readonly fitted: boolean } | null = null;

  #clouds = new SensorBook<DescribedSensor>([3], readDescribed);

  constructor(core: Core) {
    this.#core = core;
  }

  /** The frame of a message. Throws DecodeError, whatever the bytes, and goes on with the next key message. */
  decode(message: Message, data: Uint8Array): Decoded {
    const name = nameOf(message, data);
    const known = this.#kept.get(name);
    // One that lacked its reference may have it now, after a jump back.
    const again = known === undefined || (known instanceof DecodeError && known.code === "reference");
    const found = again ? this.#fresh(message, data) : known;
    keepLast(this.#kept, name, found, KEPT);
    if (found instanceof DecodeError) throw found;
    return found;
  }

  /** Why a message became no frame, if it was asked for before; else null. */
  problemOf(message: Message, data: Uint8Array): DecodeError | null {
    const known = this.#kept.get(nameOf(message, data));
    return known instanceof DecodeError ? known : null;
  }

  #fresh(message: Message, data: Uint8Array): Decoded | DecodeError {
    try {
      checkCodec(message);
      const of = `${message.codec} ${message.streamId} ${message.planes}`;
      if (this.#of !== of) {
        this.#forget();
        this.#calibration = this.#sensor = null;
        this.#clouds = new SensorBook<DescribedSensor>([3], readDescribed);
        this.#of = of;
      }
      this.#referable.of(message); // asked first: an error of the module ends it
    } catch (error) {
      return asDecodeError(error);
    }
    try {
      const decoded = this.#push(message, data);
      this.#referable.took(message, true, message.planes);
      return decoded;
    } catch (error) {
      this.#forget(); // the module may be in the middle of a message
      return asDecodeError(error);
    }
  }

  #forget(): void {
    this.#native = null;
    this.#referable.forget();
  }

  #push(message: Message, data: Uint8Array): Decoded {
    const native = this.#begun();
    if (message.section(Section.CLOUD)) {
      const readPlanes = (section: Uint8Array, columns: number) => native.planes(section, columns);
      return { payload: readCloudFrame(message, this.#clouds, readPlanes).cloud.payload };
    }
    for (let name = native.missingWeights(data); name !== ""; name = native.missingWeights(data))
      native.giveWeights(this.#core.weights(name));
    native.push(data);
    const calibration = message.section(Section.CALIBRATION);
    if (calibration && calibration[0] > 0) this.#calibration = calibration.slice();
    const { facts, table } = this.#sensorOf(native, message);
    const { streamId, index, stampNs, codec } = message;
    const image = { ...native.frame, streamId, index, stampNs, codec, filled: null, rangeStep: facts.range_step_m };
    const frame = message.width > 0 ? parseFrame(packImage({ ...image, pose: null }, 0)) : null;
    return { frame, table };
  }

  #begun(): NativeStream {
    if (this.#native === null) {
      this.#native = new NativeStream(this.#core.module);
      if (this.#calibration) this.#native.giveCalibration(this.#calibration);
    }
    return this.#native;
  }

  /** The geometry of other sensors than an HDL-64E is fitted to the first frame that has columns, as the page does it. Of an HDL-64E
   * it may change with each key message, though the table's hash does not: the hash is not of the convention. */
  #sensorOf(native: NativeStream, message: Message): { facts: SensorFacts; table: SensorTable } {
    const known = this.#sensor?.facts.hash === native.sensorHash ? this.#sensor : null;
    if (known && (message.planes ? known.fitted : !message.key)) return known;
    const rings = message.planes ? native.rings : null;
    const facts = rings ? factsOfRings(rings) : factsOf(native.sensor);
    this.#sensor = { facts, table: sensorTable(facts), fitted: message.width > 0 };
    return this.#sensor;
  }
}

function asDecodeError(error: unknown): DecodeError {
  if (error instanceof DecodeError) return error;
  return new DecodeError("section", `the decoder failed: ${error instanceof Error ? error.message : error}`);
}

/** Keeps a value as the last one of a map, and of all at most so many. */
export function keepLast<Value>(map: Map<string, Value>, name: string, value: Value, most: number): void {
  map.delete(name);
  map.set(name, value);
  for (const oldest of map.keys()) {
    if (map.size <= most) break;
    map.delete(oldest);
  }
}

/** Stream, frame and checksum. */
function nameOf({ streamId, index }: Message, data: Uint8Array): string {
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  return `${streamId} ${index} ${view.getUint32(data.length - 4, true)}`;
}

function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
