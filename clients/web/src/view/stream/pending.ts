/** The picture that the graphics card is drawing: nothing is asked of it before that one is done. */

export class Pending {
  #fence: WebGLSync | null = null;
  #since = 0;
  #unseen = false;
  readonly #shown: (() => void)[] = [];

  constructor(private readonly gl: WebGL2RenderingContext) {}

  /** Nobody sees the page: how long this picture takes says nothing. */
  unseen(): void {
    this.#unseen = true;
  }

  /** A picture was asked for at `now`; `shown` are called when it is there. */
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

  /** Milliseconds that the picture took if it is done by now; null while it is not, or there is none. */
  done(now: number): number | null {
    const { gl } = this;
    if (!this.#fence) return null;
    const lost = gl.isContextLost();
    if (!lost && gl.getSyncParameter(this.#fence, gl.SYNC_STATUS) !== gl.SIGNALED) return null;
    this.end();
    return lost || this.#unseen ? null : now - this.#since;
  }

  /** Wait no longer. */
  end(): void {
    this.gl.deleteSync(this.#fence);
    this.#fence = null;
    for (const shown of this.#shown) shown();
    this.#shown.length = 0;
  }
}
