/** Draws the frames that are on the card. Nothing is allocated while it draws. */

import { MapLayer } from "../map/layer";
import type { MapTiles } from "../map/tiles";
import { between, identity, type Matrix, multiply, type Pose } from "../matrix";
import type { Box } from "../scene/box";
import { tintOf } from "../scene/guests";
import { MAX_RINGS, type RangeFrame } from "../stream/frame";
import { type SensorTable, TEXELS } from "../stream/sensor";
import type { Colour, StreamName, ViewOptions } from "../types";
import type { Camera } from "./camera";
import { allMaps, FAR_M, HEIGHT_M, MAPS, STEPS } from "./colours";
import { formats, Program, Texture } from "./gl";
import { Labels } from "./labels";
import { type Layer, Layers } from "./layers";
import { layout, type Pane, type Rect } from "./layout";
import {
  COVER_VERTEX,
  GROUND_FRAGMENT,
  GROUND_VERTEX,
  IMAGE_FRAGMENT,
  POINTS_FRAGMENT,
  POINTS_VERTEX,
} from "./shaders";
import { Surface } from "./surface";
import type { Colour3, Theme } from "./theme";

const TURN_STEPS = 36000;
const TURN_WIDTH = 256;
const GROUND_REACH_M = 150;
const NOWHERE = [0, 0, 0];
const UNITS = { range: 0, azimuth: 1, intensity: 2, original: 3, sensor: 4, turn: 5, maps: 6, filled: 7 } as const;

export interface Scene {
  colour: Colour;
  /** Device pixels. */
  pointSize: number;
  ratio: number;
  /** Original and decoded beside one another; error_mm: what the end of the colours stands for. */
  compare: boolean;
  error_mm: number;
  rangeImage: boolean;
  ground: number;
  /** Where the sensor is now, if that is known. */
  pose: Pose | null;
  /** The map under the cloud, and where the sensor is in it now. */
  map: MapTiles | null;
  mapPose: Pose | null;
  theme: Theme;
  /** Shade edges: costs a pass over all pixels. */
  shaded: boolean;
  /** Points outside are not drawn; null draws all. */
  box: Box | null;
  /** Other streams in the picture. */
  guests: readonly (Drawn & { name: StreamName; placeOf(frame: RangeFrame): Matrix })[];
}

/** What is drawn before there is anything to draw. */
export function firstScene({ colour, rangeImage }: ViewOptions, theme: Theme, guests: Scene["guests"]): Scene {
  const still = {
    pointSize: 1,
    ratio: 1,
    compare: false,
    error_mm: 1,
    ground: -1.7,
    pose: null,
    map: null,
    mapPose: null,
    shaded: true,
  };
  return { ...still, colour, rangeImage, theme, box: null, guests };
}

/** Frames of a stream on the card, with its sensor, and where they lie. */
export interface Drawn {
  layers: Layers | null;
  sensor: Texture | null;
  table: SensorTable | null;
  tint: Colour3;
  /** From a frame of it to the frame of the picture; absent for the chosen stream. */
  placeOf?(frame: RangeFrame): Matrix;
}

export class Renderer {
  readonly layers: Layers;
  readonly #points: Program;
  readonly #ground: Program;
  readonly #image: Program;
  readonly #labels: Labels;
  readonly #map: MapLayer;
  readonly #surface: Surface;
  readonly #sensor: Texture;
  readonly #own: Drawn;
  readonly #turn: Texture;
  readonly #maps: Texture;
  readonly #view: Matrix = identity();
  readonly #projection: Matrix = identity();
  readonly #both: Matrix = identity();
  readonly #place: Matrix = identity();
  readonly #still: Matrix = identity();
  #dark: boolean | null = null;
  #panes: Pane[] = [];
  #panesFor: [number, number, number, number] = [0, 0, 0, 0];

