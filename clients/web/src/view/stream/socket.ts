/** The cloud socket of a stream as a source of frames (docs/live-sockets.md), opened again when it breaks.
 *
 * A frame is acknowledged when it was drawn, and two may be under way. So a slow page gets fewer frames, but none of them
 * late. While the page is hidden the socket is closed, because nothing would be drawn. */
import type { PoseEvent } from "../map/where";
import { Backoff } from "./backoff";
import { parseFrame, type RangeFrame } from "./frame";
import { type SensorEvent, type SensorTable, sensorTable } from "./sensor";
import type { FrameSource, Sink, SourceOptions } from "./source";

const WINDOW = 2;
const HIDDEN_MS = 3000;
const TOKEN_REVOKED = 4401;

interface Told extends Partial<SensorEvent> {
  event: string;
  server_ns?: number;
}

/** The query of a stream's socket, and the conversion of its binary messages to frames. */
export interface Reception {
  readonly name: "cloud" | "frames";
  readonly query: Readonly<Record<string, string>>;
  /** Whether frames are decoded by the server's clock. */
  readonly ahead: boolean;
  /** Gives the frame of a message, now or later, or the reason why there is none; then the socket is reopened. */
  take(
    data: ArrayBuffer,
    sensor: SensorTable | null,
    give: (frame: RangeFrame, sensor: SensorTable) => void,
    fail: (error: Error) => void,
  ): void;
  /** No further messages will come. */
  end(): void;
}

const DECODED: Reception = {
  name: "cloud",
  query: { form: "range", window: `${WINDOW}` },
  ahead: true,
  take: (data, sensor, give) => sensor && give(parseFrame(data), sensor),
  end: () => {},
};

export class CloudSocket implements FrameSource {
  connection: FrameSource["connection"] = "opening";
  problem: string | null = null;
  alive: boolean | null = null;
  clockAheadMs = 0;
  #socket: WebSocket | null = null;
  #sensor: SensorTable | null = null;
  #timer = 0;
  #opened = false;
  readonly #backoff = new Backoff();
  readonly #ended = new AbortController();
  readonly #acknowledgement = new DataView(new ArrayBuffer(8));

