/** Frames that the page decodes itself. Those of a stream that it cannot decode are asked for decoded, from the server,
 * until there is another stream, or another codec that the page knows; `note` says so. */

import { parseFrame } from "../view/stream/frame";
import { type SensorTable, sensorTable } from "../view/stream/sensor";
import { CloudSocket, type Reception } from "../view/stream/socket";
import type { FrameSource, Sink, SourceOptions } from "../view/stream/source";
import { createDecoder, DECODED_HERE, DecodeFailure } from "./index";

/** Whether a frame from the server is one that the page should try to decode itself again. The first frame tells which codec
 * of which stream was refused: that one is not tried again, though the page may know the codec, in an older kind. */
export function afterRefusal(): (frame: { codec: number; streamId: string }) => boolean {
  let refused: string | null = null;
  return ({ codec, streamId }) => {
    const of = `${codec} ${streamId}`;
    refused ??= of;
    return of !== refused && DECODED_HERE.has(codec);
  };
}

export class DecodingSource implements FrameSource {
  note: string | null = null;
  #socket: CloudSocket;
  #ended = false;

  constructor(
    private readonly options: SourceOptions,
    private readonly sink: Sink,
  ) {
    this.#socket = this.#here();
  }

  get connection(): FrameSource["connection"] {
    return this.#socket.connection;
  }

  get problem(): string | null {
    return this.#socket.problem;
  }

  get alive(): boolean | null {
    return this.#socket.alive;
  }

  get clockAheadMs(): number {
    return this.#socket.clockAheadMs;
  }

  close(): void {
    this.#ended = true;
    this.#socket.close();
  }

  #here(): CloudSocket {
    const { token, fill } = this.options;
    const decoder = createDecoder({ token, fill });
    let known = -1;
    let table: SensorTable | null = null;
    const reception: Reception = {
      name: "frames",
      query: { window: "2" },
      ahead: false,
      take: (data, _, give, fail) => {
        decoder
          .push(data)
          .then(({ data: image, sensor, told }) => {
            if (table === null || told !== known) table = sensorTable(sensor);
            known = told;
            give(parseFrame(image), table);
          })
          .catch((error: unknown) => {
            if (error instanceof DecodeFailure && error.code === "version") this.#elsewhere(error.message);
            else fail(error instanceof Error ? error : new Error(String(error)));
          });
      },
      end: () => decoder.dispose(),
    };
    return new CloudSocket(this.options, this.sink, reception);
  }

  /** The server decodes, until there is something else to try here. */
  #elsewhere(why: string): void {
    if (this.#ended) return;
    this.#socket.close();
    this.note = `The server decodes this stream: ${why}.`;
    const { sink } = this;
    const another = afterRefusal();
    const watched: Sink = {
      frame: (frame, sensor, shown) => {
        if (another(frame)) this.#back();
        else sink.frame(frame, sensor, shown);
      },
      restarted: () => sink.restarted(),
      located: (told) => sink.located?.(told),
      changed: () => sink.changed(),
    };
    this.#socket = new CloudSocket(this.options, watched);
    sink.changed();
  }

  #back(): void {
    if (this.#ended) return;
    this.#socket.close();
    this.note = null;
    this.#socket = this.#here();
    this.sink.changed();
  }
}
