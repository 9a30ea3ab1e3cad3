/** The REST section (docs/wire-format-other-sensors.md): what packets hold beside planes. The bytes of odd packets are
 * skipped. */

import { damaged } from "../errors.js";
import { NumberModel, RangeDecoder } from "../rangecoder.js";
import { zstdFrame } from "../zstd.js";
import { Reader } from "./reader.js";

const MOST_NUMBERS = 1_572_864;
const MOST_ODD_BYTES = 65_507n;
const MOST_ODD_TOTAL = 33_554_432n;
const WIDEST = 1n << 60n;

export interface Rest {
  /** Of the packets that are not odd: docs/sensors.md, "Layouts". Empty if all are odd. */
  readonly layout: string;
  /** Host time of each packet less the frame's stamp, ns. */
  readonly packetNs: BigInt64Array;
  /** Numbers of packets, blocks or columns by name, such as `azimuth`, `time_us` or `measurement_id`. */
  readonly series: ReadonlyMap<string, BigUint64Array>;
  /** Places of the packets that have no place in images. */
  readonly odd: Uint16Array;
}

export function readRest(data: Uint8Array, packets: number): Rest {
  const reader = new Reader(data);
  const layout = reader.name(32);
  const step = BigInt(reader.varint(1_000_000_000, 1));
  const packetNs = readLine(reader, packets);
  for (let i = 0; i < packets; i++) {
    const time = packetNs[i]! * step;
    if (time <= -WIDEST || time >= WIDEST) throw damaged("host times of a frame's packets more than 36 years apart");
    packetNs[i] = time;
  }
  const series = new Map<string, BigUint64Array>();
  let left = MOST_NUMBERS;
  for (let more = reader.varint(64); more > 0; more--) {
    const name = reader.name(32);
    const type = reader.byte();
    if (type > 3 || series.has(name)) throw damaged(`a series '${name}' that comes twice, or of type ${type}`);
    const count = reader.varint(left);
    left -= count;
    series.set(name, readSeries(reader, 2 ** type, count));
  }
  const odd = readOdd(reader, packets);
  reader.end();
  return { layout, packetNs, series, odd };
}

/** Several series of signed numbers in one stream, each by models of its own. */
export function signedNumbers(data: Uint8Array, counts: number[]): BigInt64Array[] {
  const coder = new RangeDecoder(data);
  const found = counts.map((count) => {
    const model = new NumberModel();
    return BigInt64Array.from({ length: count }, () => {
      const number = model.decodeLong(coder);
      return number & 1n ? -(number >> 1n) - 1n : number >> 1n;
    });
  });
  coder.end();
  return found;
}

/** Adds to each number the one `lag` before it, from `from` on; modulo 2^64, as the array is. */
function addUp(values: BigInt64Array, from: number, lag: number): void {
  for (let i = from + lag; i < values.length; i++) values[i] = values[i]! + values[i - lag]!;
}

/** A line of so many numbers, modulo 2^64. */
export function readLine(reader: Reader, count: number): BigInt64Array {
  const form = reader.byte();
  if (form > 3) throw damaged(`a series of form ${form}`);
  const level = reader.signed(1n << 62n);
  const rate = reader.signed(1n << 45n);
  const [values] = signedNumbers(reader.sized(), [count]) as [BigInt64Array];
  if (form === 2) addUp(values, 1, 1);
  if (form === 1 || form === 2) addUp(values, 0, 1);
  if (form === 3) addUp(values, 0, 2);
  for (let i = 0; i < count; i++) values[i] = values[i]! + level + ((BigInt(i) * rate) >> 10n);
  return values;
}

function readSeries(reader: Reader, bytes: number, count: number): BigUint64Array {
  const kind = reader.byte();
  if (kind > 1) throw damaged(`a series of kind ${kind}`);
  if (kind === 0) {
    const most = bytes === 8 ? WIDEST : (1n << BigInt(8 * bytes)) - 1n;
    const values = readLine(reader, count);
    if (values.some((value) => value < 0n || value > most)) throw damaged("a series with numbers that do not fit");
    return new BigUint64Array(values.buffer);
  }
  const plain = zstdFrame(reader.sized(), count * bytes);
  const values = new BigUint64Array(count);
  for (let i = 0; i < count; i++)
    for (let byte = bytes; byte-- > 0; ) values[i] = (values[i]! << 8n) | BigInt(plain[i * bytes + byte]!);
  return values;
}

function readOdd(reader: Reader, packets: number): Uint16Array {
  const count = reader.varint(packets);
  if (count === 0) return new Uint16Array();
  const [places, sizes] = signedNumbers(reader.sized(), [count, count]) as [BigInt64Array, BigInt64Array];
  addUp(places, 0, 1);
  addUp(sizes, 0, 1);
  let total = 0n;
  for (let i = 0; i < count; i++) {
    if (places[i]! < 0n || places[i]! >= BigInt(packets) || (i > 0 && places[i]! <= places[i - 1]!))
      throw damaged("odd packets at places that are not ascending, or beyond the frame");
    total += sizes[i]!;
    if (sizes[i]! < 0n || sizes[i]! > MOST_ODD_BYTES || total > MOST_ODD_TOTAL)
      throw damaged("odd packets of more bytes than a frame may have");
  }
  for (let of = new Set(sizes.filter((size) => size > 0n)).size; of > 0; of--) {
    if (reader.byte() > 1) throw damaged("odd packets of an unknown kind");
    reader.sized();
  }
  return Uint16Array.from(places, Number);
}
