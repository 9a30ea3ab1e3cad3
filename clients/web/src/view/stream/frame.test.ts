import { describe, expect, test } from "vitest";
import { message } from "../testing";
import { coverageOf, FrameError, isEmpty, parseFrame } from "./frame";

describe("a message of the cloud socket", () => {
  test("becomes a frame whose arrays lie in the message itself", () => {
    const data = message({ columns: 3, index: 2 ** 33 + 5, intensity: true });
    const frame = parseFrame(data);
    expect(frame).toMatchObject({
      index: 2 ** 33 + 5,
      columns: 3,
      returns: 192,
      codec: 2,
      streamId: "0123456789abcdef",
    });
    expect(frame.range.buffer).toBe(data);
    expect([...frame.range.subarray(0, 4)]).toEqual([1, 2, 3, 4]);
    expect([...frame.azimuth]).toEqual([100, 117, 134, 100, 117, 134]);
    expect(frame.intensity?.[191]).toBe(191);
    expect(frame.original).toBeNull();
    expect(frame.pose).toBeNull();
    expect(frame.rangeStepM).toBeCloseTo(0.002);
  });

  test("keeps times to a thousandth of a millisecond", () => {
    expect(parseFrame(message({ stampNs: 1_793_000_000_123_456_789n })).stampMs).toBeCloseTo(1_793_000_000_123.4568, 3);
  });

  test("brings the pose and the original where they are sent, also behind a header that has grown", () => {
    const frame = parseFrame(message({ columns: 2, pose: true, original: true, header: 208 }));
    expect([...(frame.pose ?? [])]).toEqual([1, 0, 0, 10, 0, 1, 0, 20, 0, 0, 1, 30]);
    expect([...(frame.original ?? [])].slice(0, 3)).toEqual([2, 3, 4]);
  });

  test("says which returns were made up, and counts them apart", () => {
    const frame = parseFrame(message({ columns: 2, intensity: true, original: true, filled: true }));
    expect([...(frame.filled ?? [])].slice(0, 6)).toEqual([1, 0, 0, 0, 1, 0]);
    expect(frame.original?.[0]).toBe(2);
    expect([frame.returns, frame.madeUp]).toEqual([96, 32]);
    expect(parseFrame(message({ columns: 2 }))).toMatchObject({ filled: null, madeUp: 0 });
  });

  test("has as many rings as its sensor", () => {
    const frame = parseFrame(changed(message({ columns: 2 }), 78, 16));
    expect([frame.rings, frame.range.length]).toEqual([16, 32]);
  });

  test("without columns is shown, as a picture without returns: the next ones come only when it was", () => {
    const frame = parseFrame(message({ columns: 0, intensity: true, pose: true }));
    expect(frame).toMatchObject({ index: 7, columns: 1, rings: 64, returns: 0, madeUp: 0, intensity: null });
    expect([frame.range.length, Math.max(...frame.range), frame.azimuth.length]).toEqual([64, 0, 2]);
    expect(frame.pose?.[3]).toBe(10);
    expect([isEmpty(frame), isEmpty(parseFrame(message({ columns: 1 })))]).toEqual([true, false]);
  });

  test.each<[string, (data: ArrayBuffer) => ArrayBuffer]>([
    ["cut off", (data) => data.slice(0, data.byteLength - 1)],
    ["nothing", () => new ArrayBuffer(0)],
    ["of form points", (data) => changed(data, 3, 0x50)],
    ["of another version", (data) => changed(data, 4, 2)],
    ["without columns, yet with returns", (data) => changed(data, 76, 0)],
    ["of more columns than it has", (data) => changed(data, 76, 200)],
    ["of more rings than any sensor has", (data) => changed(data, 78, 129)],
    ["without rings", (data) => changed(data, 78, 0)],
    ["with a header that ends within itself", (data) => changed(data, 6, 40)],
    ["with a pose where its header has no room", (data) => changed(data, 42, 33)],
  ])("that is %s is refused, not shown", (_, spoil) => {
    expect(() => parseFrame(spoil(message({ columns: 3, intensity: true })))).toThrow(FrameError);
  });
});

function changed(data: ArrayBuffer, at: number, value: number): ArrayBuffer {
  const copy = data.slice(0);
  new DataView(copy).setUint8(at, value);
  return copy;
}

test("a frame knows what part of a turn it is, whatever the sensor's speed", () => {
  const turn = (columns: number, degrees: number) => {
    const azimuth = Uint16Array.from(
      { length: 2 * columns },
      (_, at) => (35000 + ((at % columns) * degrees * 100) / columns) % 36000,
    );
    return coverageOf({ azimuth, columns });
  };
  expect(turn(2088, 360)).toBeCloseTo(1, 2);
  expect(turn(1044, 360)).toBeCloseTo(1, 2);
  expect(turn(174, 30)).toBeCloseTo(1 / 12, 2);
});
