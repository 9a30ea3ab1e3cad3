/** Draws the tiles of a map: dim points under the live cloud. */
import { Program } from "../draw/gl";
import type { Theme } from "../draw/theme";
import { between, identity, type Matrix, type Pose } from "../matrix";
import type { MapTile, MapTiles } from "./tiles";

const INK = 0.45;
const SIZE = 0.75;
const VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 a_at;
uniform mat4 u_place;
uniform mat4 u_view;
uniform float u_size;
void main() {
  gl_Position = u_view * (u_place * vec4(a_at, 1.0));
  gl_PointSize = max(1.0, u_size * clamp(24.0 / max(gl_Position.w, 0.1), 0.8, 3.0));
}
`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 u_colour;
out vec4 o_colour;
void main() {
  o_colour = vec4(u_colour, 1.0);
}
`;

/** A tile on the card. */
interface Held {
  tile: MapTile;
  buffer: WebGLBuffer;
  array: WebGLVertexArrayObject;
}

export class MapLayer {
  readonly #program: Program;
  readonly #held = new Map<MapTile, Held>();
  readonly #place: Matrix = identity();

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.#program = new Program(gl, VERTEX, FRAGMENT);
  }

  /** Memory of the card that tiles take, in bytes. */
  get bytes(): number {
    let sum = 0;
    for (const { tile } of this.#held.values()) sum += tile.points.byteLength;
    return sum;
  }

  /** view: from metres at the sensor to the screen;  pose: of the sensor in the map;  size: of points, device pixels */
  draw(map: MapTiles | null, view: Matrix, pose: Pose | null, size: number, { paper, ink }: Theme): void {
    this.#hold(map === null ? [] : [...map.tiles.values()]);
    if (pose === null || this.#held.size === 0) return;
    const { gl } = this;
    const program = this.#program;
    gl.enable(gl.DEPTH_TEST);
    program.use();
    gl.uniformMatrix4fv(program.at("u_view"), false, view);
    gl.uniform1f(program.at("u_size"), SIZE * size);
    const [r, g, b] = [0, 1, 2].map((at) => (paper[at] as number) * (1 - INK) + (ink[at] as number) * INK);
    gl.uniform3f(program.at("u_colour"), r as number, g as number, b as number);
    for (const { tile, array } of this.#held.values()) {
      gl.uniformMatrix4fv(program.at("u_place"), false, between(this.#place, pose, tile.place));
      gl.bindVertexArray(array);
      gl.drawArrays(gl.POINTS, 0, tile.points.length / 3);
    }
    gl.bindVertexArray(null);
  }

  delete(): void {
    this.#hold([]);
    this.#program.delete();
  }

  /** Have these tiles on the card, and no others. */
  #hold(tiles: MapTile[]): void {
    const { gl } = this;
    for (const [tile, { buffer, array }] of this.#held) {
      if (tiles.includes(tile)) continue;
      gl.deleteVertexArray(array);
      gl.deleteBuffer(buffer);
      this.#held.delete(tile);
    }
    for (const tile of tiles) {
      if (this.#held.has(tile)) continue;
      const array = gl.createVertexArray();
      const buffer = gl.createBuffer();
      gl.bindVertexArray(array);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, tile.points, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.bindVertexArray(null);
      this.#held.set(tile, { tile, buffer, array });
    }
  }
}
