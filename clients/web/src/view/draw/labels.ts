/** Distances written on the ground, drawn once into a texture. */

import type { Matrix } from "../matrix";
import { formats, Program, Texture } from "./gl";
import { LABEL_FRAGMENT, LABEL_VERTEX } from "./shaders";
import type { Colour3 } from "./theme";

const RADII_M = [10, 20, 40, 60, 80, 100] as const;
const WIDTH = 128;
const HEIGHT = 40;

export class Labels {
  readonly #program: Program;
  readonly #texture: Texture;

  constructor(private readonly gl: WebGL2RenderingContext) {
    this.#program = new Program(gl, LABEL_VERTEX, LABEL_FRAGMENT);
    this.#texture = new Texture(gl, formats(gl).rgba8, WIDTH, HEIGHT * RADII_M.length, true);
    const canvas = document.createElement("canvas");
    canvas.width = WIDTH;
    canvas.height = HEIGHT * RADII_M.length;
    const pen = canvas.getContext("2d");
    if (!pen) return;
    pen.font = "500 26px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillStyle = "#fff";
    RADII_M.forEach((radius, row) => {
      pen.fillText(`${radius} m`, WIDTH / 2, (row + 0.5) * HEIGHT);
    });
    this.#texture.write(pen.getImageData(0, 0, canvas.width, canvas.height).data);
  }

  /** high: of the window, in device pixels;  ratio: device pixels of a CSS pixel */
  draw(view: Matrix, ground: number, wide: number, high: number, ratio: number, ink: Colour3): void {
    const { gl } = this;
    const program = this.#program;
    program.use();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.#texture.handle);
    gl.uniform1i(program.at("u_text"), 0);
    gl.uniformMatrix4fv(program.at("u_view"), false, view);
    gl.uniform3f(program.at("u_ink"), ink[0], ink[1], ink[2]);
    gl.uniform2f(program.at("u_half"), ((0.5 * WIDTH * ratio) / 2 / wide) * 2, ((0.5 * HEIGHT * ratio) / 2 / high) * 2);
    for (let row = 0; row < RADII_M.length; row++) {
      gl.uniform3f(program.at("u_at"), RADII_M[row] as number, 0, ground + 0.1);
      gl.uniform4f(program.at("u_part"), 0, row / RADII_M.length, 1, 1 / RADII_M.length);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
  }

  delete(): void {
    this.#program.delete();
    this.#texture.delete();
  }
}