  /** Throws GlError when the card does not take what it is given. */
  constructor(private readonly gl: WebGL2RenderingContext) {
    const { rgba32f, rg32f, rgba8 } = formats(gl);
    this.#points = new Program(gl, POINTS_VERTEX, POINTS_FRAGMENT);
    this.#ground = new Program(gl, GROUND_VERTEX, GROUND_FRAGMENT);
    this.#image = new Program(gl, COVER_VERTEX, IMAGE_FRAGMENT);
    this.#labels = new Labels(gl);
    this.#map = new MapLayer(gl);
    this.#surface = new Surface(gl);
    this.#sensor = new Texture(gl, rgba32f, TEXELS, MAX_RINGS);
    this.#maps = new Texture(gl, rgba8, STEPS, MAPS.length);
    const rows = Math.ceil(TURN_STEPS / TURN_WIDTH);
    this.#turn = new Texture(gl, rg32f, TURN_WIDTH, rows);
    const pairs = new Float32Array(2 * TURN_WIDTH * rows);
    for (let step = 0; step < TURN_STEPS; step++) {
      pairs[2 * step] = Math.cos((step * 2 * Math.PI) / TURN_STEPS);
      pairs[2 * step + 1] = Math.sin((step * 2 * Math.PI) / TURN_STEPS);
    }
    this.#turn.write(pairs);
    this.layers = new Layers(gl);
    this.#own = { layers: this.layers, sensor: this.#sensor, table: null, tint: [1, 1, 1] };
    for (const program of [this.#points, this.#image]) {
      program.use();
      for (const [name, unit] of Object.entries(UNITS)) gl.uniform1i(program.at(`u_${name}`), unit);
    }
  }

  /** Memory of the card that textures take, in bytes. */
  get bytes(): number {
    const tables = this.#sensor.bytes + this.#turn.bytes + this.#maps.bytes;
    return this.layers.bytes + this.#map.bytes + this.#surface.bytes + tables;
  }

  /** The sensor of the chosen stream. */
  get table(): SensorTable | null {
    return this.#own.table;
  }

  /** Of the canvas, in device pixels. */
  get high(): number {
    return this.gl.canvas.height;
  }

  push(frame: RangeFrame, sensor: SensorTable, trail: number): void {
    this.gl.pixelStorei(this.gl.UNPACK_ALIGNMENT, 1);
    if (sensor !== this.#own.table) {
      this.layers.clear();
      this.#own.table = sensor;
      this.#sensor.write(sensor.values, TEXELS, sensor.rings);
    }
    this.layers.push(frame, trail);
  }

  draw(camera: Camera, scene: Scene): void {
    const { gl } = this;
    const { width, height } = gl.canvas;
    if (scene.theme.dark !== this.#dark) {
      this.#dark = scene.theme.dark;
      this.#maps.write(allMaps(this.#dark));
    }
    if (scene.shaded) this.#surface.begin(width, height);
    else gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const { paper } = scene.theme;
    gl.disable(gl.SCISSOR_TEST);
    gl.depthMask(true);
    gl.clearColor(paper[0], paper[1], paper[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const panes = this.panes(scene);
    for (let number = 0; number < panes.length; number++) {
      const pane = panes[number] as Pane;
      this.#frameRect(pane.cloud);
      this.viewOf(camera, scene, pane, this.#both);
      this.#drawGround(scene);
      this.#map.draw(scene.map, this.#both, scene.mapPose, scene.pointSize, scene.theme);
      this.#drawPoints(scene, scene.compare && number === 0, scene.compare && number === 1);
      if (!scene.compare) for (const guest of scene.guests) this.#drawPoints(scene, false, false, guest);
      gl.enable(gl.BLEND);
      this.#labels.draw(this.#both, scene.ground, pane.cloud.wide, pane.cloud.high, scene.ratio, scene.theme.ink);
      gl.disable(gl.BLEND);
    }
    if (scene.shaded) this.#surface.end(scene.ratio);
    else this.#surface.rest();
    for (let number = 0; number < panes.length; number++) {
      const { image } = panes[number] as Pane;
      if (image) this.#drawImage(image, scene, scene.compare && number === 0, scene.compare && number === 1);
    }
    gl.disable(gl.SCISSOR_TEST);
  }

  /** From metres at the sensor to the screen, in a pane of the picture. */
  viewOf(camera: Camera, scene: Scene, pane: Pane, out: Matrix): Matrix {
    const { wide, high } = pane.cloud;
    camera.matrices(this.#view, this.#projection, wide / Math.max(high, 1), scene.ground);
    return multiply(out, this.#projection, this.#view);
  }

  /** What is where on the canvas. */
  panes({ ratio, compare, rangeImage }: Pick<Scene, "ratio" | "compare" | "rangeImage">): Pane[] {
    const { width, height } = this.gl.canvas;
    const asked = (compare ? 2 : 0) + (rangeImage ? 1 : 0);
    const before = this.#panesFor;
    if (width !== before[0] || height !== before[1] || ratio !== before[2] || asked !== before[3]) {
      this.#panesFor = [width, height, ratio, asked];
      this.#panes = layout(width, height, ratio, compare ? 2 : 1, rangeImage);
    }
    return this.#panes;
  }

  delete(): void {
    this.layers.clear();
    for (const one of [this.#points, this.#ground, this.#image, this.#labels, this.#map, this.#surface]) one.delete();
    for (const one of [this.#sensor, this.#turn, this.#maps]) one.delete();
  }

  #frameRect({ x, y, wide, high }: Rect): void {
    const { gl } = this;
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, y, wide, high);
    gl.viewport(x, y, wide, high);
  }

  #drawGround({ ground, pose, theme }: Scene): void {
    const { gl } = this;
    const program = this.#ground;
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.disable(gl.DEPTH_TEST);
    program.use();
    gl.uniformMatrix4fv(program.at("u_view"), false, this.#both);
    gl.uniform1f(program.at("u_ground"), ground);
    gl.uniform1f(program.at("u_reach"), GROUND_REACH_M);
    this.#colour(program, "u_ink", theme.ink);
    this.#colour(program, "u_accent", theme.accent);
    if (pose) {
      const of = (cell: number) => pose[cell] as number;
      gl.uniform4f(program.at("u_world"), of(0), of(4), of(1), of(5));
      gl.uniform2f(program.at("u_worldAt"), of(3) % 10, of(7) % 10);
    } else {
      gl.uniform4f(program.at("u_world"), 1, 0, 0, 1);
      gl.uniform2f(program.at("u_worldAt"), 0, 0);
    }
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.disable(gl.BLEND);
  }

  #drawPoints(scene: Scene, original: boolean, error: boolean, drawn = this.#own): void {
    const { gl } = this;
    const { layers, table } = drawn;
    const newest = layers?.shown[0];
    if (!layers || !newest || !table) return;
    const { shown, now } = layers;
    const program = this.#points;
    gl.enable(gl.DEPTH_TEST);
    program.use();
    this.#common(program, scene, error, drawn);
    gl.uniformMatrix4fv(program.at("u_view"), false, this.#both);
    gl.uniform1f(program.at("u_size"), scene.pointSize);
    gl.uniform1i(program.at("u_boxed"), scene.box ? 1 : 0);
    gl.uniform3fv(program.at("u_least"), scene.box?.least ?? NOWHERE);
    gl.uniform3fv(program.at("u_greatest"), scene.box?.greatest ?? NOWHERE);
    gl.uniform1i(program.at("u_tinted"), scene.colour === "stream" && !error ? 1 : 0);
    const tint = drawn === this.#own ? tintOf(0, scene.theme) : drawn.tint;
    this.#colour(program, "u_tint", tint);
    this.#colour(program, "u_paper", scene.theme.paper);
    const trails = Math.max(shown.length - now, 1);
    const pose = scene.pose ?? newest.frame.pose;
    const count = scene.compare ? Math.min(now, shown.length) : shown.length;
    for (let number = count - 1; number >= 0; number--) {
      const layer = shown[number] as Layer;
      const placed = pose && layer.frame.pose;
      gl.uniformMatrix4fv(
        program.at("u_place"),
        false,
        drawn.placeOf?.(layer.frame) ?? (placed ? between(this.#place, pose, layer.frame.pose as Pose) : this.#still),
      );
      gl.uniform1f(program.at("u_fade"), number < now ? 0 : 0.3 + (0.5 * (number - now + 1)) / trails);
      this.#bind(program, layer, original, error);
      gl.drawArrays(gl.POINTS, 0, layer.frame.rings * layer.frame.columns);
    }
  }

  #drawImage(rect: Rect, scene: Scene, original: boolean, error: boolean): void {
    const { gl } = this;
    const { shown, now } = this.layers;
    this.#frameRect(rect);
    const { none } = scene.theme;
    gl.clearColor(none[0], none[1], none[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!this.#own.table) return;
    const program = this.#image;
    gl.disable(gl.DEPTH_TEST);
    program.use();
    this.#common(program, scene, error, this.#own);
    this.#colour(program, "u_none", none);
    for (let number = Math.min(now, shown.length) - 1; number >= 0; number--) {
      const layer = shown[number] as Layer;
      gl.uniform1i(program.at("u_columns"), layer.frame.columns);
      gl.uniform1f(program.at("u_coverage"), layer.coverage);
      this.#bind(program, layer, original, error);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }

  /** What points and range image have in common. */
  #common(program: Program, scene: Scene, error: boolean, { sensor, table }: Drawn): void {
    const { gl } = this;
    const mode = MAPS.indexOf(error ? "error" : scene.colour === "stream" ? "height" : scene.colour);
    gl.activeTexture(gl.TEXTURE0 + UNITS.sensor);
    gl.bindTexture(gl.TEXTURE_2D, sensor?.handle ?? null);
    gl.activeTexture(gl.TEXTURE0 + UNITS.turn);
    gl.bindTexture(gl.TEXTURE_2D, this.#turn.handle);
    gl.activeTexture(gl.TEXTURE0 + UNITS.maps);
    gl.bindTexture(gl.TEXTURE_2D, this.#maps.handle);
    gl.uniform1i(program.at("u_ros"), table?.ros ? 1 : 0);
    gl.uniform1i(program.at("u_mode"), mode);
    gl.uniform1f(program.at("u_ground"), scene.ground);
    gl.uniform2f(program.at("u_height"), HEIGHT_M[0], HEIGHT_M[1]);
    gl.uniform1f(program.at("u_far"), FAR_M);
    gl.uniform1f(program.at("u_errorScale"), 1000 / scene.error_mm);
    this.#colour(program, "u_dropped", scene.theme.dropped);
    this.#colour(program, "u_invented", scene.theme.invented);
  }

  #bind(program: Program, layer: Layer, original: boolean, error: boolean): void {
    const { gl } = this;
    const before = layer.frame.original ? layer.original : null;
    const range = original && before ? before : layer.range;
    gl.activeTexture(gl.TEXTURE0 + UNITS.range);
    gl.bindTexture(gl.TEXTURE_2D, range.handle);
    gl.activeTexture(gl.TEXTURE0 + UNITS.azimuth);
    gl.bindTexture(gl.TEXTURE_2D, layer.azimuth.handle);
    gl.activeTexture(gl.TEXTURE0 + UNITS.intensity);
    gl.bindTexture(gl.TEXTURE_2D, layer.intensity.handle);
    gl.activeTexture(gl.TEXTURE0 + UNITS.original);
    gl.bindTexture(gl.TEXTURE_2D, (before ?? layer.range).handle);
    gl.activeTexture(gl.TEXTURE0 + UNITS.filled);
    gl.bindTexture(gl.TEXTURE_2D, (layer.frame.filled ? layer.filled : null)?.handle ?? layer.intensity.handle);
    gl.uniform1i(program.at("u_hasFilled"), layer.frame.filled && !(original && before) ? 1 : 0);
    gl.uniform1i(program.at("u_rings"), layer.frame.rings);
    gl.uniform1f(program.at("u_step"), layer.frame.rangeStepM);
    gl.uniform1i(program.at("u_compare"), error && before ? 1 : 0);
    gl.uniform1i(program.at("u_hasIntensity"), layer.frame.intensity ? 1 : 0);
  }

  #colour(program: Program, name: string, [r, g, b]: Colour3): void {
    this.gl.uniform3f(program.at(name), r, g, b);
  }
}
