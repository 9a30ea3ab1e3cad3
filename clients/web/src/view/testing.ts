/** Messages of the cloud socket for tests, as docs/live-sockets.md describes them. */

export interface Wanted {
  columns?: number;
  index?: number;
  stampNs?: bigint;
  intensity?: boolean;
  original?: boolean;
  pose?: boolean;
  /** Every fourth return is made up. */
  filled?: boolean;
  header?: number;
}

const POSE = [1, 0, 0, 10, 0, 1, 0, 20, 0, 0, 1, 30];

/** Ranges count from 1 on; originals are one step more, intensities one less; azimuths 0.17 degree apart from 1 degree. */
export function message(wanted: Wanted = {}): ArrayBuffer {
  const {
    columns = 4,
    index = 7,
    stampNs = 0n,
    intensity = false,
    original = false,
    pose = false,
    filled = false,
  } = wanted;
  const header = wanted.header ?? (pose ? 192 : 96);
  const cells = 64 * columns;
  const padded = (bytes: number) => (bytes + 3) & ~3;
  const azimuthAt = header + 2 * cells;
  const intensityAt = azimuthAt + padded(4 * columns);
  const originalAt = intensityAt + (intensity ? padded(cells) : 0);
  const filledAt = originalAt + (original ? 2 * cells : 0);
  const data = new ArrayBuffer(filledAt + (filled ? cells : 0));
  const view = new DataView(data);
  for (const [at, letter] of [..."LDCR"].entries()) view.setUint8(at, letter.charCodeAt(0));
  view.setUint16(4, 1, true);
  view.setUint16(6, header, true);
  view.setBigUint64(8, 0x0123456789abcdefn, true);
  view.setBigUint64(16, BigInt(index), true);
  view.setBigInt64(24, stampNs, true);
  view.setUint16(40, 2, true);
  view.setUint16(42, (intensity ? 1 : 0) | (original ? 16 : 0) | (pose ? 32 : 0) | (filled ? 192 : 0), true);
  view.setUint32(44, cells, true);
  view.setUint32(48, filled ? cells - cells / 4 : cells, true);
  view.setFloat32(60, 0.002, true);
  view.setUint16(76, columns, true);
  view.setUint16(78, 64, true);
  view.setUint32(80, data.byteLength, true);
  for (const [at, value] of (pose ? POSE : []).entries()) view.setFloat64(96 + 8 * at, value, true);
  for (let cell = 0; cell < cells; cell++) view.setUint16(header + 2 * cell, cell + 1, true);
  for (let at = 0; at < 2 * columns; at++) view.setUint16(azimuthAt + 2 * at, 100 + 17 * (at % columns), true);
  for (let cell = 0; intensity && cell < cells; cell++) view.setUint8(intensityAt + cell, cell & 255);
  for (let cell = 0; original && cell < cells; cell++) view.setUint16(originalAt + 2 * cell, cell + 2, true);
  for (let cell = 0; filled && cell < cells; cell += 4) view.setUint8(filledAt + cell, 1);
  return data;
}
