/** A clip of the view as WebM, with the caption of pictures below it. It holds what is drawn, and ends by itself. */
import { Captioned, SPARE_LINES } from "./picture";
import type { Theme } from "./theme";

/** Longest clip, and most bytes of it: a browser holds it in memory. */
export const LONGEST_S = 30;
const MOST_BYTES = 64e6;
const FPS = 30;
const BITS_A_SECOND = 6e6;
const TYPES = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];

/** The kind of film that this browser makes; null if it makes none. */
export function filmType(): string | null {
  if (typeof MediaRecorder === "undefined") return null;
  return TYPES.find((type) => MediaRecorder.isTypeSupported(type)) ?? null;
}

export class Film {
  /** The clip, once it has ended; null if the browser gave none. */
  readonly done: Promise<Blob | null>;
  readonly #picture: Captioned;
  readonly #recorder: MediaRecorder;
  readonly #caption: (stampMs: number) => string;
  readonly #timer: number;
  #bytes = 0;
  #stampMs: number;

  /** canvas: as it was drawn in this task of the browser. Throws what the browser throws if it cannot begin. */
  constructor(
    canvas: HTMLCanvasElement,
    caption: (stampMs: number) => string,
    stampMs: number,
    theme: Theme,
    ratio: number,
    type: string,
  ) {
    this.#caption = caption;
    this.#stampMs = stampMs;
    this.#picture = new Captioned(theme, ratio, SPARE_LINES);
    this.add(canvas, stampMs);
    const stream = this.#picture.out.captureStream(FPS);
    this.#recorder = new MediaRecorder(stream, { mimeType: type, videoBitsPerSecond: BITS_A_SECOND });
    const parts: Blob[] = [];
    this.done = new Promise((done) => {
      this.#recorder.ondataavailable = ({ data }) => {
        parts.push(data);
        this.#bytes += data.size;
        if (this.#bytes > MOST_BYTES) this.stop();
      };
      const end = () => {
        for (const track of stream.getTracks()) track.stop();
        const file = new Blob(parts, { type: "video/webm" });
        done(file.size > 0 ? file : null);
      };
      this.#recorder.onstop = end;
      this.#recorder.onerror = end;
    });
    this.#recorder.start(1000);
    this.#timer = window.setTimeout(() => this.stop(), LONGEST_S * 1000);
  }

  get running(): boolean {
    return this.#recorder.state === "recording";
  }

  /** Add a picture that was drawn in this task of the browser. stampMs: of its frame; without one, of the last that came */
  add(canvas: HTMLCanvasElement, stampMs = this.#stampMs): void {
    this.#stampMs = stampMs;
    this.#picture.draw(canvas, this.#caption(stampMs));
  }

  /** End it. A second call does nothing. */
  stop(): void {
    window.clearTimeout(this.#timer);
    if (this.#recorder.state !== "inactive") this.#recorder.stop();
  }
}
