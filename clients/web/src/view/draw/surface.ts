/** A picture with depth beside the screen's own, and its way onto the screen with shaded edges. */
import { FAR, NEAR } from "./camera";
import { Program } from "./gl";
import { COVER_VERTEX, SHADE_FRAGMENT } from "./shaders";

const STRENGTH = 5;

export class Surface {
  readonly #program: Program;
  #frame: WebGLFramebuffer | null = null;
  #colour: WebGLTexture | null = null;
  #depth: WebGLTexture | null = null;
  #wide = 0;
  #high = 0;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.#program = new Program(gl, COVER_VERTEX, SHADE_FRAGMENT);
  }

  get bytes(): number {
    return this.#wide * this.#high * 8;
  }

  /** Draw into it from now on. */
  begin(wide: number, high: number): void {
    const { gl } = this;
    if (wide !== this.#wide || high !== this.#high || !this.#frame) this.#take(wide, high);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#frame);
  }

  /** Put it onto the screen. */
  end(ratio: number): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, this.#wide, this.#high);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.#program.use();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.#colour);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, this.#depth);
    gl.uniform1i(this.#program.at("u_colour"), 0);
    gl.uniform1i(this.#program.at("u_depth"), 1);
    gl.uniform2f(this.#program.at("u_planes"), NEAR, FAR);
    gl.uniform1f(this.#program.at("u_reach"), Math.max(1, Math.round(ratio)));
    gl.uniform1f(this.#program.at("u_strength"), STRENGTH);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Give the memory back; it is taken again when it is needed. */
  rest(): void {
    const { gl } = this;
    gl.deleteFramebuffer(this.#frame);
    gl.deleteTexture(this.#colour);
    gl.deleteTexture(this.#depth);
    this.#frame = this.#colour = this.#depth = null;
    this.#wide = this.#high = 0;
  }

  delete(): void {
    this.rest();
    this.#program.delete();
  }

  #take(wide: number, high: number): void {
    this.rest();
    const { gl } = this;
    this.#wide = wide;
    this.#high = high;
    this.#colour = this.#texture(gl.RGBA8);
    this.#depth = this.#texture(gl.DEPTH_COMPONENT24);
    this.#frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.#colour, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.#depth, 0);
  }

  #texture(internal: number): WebGLTexture {
    const { gl } = this;
    const handle = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, handle);
    gl.texStorage2D(gl.TEXTURE_2D, 1, internal, this.#wide, this.#high);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return handle;
  }
}
