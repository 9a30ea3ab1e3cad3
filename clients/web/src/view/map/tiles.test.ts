import { afterEach, beforeEach, expect, test, vi } from "vitest";
import type { Pose } from "../matrix";
import { MapTiles } from "./tiles";

const pose = (x: number, y: number): Pose => new Float64Array([1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, 0]);
const settled = () => new Promise((resolve) => setTimeout(resolve, 5));
let asked: string[] = [];
let places: { x: number; y: number; hash: string }[] = [];
let points: (place: string) => Response;

beforeEach(() => {
  asked = [];
  places = [
    { x: 3, y: 0, hash: "far" },
    { x: 0, y: 0, hash: "near" },
  ];
  points = () => new Response(new Float32Array([1, 2, 3]).buffer);
  vi.stubGlobal("document", { baseURI: "http://server/prefix/" });
  vi.stubGlobal("fetch", async (address: URL, { headers }: { headers: Record<string, string> }) => {
    asked.push(address.pathname + (headers.Authorization ?? ""));
    const found = /\/town\/(-?\d+\/-?\d+)$/.exec(address.pathname);
    return found ? points(found[1] as string) : Response.json({ tile_m: 50, places });
  });
});
afterEach(() => vi.unstubAllGlobals());

test("tiles around the pose come, the nearest first, and once", async () => {
  let changes = 0;
  const map = new MapTiles("town", "secret", () => changes++);
  map.move(pose(1, 1), 0);
  map.move(pose(2, 1), 1);
  await settled();
  expect(asked).toEqual(["town", "town/0/0", "town/3/0"].map((tail) => `/prefix/api/v1/maps/${tail}Bearer secret`));
  expect([...map.tiles.keys()]).toEqual(["0/0", "3/0"]);
  expect([...(map.tiles.get("3/0")?.place ?? [])]).toEqual([...pose(150, 0)]);
  expect(map.note).toBeNull();
  expect(changes).toBeGreaterThan(1);
  map.move(pose(5, 1), 100);
  await settled();
  expect(asked.length).toBe(3);
});

test("only tiles that changed are fetched again, and those that are far away are dropped", async () => {
  const map = new MapTiles("town", undefined, () => {});
  map.move(pose(1, 1), 0);
  await settled();
  places = [{ x: 0, y: 0, hash: "other" }];
  map.move(pose(1, 1), 20_000);
  await settled();
  expect(asked.slice(3)).toEqual(["/prefix/api/v1/maps/town", "/prefix/api/v1/maps/town/0/0"]);
  expect([...map.tiles.keys()]).toEqual(["0/0"]);
});

test("a stream without poses, no tiles and answers that make no sense are told", async () => {
  const map = new MapTiles("town", undefined, () => {});
  map.move(null, 0);
  expect(map.note).toContain("no poses");
  points = () => new Response(new Uint8Array(7));
  map.move(pose(1, 1), 0);
  await settled();
  expect(map.note).toContain("are no points");
  points = () => Response.json({ detail: "there is no map 'town'" }, { status: 404 });
  map.move(pose(100, 1), 0);
  await settled();
  expect(map.note).toBe("Map town: 2 of 2 tiles are missing: there is no map 'town'");
  places = [];
  map.move(pose(900, 1), 0);
  await settled();
  expect(map.note).toContain("no tile around");
  map.close();
});

const row = (from: number, tiles: number) =>
  Array.from({ length: tiles }, (_, number) => ({ x: from + number, y: 0, hash: `${from + number}` }));

test("of more points than a card takes the nearest are drawn, wherever the vehicle went, and that is told", async () => {
  const full = new Float32Array(3 * 100_000).buffer;
  points = () => new Response(full);
  places = row(0, 24);
  const map = new MapTiles("town", undefined, () => {});
  map.move(pose(1, 1), 0);
  await vi.waitFor(() => expect(map.note).toBe("Map town: the nearest 20 of 24 tiles are drawn"));
  expect(map.tiles.has("0/0")).toBe(true);
  expect(map.tiles.has("20/0")).toBe(false);
  const before = asked.length;
  map.move(pose(24 * 50, 1), 20_000);
  await vi.waitFor(() => expect(map.tiles.has("0/0")).toBe(false));
  await settled();
  expect([...map.tiles.keys()].map(Number.parseFloat).sort((a, b) => a - b)).toEqual(row(4, 20).map(({ x }) => x));
  expect(asked.length - before).toBe(1 + 4);
});

test("tiles that cannot be had keep no others away, and are counted", async () => {
  points = (place) =>
    place.startsWith("0") || place.startsWith("1")
      ? Response.json({ detail: `tile ${place} of map 'town' is damaged` }, { status: 507 })
      : new Response(new Float32Array([1, 2, 3]).buffer);
  places = row(0, 5);
  const map = new MapTiles("town", undefined, () => {});
  map.move(pose(1, 1), 0);
  await settled();
  expect([...map.tiles.keys()]).toEqual(["2/0", "3/0", "4/0"]);
  expect(map.note).toBe("Map town: 2 of 5 tiles are missing: tile 0/0 of map 'town' is damaged");
});

test("a server that does not answer is not asked for the other tiles", async () => {
  points = () => {
    throw new TypeError("Failed to fetch");
  };
  places = row(0, 9);
  const map = new MapTiles("town", undefined, () => {});
  map.move(pose(1, 1), 0);
  await settled();
  expect(map.note).toBe("Map town: Failed to fetch");
  expect(asked.length).toBe(3);
});
