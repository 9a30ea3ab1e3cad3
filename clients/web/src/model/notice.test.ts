import { expect, test } from "vitest";
import { noticeOf } from "./notice";

const LIVE = { connection: "open", problem: null, silent_s: 0.1, stale: false } as const;
const NOTHING = { connection: "opening", problem: null, silent_s: null, stale: false } as const;
const THERE = { alive: true, ended: false };

test("nothing stands over a picture that is live", () => {
  expect(noticeOf(LIVE, "car-7/lidar", [THERE], THERE)).toEqual(["", ""]);
});

test("a server without vehicles is told from a choice that is to be made", () => {
  expect(noticeOf(null, null, [], null)[0]).toBe("There is no vehicle yet.");
  expect(noticeOf(null, null, [THERE], null)[0]).toBe("No stream is chosen.");
});

test("a stream that the server does not know is no lost connection", () => {
  const refused = { ...NOTHING, connection: "waiting", problem: "no such stream" } as const;
  expect(noticeOf(refused, "car-8/lidar", [THERE], null)[0]).toContain("does not know car-8/lidar");
});

test("a server that refuses is quoted", () => {
  const full = {
    ...NOTHING,
    connection: "waiting",
    problem: "the server accepts no more viewers at the moment",
  } as const;
  expect(noticeOf(full, "car-7/lidar", [THERE], THERE)[0]).toContain("accepts no more viewers");
});

test("a browser that cannot draw is not blamed on the server", () => {
  const unable = { ...NOTHING, connection: "unable", problem: "This browser does not offer WebGL 2." } as const;
  expect(noticeOf(unable, "car-7/lidar", [THERE], THERE)[0]).toBe("This browser does not offer WebGL 2.");
});

test("an old picture says since when and why", () => {
  const old = { ...LIVE, silent_s: 4, stale: true };
  expect(noticeOf(old, "car-7/lidar", [THERE], { alive: false, ended: false })).toEqual([
    "The picture is old: the vehicle is not connected.",
    "last frame 4 s ago · the vehicle is not connected",
  ]);
  expect(noticeOf({ ...old, connection: "waiting" }, "car-7/lidar", [THERE], THERE)[1]).toContain("no connection");
});
