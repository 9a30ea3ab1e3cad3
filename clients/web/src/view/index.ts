/** The view of a stream: it reads the cloud socket and tells what came. */
import { CloudSocket } from "./socket";
import type { StreamName, View, ViewOptions, ViewStats } from "./types";

export type { Camera, Colour, StreamName, View, ViewOptions, ViewStats } from "./types";
export { DEFAULT_OPTIONS } from "./types";

const HEADER_POINTS = 48;
const HEADER_INDEX = 16;
const HEADER_LATENCY = 56;

export function createView(host: HTMLElement, options: ViewOptions): View {
  const text = document.createElement("p");
  host.append(text);
  let wanted = { ...options };
  let socket: CloudSocket | null = null;
  let tell: (stats: ViewStats) => void = () => {};
  let points = 0;
  let age: number | null = null;
  let index: number | null = null;
  let last = 0;
  let times: number[] = [];

  function stats(): void {
    const now = performance.now();
    times = times.filter((time) => now - time < 1000);
    const silent = index === null ? null : (now - last) / 1000;
    tell({
      points,
      fps: times.length,
      age_ms: age,
      frameIndex: index,
      stale: silent !== null && silent > 2,
      silent_s: silent,
      connection: socket?.state ?? "closed",
      problem: socket?.problem ?? null,
      alive: socket?.alive ?? null,
    });
  }

  const timer = window.setInterval(stats, 250);

  function close(): void {
    socket?.close();
    socket = null;
    points = 0;
    index = null;
    age = null;
    times = [];
    text.textContent = "";
  }

  return {
    open(stream: StreamName, token?: string) {
      close();
      socket = new CloudSocket(stream, token, (frame) => {
        const header = new DataView(frame);
        points = header.getUint32(HEADER_POINTS, true);
        index = Number(header.getBigUint64(HEADER_INDEX, true));
        const latency = header.getFloat32(HEADER_LATENCY, true);
        age = Number.isNaN(latency) ? null : latency;
        last = performance.now();
        times.push(last);
        text.textContent = `${points} points, ${wanted.colour}`;
      });
      stats();
    },
    close() {
      close();
      stats();
    },
    set(changed: Partial<ViewOptions>) {
      wanted = { ...wanted, ...changed };
    },
    onstats(callback) {
      tell = callback;
    },
    dispose() {
      close();
      window.clearInterval(timer);
      text.remove();
    },
  };
}
