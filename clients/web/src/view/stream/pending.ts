/** The picture that the graphics card is drawing. The next one starts only when it is done. */

export class Pending {
  #fence: WebGLSync | null = null;
  #since = 0;
  #unseen = false;
  readonly #shown: (() => void)[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** The page is hidden, so the time of this picture means nothing. */
  unseen(): void {
    this.#unseen = true;
  }

  /** A picture was started at `now`; `shown` are called when it is done. */
  begin(now: number, shown: Iterable<() => void>): void {
    const { gl } = this;
    this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.#since = now;
    this.#unseen = false;
    this.#shown.push(...shown);
    gl.flush();
  }

  get drawing(): boolean {
    return this.#fence !== null;
  }

  /** Milliseconds that the picture took; null while it is not done, or if there is none. */
  done(now: number): number | null {
    const { gl } = this;
    if (!this.#fence) return null;
    const lost = gl.isContextLost();
    if (!lost && gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) !== gl.SIGNALED) return null;
    this.end();
    return lost || this.#unseen ? null : now - this.#since;
  }

  /** Stop waiting. */
  end(): void {
    this.gl.deleteSync(this.#fence);
    this.#fence = null;
    for (const shown of this.#shown) shown();
    this.#shown.length = 0;
  }
}
