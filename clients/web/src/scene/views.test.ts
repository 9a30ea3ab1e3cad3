import { describe, expect, test } from "vitest";
import { DEFAULT_OPTIONS } from "../view/types";
import { hashOf, readHash } from "./address";
import {
  checkedView,
  LONGEST_LINK,
  linkOf,
  MOST_VIEWS,
  optionsIn,
  type SavedView,
  viewOfLink,
  viewsIn,
  withView,
} from "./views";

const VIEW: SavedView = {
  name: "Einfahrt ⇄ Süd",
  stream: "car-7/roof",
  beside: ["car-7/left", "car-8/lidar"],
  stand: { yaw: 3.5, pitch: 0.6, distance: 52, x: 4, y: 0, z: 0 },
  box: { least: [-20, -10, -1], greatest: [40, 10, 5] },
  colour: "stream",
  camera: "orbit",
  pointSize: 1.5,
  trail: 2,
  rangeImage: false,
};

describe("a saved view", () => {
  test("comes back from a link as it was sent, umlauts and all", () => {
    expect(viewOfLink(linkOf(VIEW))).toEqual(VIEW);
    expect(readHash(hashOf(VIEW))).toEqual({ key: "car-7/roof", view: VIEW });
    expect(readHash("#/car-7/roof")).toEqual({ key: "car-7/roof", view: null });
    expect(hashOf(VIEW).length).toBeLessThan(800);
  });

  test("of a link that is broken, too long or another's is none, and the stream is shown all the same", () => {
    expect(readHash("#/car-7/roof?view=AAAA")).toEqual({ key: "car-7/roof", view: null });
    for (const hash of ["", "#/car-7", "#/a/b?other=1", "#/a/b/c", `#/a/b?view=${"A".repeat(2 * LONGEST_LINK)}`])
      expect(readHash(hash).view).toBeNull();
  });

  test.each([
    ["nothing", null],
    ["a number", 5],
    ["no name", { ...VIEW, name: "  " }],
    ["a stream that cannot be", { ...VIEW, stream: "../x" }],
    ["a colour that is none", { ...VIEW, colour: "__proto__" }],
    ["a camera without a place", { ...VIEW, stand: { yaw: 1 } }],
    ["a place that is no number", { ...VIEW, stand: { ...VIEW.stand, x: Number.POSITIVE_INFINITY } }],
  ])("is refused with %s", (_, value) => {
    expect(checkedView(value)).toBeNull();
  });

  test("is brought into its limits", () => {
    const wild = {
      ...VIEW,
      name: "x".repeat(99),
      pointSize: 1e9,
      trail: 2.6,
      beside: ["car-7/roof", "a/b", "a/b", "<", 5],
    };
    expect(checkedView(wild)).toMatchObject({ pointSize: 5, trail: 3, beside: ["a/b"] });
    expect(checkedView(wild)?.name).toHaveLength(40);
    expect(checkedView({ ...VIEW, box: "all" })?.box).toBeNull();
  });

  test("is kept by name, the newest first, and not more than thirty", () => {
    let views: SavedView[] = [];
    for (let number = 0; number < 40; number++) views = withView(views, { ...VIEW, name: `v${number}` });
    expect([views.length, views[0]?.name]).toEqual([MOST_VIEWS, "v39"]);
    views = withView(views, { ...VIEW, name: "v20", trail: 7 });
    expect([views.length, views[0]?.trail]).toEqual([MOST_VIEWS, 7]);
    expect(viewsIn(JSON.stringify(views))).toEqual(views);
    for (const text of [null, "", "{}", "[1, null]", "not JSON"]) expect(viewsIn(text)).toEqual([]);
  });
});

describe("options that the browser kept", () => {
  test("come back, without what belongs to the streams", () => {
    const options = { ...DEFAULT_OPTIONS, colour: "ring", trail: 3, pointSize: 4, fillGaps: false, map: "town" };
    const held = { ...options, box: VIEW.box, beside: [5], mount: 5, other: 1 };
    expect(optionsIn(JSON.stringify(held))).toEqual(options);
  });

  test("are brought into their limits", () => {
    const wild = { trail: 1e9, pointSize: -5, colour: "__proto__", camera: 7, compare: "yes", map: {}, measure: null };
    expect(optionsIn(JSON.stringify(wild))).toEqual({ ...DEFAULT_OPTIONS, trail: 10, pointSize: 0.5 });
  });

  test.each([null, "", "nonsense", "null", "5", "[]"])("are as at first for %j", (text) => {
    expect(optionsIn(text)).toEqual(DEFAULT_OPTIONS);
  });
});