  constructor(
    private readonly options: SourceOptions,
    private readonly sink: Sink,
    private readonly reception: Reception = DECODED,
  ) {
    const { signal } = this.#ended;
    window.addEventListener("online", () => this.#hurry(), { signal });
    document.addEventListener("visibilitychange", () => this.#looked(), { signal });
    this.#open();
  }

  close(): void {
    this.#ended.abort();
    this.#leave();
    this.reception.end();
    this.connection = "closed";
  }

  #leave(): void {
    window.clearTimeout(this.#timer);
    const socket = this.#socket;
    this.#socket = null;
    if (!socket) return;
    socket.onopen = socket.onmessage = socket.onclose = null;
    // A socket that is still opening is closed after that, because browsers log an error otherwise.
    if (socket.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close();
    else socket.close();
  }

  #path(name: string): URL {
    const { vehicle, sensor } = this.options.stream;
    const parts = [vehicle, sensor].map(encodeURIComponent).join("/");
    return new URL(`api/v1/streams/${parts}${name}`, document.baseURI);
  }

  #open(): void {
    const url = this.#path(`/${this.reception.name}`);
    url.protocol = url.protocol.replace("http", "ws");
    for (const [option, value] of Object.entries(this.reception.query)) url.searchParams.set(option, value);
    if (this.reception.name === "cloud") {
      const { original, fill } = this.options;
      url.searchParams.set("attributes", original ? "intensity,original,filled" : "intensity,filled");
      url.searchParams.set("fill", fill ? "1" : "0");
    }
    const { token } = this.options;
    const socket = new WebSocket(url, token ? ["lidarcodec", `lidarcodec.token.${token}`] : ["lidarcodec"]);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#opened = false;
    this.#state("opening");
    socket.onopen = () => {
      this.#opened = true;
      this.#state("open");
    };
    socket.onmessage = ({ data }: MessageEvent<ArrayBuffer | string>) => {
      try {
        if (typeof data === "string") this.#event(data);
        else this.#frame(socket, data);
      } catch (error) {
        this.problem = error instanceof Error ? error.message : String(error);
        socket.close(); // the other side does not speak our protocol: try again with increasing pauses
      }
    };
    socket.onclose = ({ code, reason }) => void this.#closed(code, reason);
  }

  #frame(socket: WebSocket, data: ArrayBuffer): void {
    const give = (frame: RangeFrame, sensor: SensorTable) => {
      if (socket !== this.#socket) return; // too late: another socket is in use
      this.#backoff.reset();
      this.problem = null;
      this.sink.frame(frame, sensor, () => this.#acknowledge(socket, frame.index));
    };
    const fail = (error: Error) => {
      this.problem = error.message;
      socket.close(); // a new socket begins with a key message
    };
    this.reception.take(data, this.#sensor, give, fail);
  }

  #acknowledge(socket: WebSocket, index: number): void {
    if (socket.readyState !== WebSocket.OPEN) return;
    this.#acknowledgement.setUint32(0, index % 0x100000000, true);
    this.#acknowledgement.setUint32(4, Math.floor(index / 0x100000000), true);
    socket.send(this.#acknowledgement.buffer as ArrayBuffer);
  }

  #event(text: string): void {
    const told = JSON.parse(text) as Told;
    if (told.event === "sensor") this.#sensor = sensorTable(told);
    if (told.event === "hello" && told.server_ns && this.reception.ahead)
      this.clockAheadMs = told.server_ns / 1e6 - Date.now();
    else if (told.event === "restarted") this.sink.restarted();
    else if (told.event === "pose") this.sink.located?.(told as unknown as PoseEvent);
    else if (told.event === "alive" || told.event === "gone") {
      this.alive = told.event === "alive";
      this.sink.changed();
    }
  }

  /** The browser does not tell why a handshake was refused, so ask the stream's own address. */
  async #closed(code: number, reason: string): Promise<void> {
    this.#socket = null;
    if (code === TOKEN_REVOKED) {
      this.problem = "the token is no longer valid";
      this.#state("refused");
      return;
    }
    if (reason) this.problem = reason;
    this.#state("waiting");
    if (!this.#opened && (await this.#refused())) return;
    if (this.#ended.signal.aborted || document.hidden) return;
    this.#timer = window.setTimeout(() => this.#open(), this.#backoff.next(Math.random()));
  }

  async #refused(): Promise<boolean> {
    const headers: Record<string, string> = { Accept: "application/json" };
    if (this.options.token) headers.Authorization = `Bearer ${this.options.token}`;
    const { signal } = this.#ended;
    try {
      const answer = await fetch(this.#path(""), { headers, cache: "no-store", signal });
      if (answer.ok) {
        this.problem = "the server accepts no more viewers at the moment";
      } else {
        const problem = (await answer.json().catch(() => ({}))) as { detail?: string };
        this.problem = problem.detail ?? `the server answered ${answer.status}`;
      }
      if (answer.status !== 401 && answer.status !== 403) return false;
    } catch {
      this.problem = "the server does not answer";
      return false;
    }
    this.#state("refused");
    return true;
  }

  #hurry(): void {
    if (this.connection !== "waiting" || document.hidden) return;
    window.clearTimeout(this.#timer);
    this.#backoff.reset();
    this.#open();
  }

  #looked(): void {
    if (this.connection === "refused") return;
    window.clearTimeout(this.#timer);
    if (!document.hidden) {
      if (!this.#socket) this.#open();
      return;
    }
    this.#timer = window.setTimeout(() => {
      this.#leave();
      this.problem = null;
      this.#state("waiting");
    }, HIDDEN_MS);
  }

  #state(connection: FrameSource["connection"]): void {
    this.connection = connection;
    if (connection === "open") this.problem = null;
    if (!this.#ended.signal.aborted) this.sink.changed();
  }
}
