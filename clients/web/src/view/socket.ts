/** The cloud socket of a stream, opened again when it breaks; a frame is acknowledged when it was taken. */
import type { StreamName, ViewStats } from "./types";

const AGAIN_MS = [500, 1000, 2000, 5000];

export class CloudSocket {
  state: ViewStats["connection"] = "opening";
  problem: string | null = null;
  alive: boolean | null = null;
  #socket: WebSocket | null = null;
  #timer = 0;
  #failures = 0;
  #ended = false;

  constructor(
    private readonly stream: StreamName,
    private readonly token: string | undefined,
    private readonly taken: (frame: ArrayBuffer) => void,
  ) {
    this.#open();
  }

  close(): void {
    this.#ended = true;
    this.state = "closed";
    window.clearTimeout(this.#timer);
    this.#socket?.close();
  }

  #open(): void {
    const { vehicle, sensor } = this.stream;
    const url = new URL(`api/v1/streams/${vehicle}/${sensor}/cloud`, document.baseURI);
    url.protocol = url.protocol.replace("http", "ws");
    const socket = new WebSocket(url, this.token ? ["lidarcodec", `lidarcodec.token.${this.token}`] : ["lidarcodec"]);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.state = "opening";
    socket.onopen = () => {
      this.state = "open";
      this.#failures = 0;
    };
    socket.onmessage = ({ data }: MessageEvent<ArrayBuffer | string>) => {
      if (typeof data === "string") {
        const { event } = JSON.parse(data) as { event: string };
        if (event === "alive" || event === "gone") this.alive = event === "alive";
        return;
      }
      this.taken(data);
      socket.send("ack");
    };
    socket.onclose = ({ code }) => {
      if (this.#ended) return;
      this.state = "waiting";
      if (code === 4401) {
        this.state = "refused";
        this.problem = "the token was revoked";
        return;
      }
      const wait = AGAIN_MS[Math.min(this.#failures, AGAIN_MS.length - 1)];
      this.#failures += 1;
      this.#timer = window.setTimeout(() => this.#open(), wait);
    };
  }
}
