/** Programs, textures and what they are called by, of WebGL 2. */

export class GlError extends Error {}

/** A program and where its uniforms are, by name without array or prefix. */
export class Program {
  readonly #handle: WebGLProgram;
  readonly #places = new Map<string, WebGLUniformLocation>();

  constructor(
    private readonly gl: WebGL2RenderingContext,
    vertex: string,
    fragment: string,
    captured?: string[],
  ) {
    const handle = gl.createProgram();
    const shaders = [compiled(gl, gl.VERTEX_SHADER, vertex), compiled(gl, gl.FRAGMENT_SHADER, fragment)];
    for (const shader of shaders) gl.attachShader(handle, shader);
    if (captured) gl.transformFeedbackVaryings(handle, captured, gl.SEPARATE_ATTRIBS);
    gl.linkProgram(handle);
    if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new GlError(gl.getProgramInfoLog(handle) ?? "a program could not be linked");
    }
    for (const shader of shaders) gl.deleteShader(shader);
    const count = (gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS) as number | null) ?? 0;
    for (let number = 0; number < count; number++) {
      const name = gl.getActiveUniform(handle, number)?.name;
      const place = name && gl.getUniformLocation(handle, name);
      if (name && place) this.#places.set(name, place);
    }
    this.#handle = handle;
  }

  /** Where a uniform is; null, which is allowed everywhere, if the shader does without it. */
  at(name: string): WebGLUniformLocation | null {
    return this.#places.get(name) ?? null;
  }

  use(): void {
    this.gl.useProgram(this.#handle);
  }

  delete(): void {
    this.gl.deleteProgram(this.#handle);
  }
}

function compiled(gl: WebGL2RenderingContext, kind: number, source: string): WebGLShader {
  const shader = gl.createShader(kind);
  if (!shader) throw new GlError("the graphics context is lost");
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new GlError(gl.getShaderInfoLog(shader) ?? "a shader could not be compiled");
  }
  return shader;
}

/** How the texels of a texture are kept, and how they are handed over. */
export interface Format {
  internal: number;
  format: number;
  type: number;
  bytes: number;
}

export function formats(gl: WebGL2RenderingContext) {
  return {
    u16: { internal: gl.R16UI, format: gl.RED_INTEGER, type: gl.UNSIGNED_SHORT, bytes: 2 },
    u8: { internal: gl.R8UI, format: gl.RED_INTEGER, type: gl.UNSIGNED_BYTE, bytes: 1 },
    rgba8: { internal: gl.RGBA8, format: gl.RGBA, type: gl.UNSIGNED_BYTE, bytes: 4 },
    rg32f: { internal: gl.RG32F, format: gl.RG, type: gl.FLOAT, bytes: 8 },
    rgba32f: { internal: gl.RGBA32F, format: gl.RGBA, type: gl.FLOAT, bytes: 16 },
  } satisfies Record<string, Format>;
}

/** A texture of fixed size, read texel by texel; its memory is taken once and written over. */
export class Texture {
  readonly handle: WebGLTexture;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly kind: Format,
    readonly width: number,
    readonly height: number,
    smooth = false,
  ) {
    this.handle = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.handle);
    gl.texStorage2D(gl.TEXTURE_2D, 1, kind.internal, width, height);
    const filter = smooth ? gl.LINEAR : gl.NEAREST;
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }

  get bytes(): number {
    return this.width * this.height * this.kind.bytes;
  }

  /** Put rows of `width` texels at the top left. */
  write(data: ArrayBufferView, width = this.width, height = this.height): void {
    const { gl, kind } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.handle);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, kind.format, kind.type, data);
  }

  delete(): void {
    this.gl.deleteTexture(this.handle);
  }
}
