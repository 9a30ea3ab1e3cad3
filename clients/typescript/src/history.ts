/** What messages refer to: which frames, and their masks (docs/wire-format.md, "Which frames a message may refer to"). */

import type { Columns } from "./azimuth.js";
import { DecodeError } from "./errors.js";
import type { Message } from "./message.js";
import { ROWS, type Sensor } from "./sensor.js";

const STEP = 18;
const DIRECTIONS = 2000;

/** The mask that was last sent in each of 2000 directions. */
export class MaskHistory {
  readonly #sent: Uint8Array;

  constructor(sent = new Uint8Array(ROWS * DIRECTIONS)) {
    this.#sent = sent;
  }

  copy(): MaskHistory {
    return new MaskHistory(this.#sent.slice());
  }

  /** 64 x W: the bit of the direction of each cell. */
  before({ width, azimuth }: Columns, sensor: Sensor): Uint8Array {
    const seen = new Uint8Array(ROWS * width);
    for (let row = 0; row < ROWS; row++)
      for (let column = 0; column < width; column++)
        seen[row * width + column] = this.#sent[row * DIRECTIONS + direction(azimuth[sensor.half[row] * width + column])];
    return seen;
  }

  remember(mask: Uint8Array, { width, azimuth }: Columns, sensor: Sensor): void {
    for (let row = 0; row < ROWS; row++)
      for (let column = 0; column < width; column++)
        this.#sent[row * DIRECTIONS + direction(azimuth[sensor.half[row] * width + column])] = mask[row * width + column];
  }
}

function direction(azimuth: number): number {
  return Math.floor(azimuth / STEP);
}

const MOST = 5;

/** The list of the frames that a message may refer to, each with what is remembered after it. */
export class Referable<Memory> {
  #list: { readonly index: bigint; readonly memory: Memory }[] = [];

  forget(): void {
    this.#list = [];
  }

  /** What is remembered after the frame that a message needs; null if it needs none. Throws DecodeError if that frame is not in
   * the list. */
  of({ index, needs }: Message): Memory | null {
    if (needs === null) return null;
    const found = this.#list.find((one) => one.index === needs);
    if (found === undefined) throw new DecodeError("reference", `frame ${index} needs frame ${needs}: ask for a key message`);
    this.#list = [...this.#list.filter((one) => one !== found), found];
    return found.memory;
  }

  /** A message was decoded, with this memory after it. alone: the next one may refer to its frame only */
  took({ index, needs }: Message, memory: Memory, alone = false): void {
    if (needs === null || alone) this.#list = [];
    this.#list = [...this.#list, { index, memory }].slice(-MOST);
  }
}
