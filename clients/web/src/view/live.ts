/** The view of a stream: draws the frames of a source. It draws when there is something new (a frame, a movement, an
 * option), and at the screen's rate while something moves. */
import { DecodingSource } from "../decode/source";
import { Comparing } from "./compare";
import { Camera, type Stand } from "./draw/camera";
import { canvasIn, contextOf, sized } from "./draw/canvas";
import { Controls } from "./draw/controls";
import { Film, filmType } from "./draw/film";
import { Overlay } from "./draw/overlay";
import { captioned } from "./draw/picture";
import { firstScene, Renderer, type Scene } from "./draw/renderer";
import { ThemeWatch } from "./draw/theme";
import { Ground } from "./ground";
import { Town } from "./map/town";
import type { PoseEvent } from "./map/where";
import { Measure } from "./measure/measure";
import { LOST, NO_ORIGINALS, NO_WEBGL, TOO_WIDE } from "./messages";
import { Motion } from "./motion";
import { Quality } from "./quality";
import { Guests } from "./scene/guests";
import type { MainSeat } from "./scene/mounts";
import type { RangeFrame } from "./stream/frame";
import { Pending } from "./stream/pending";
import type { SensorTable } from "./stream/sensor";
import { CloudSocket } from "./stream/socket";
import type { FrameSource, Sink } from "./stream/source";
import { Tally } from "./stream/tally";
import type { StreamName, View, ViewOptions, ViewStats } from "./types";

const STATS_MS = 500;
/** Longest time of a graphics card for one picture. */
const QUICK_MS = 40;

interface Waiting {
  frame: RangeFrame;
  sensor: SensorTable;
  shown: () => void;
}

export class LiveView implements View, Sink {
  readonly #canvas: HTMLCanvasElement;
  readonly #gl: WebGL2RenderingContext | null;
  readonly #camera = new Camera();
  readonly #controls: Controls;
  readonly #overlay: Overlay;
  readonly #measure: Measure;
  readonly #theme: ThemeWatch;
  readonly #ground = new Ground();
  readonly #motion = new Motion();
  readonly #quality = new Quality();
  readonly #tally = new Tally();
  readonly #town = new Town(() => this.#wake());
  readonly #comparing = new Comparing();
  readonly #resized: ResizeObserver;
  readonly #timer: number;
  readonly #scene: Scene;
  readonly #guests = new Guests(() => this.#again());
  readonly #waiting: Waiting[] = [];
  #film: Film | null = null;
  #renderer: Renderer | null = null;
  #pending: Pending | null = null;
  #options: ViewOptions;
  #source: FrameSource | null = null;
  #stream: { stream: StreamName; token: string | undefined } | null = null;
  #widest = Number.POSITIVE_INFINITY;
  #tooWide = false;
  #last: Waiting | null = null;
  #request = 0;
  #before = 0;
  #dirty = true;
  readonly #unseen = () => this.#pending?.unseen();
  #tell: (stats: ViewStats) => void = () => {};

  constructor(
    private readonly host: HTMLElement,
    options: ViewOptions,
  ) {
    this.#options = { ...options };
    host.classList.add("lidar-view");
    const canvas = canvasIn(host);
    this.#canvas = canvas;
    this.#overlay = new Overlay(host);
    this.#theme = new ThemeWatch(host, () => this.#wake());
    this.#measure = new Measure(this.#overlay.root);
    this.#measure.on = options.measure;
    this.#controls = new Controls(
      canvas,
      this.#camera,
      () => this.#wake(),
      (x, y) => this.#tapped(x, y),
    );
    canvas.addEventListener("keydown", ({ key }) => {
      if (key === "Escape") this.#measure.clear();
    });
    this.#camera.reset(options.camera, true);
    this.#scene = firstScene(options, this.#theme.theme, this.#guests.all);
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.#pending?.end();
      this.#renderer = this.#pending = null;
      this.#overlay.message(LOST);
    });
    canvas.addEventListener("webglcontextrestored", () => this.#begin());
    this.#gl = contextOf(canvas);
    this.#begin();
    document.addEventListener("visibilitychange", this.#unseen);
    this.#resized = new ResizeObserver(() => this.#wake());
    this.#resized.observe(host);
    this.#timer = window.setInterval(() => this.#report(), STATS_MS);
  }

  // --- for the page -------------------------------------------------------------------------------------------------

  open(stream: StreamName, token?: string): void {
    this.close();
    this.#stream = { stream, token };
    this.#chooseMap();
    this.#connect();
  }

  close(): void {
    this.#disconnect();
    this.#film?.stop();
    this.#stream = null;
    this.#chooseMap();
    this.#clear();
    this.#report();
  }

  set(changed: Partial<ViewOptions>): void {
    const before = this.#options;
    this.#options = { ...before, ...changed };
    const { camera, compare, decodeInBrowser, fillGaps, map, trail } = this.#options;
    if (map !== before.map) this.#chooseMap();
    if (camera !== before.camera) this.#camera.reset(camera);
    this.#measure.on = this.#options.measure;
    if (trail < before.trail) this.#renderer?.layers.shorten(trail);
    const other =
      compare !== before.compare || decodeInBrowser !== before.decodeInBrowser || fillGaps !== before.fillGaps;
    if (other && this.#stream) {
      this.#disconnect();
      this.#connect();
    } else this.#guests.show(this.#gl && this.#stream, this.#options);
    this.#wake();
  }

  onstats(callback: (stats: ViewStats) => void): void {
    this.#tell = callback;
  }

  async picture(caption: (stampMs: number) => string): Promise<Blob | null> {
    const last = this.#drawn();
    return last && captioned(this.#canvas, caption(last.frame.stampMs), this.#theme.theme, this.#scene.ratio);
  }

  stand(): Stand {
    return { ...this.#camera.goal };
  }

  goTo(stand: Stand): void {
    this.#camera.send(stand);
    this.#wake();
  }

  film(caption: (stampMs: number) => string): Film | null {
    const [type, last] = [filmType(), this.#drawn()];
    if (!type || !last) return null;
    const { theme } = this.#theme;
    this.#film = new Film(this.#canvas, caption, last.frame.stampMs, theme, this.#scene.ratio, type);
    return this.#film;
  }

  dispose(): void {
    this.close();
    window.clearInterval(this.#timer);
    window.cancelAnimationFrame(this.#request);
    document.removeEventListener("visibilitychange", this.#unseen);
    this.#resized.disconnect();
    this.#theme.dispose();
    this.#controls.dispose();
    this.#renderer?.delete();
    this.#renderer = this.#pending = null;
    this.#gl?.getExtension("WEBGL_lose_context")?.loseContext();
    this.#canvas.remove();
    this.#overlay.root.remove();
    this.host.classList.remove("lidar-view");
  }

  // --- for the source -----------------------------------------------------------------------------------------------

  frame(frame: RangeFrame, sensor: SensorTable, shown: () => void): void {
    this.#waiting.push({ frame, sensor, shown });
    this.#again();
  }

  readonly restarted = () => this.#clear();
  readonly changed = () => this.#report();
  readonly located = (told: PoseEvent) => this.#town.told(told, performance.now());

  // --- within -------------------------------------------------------------------------------------------------------

  #connect(): void {
    if (!this.#stream || !this.#gl) return;
    this.#comparing.opened(performance.now());
    const { compare, decodeInBrowser, fillGaps } = this.#options;
    const Source = decodeInBrowser && !compare ? DecodingSource : CloudSocket; // the originals come decoded only
    this.#source = new Source({ ...this.#stream, original: compare, fill: fillGaps }, this);
    this.#guests.show(this.#stream, this.#options);
  }

  /** Draw the map of the options, for streams that are opened with a token. */
  #chooseMap(): void {
    this.#town.choose(this.#stream ? this.#options.map : null, this.#stream?.token);
    this.#scene.map = this.#town.tiles;
  }

  #disconnect(): void {
    this.#source?.close();
    this.#source = null;
    this.#guests.show(null, this.#options);
    this.#waiting.length = 0;
    this.#pending?.end();
  }

  #clear(): void {
    this.#renderer?.layers.clear();
    this.#last = this.#comparing.now = null;
    this.#measure.clear();
    this.#ground.reset();
    this.#motion.reset();
    this.#town.reset();
    this.#tally.reset();
    this.#wake();
  }

  #begin(): void {
    if (!this.#gl) return; // the notice over the picture says so
    if (this.#gl.isContextLost()) {
      this.#overlay.message(LOST);
      return;
    }
    this.#renderer = new Renderer(this.#gl);
    this.#pending = new Pending(this.#gl);
    this.#widest = this.#gl.getParameter(this.#gl.MAX_TEXTURE_SIZE) as number;
    this.#overlay.message("");
    if (this.#last) this.#renderer.push(this.#last.frame, this.#last.sensor, 0);
    this.#guests.again(this.#gl);
    this.#wake();
  }

  #tapped(x: number, y: number): void {
    if (this.#renderer && this.#measure.take(x, y, this.#renderer, this.#camera, this.#scene)) this.#wake();
  }

  /** Draw again soon. */
  #wake(): void {
    this.#dirty = true;
    this.#again();
  }

  #again(): void {
    if (this.#request === 0) this.#request = window.requestAnimationFrame((now) => this.#picture(now));
  }

  #picture(now: number): void {
    this.#request = 0;
    const took = this.#pending?.done(now) ?? null;
    if (took !== null && this.#quality.took(took)) this.#dirty = true;
    if (!this.#pending?.drawing) this.#next(now);
    if (this.#pending?.drawing) this.#wait(now);
    else if (this.#dirty || this.#waiting.length > 0) this.#again();
  }

  /** Check again at the next picture of the browser, or less often with a slow graphics card. */
  #wait(now: number): void {
    if (now - this.#before < QUICK_MS) this.#again();
    else window.setTimeout(() => this.#again(), QUICK_MS / 2);
  }

  /** Draw if there is something new. */
  #next(now: number): void {
    const seconds = (now - this.#before) / 1000;
    this.#before = now;
    const steered = this.#controls.step(seconds);
    const turned = this.#camera.move(seconds);
    const beside = this.#gl !== null && this.#guests.take(this.#gl, now, this.#widest);
    const taken = this.#take(now) || beside;
    const driven = this.#motion.predict(now) && this.#quality.level === 2;
    const draws = this.#dirty || taken || steered || turned || driven;
    this.#dirty = steered || turned || driven;
    const acknowledged = [...this.#waiting.splice(0).map(({ shown }) => shown), ...this.#guests.acknowledged()];
    if (draws && this.#renderer && this.#size()) {
      this.#draw(this.#renderer);
      this.#tally.drawn(now);
      this.#pending?.begin(now, acknowledged);
    } else for (const shown of acknowledged) shown();
  }

  /** True if there was a frame to show. */
  #take(now: number): boolean {
    let taken = false;
    for (const one of this.#waiting) {
      const { frame, sensor } = one;
      if (this.#last && this.#last.frame.streamId !== frame.streamId) this.#clear();
      if (!this.#comparing.passes(frame, now)) continue;
      this.#tooWide = frame.columns > this.#widest;
      if (this.#tooWide) continue;
      this.#renderer?.push(frame, sensor, this.#options.compare ? 0 : this.#options.trail);
      this.#ground.update(frame, sensor);
      this.#motion.take(frame, now);
      this.#last = one;
      taken = true;
      if (this.#tally.frames === 0) window.setTimeout(() => this.#report());
      const aheadMs = this.#source?.clockAheadMs ?? 0;
      const drawn = this.#renderer?.layers ?? { points: frame.returns, madeUp: frame.madeUp };
      this.#tally.shown(frame, drawn, now, Date.now() + aheadMs);
    }
    if (!taken || !this.#last) return false;
    this.#town.frame(this.#last.frame, this.#motion, now);
    this.#camera.heading = this.#motion.turned();
    this.#comparing.take(this.#options.compare ? this.#last.frame : null);
    return true;
  }

  /** Resize the canvas to its shown size. False while it is hidden. */
  #size(): boolean {
    this.#scene.ratio = this.#quality.ratio(window.devicePixelRatio || 1);
    return sized(this.#canvas, this.host, this.#scene.ratio);
  }

  /** Draw now: in this task of the browser the canvas can be read. The last frame, null if nothing can be drawn. */
  #drawn(): Waiting | null {
    if (!this.#renderer || !this.#last || !this.#size()) return null;
    this.#draw(this.#renderer);
    this.#report(); // captions tell what holds now
    this.#wake();
    return this.#last;
  }

  #draw(renderer: Renderer): void {
    const scene = this.#scene;
    const { colour, pointSize, rangeImage } = this.#options;
    scene.colour = colour;
    scene.pointSize = pointSize * scene.ratio;
    const { now: comparison, scale } = this.#comparing;
    scene.compare = comparison !== null;
    scene.error_mm = scale.mm;
    scene.rangeImage = rangeImage;
    scene.ground = this.#ground.z;
    scene.pose = this.#motion.known ? this.#motion.pose : null;
    scene.mapPose = this.#town.pose(this.#last?.frame ?? null, this.#motion, this.#before);
    scene.theme = this.#theme.theme;
    scene.shaded = this.#quality.level === 2;
    scene.box = this.#options.box;
    this.#guests.settle(this.#seat(), scene.theme);
    renderer.draw(this.#camera, scene);
    if (this.#film?.running) this.#film.add(this.#canvas, this.#last?.frame.stampMs);
    const upright = scene.compare && this.#canvas.height > this.#canvas.width;
    this.#measure.draw(renderer, this.#camera, scene);
    this.#overlay.strip((renderer.panes(scene)[0]?.image?.high ?? 0) / scene.ratio);
    this.#overlay.scale(this.#last ? colour : null, scene.theme);
    this.#overlay.made(renderer.layers.points, renderer.layers.madeUp);
    this.#overlay.compare(comparison, scale.mm, scene.theme, upright);
  }

  /** Where the chosen stream is. */
  #seat(): MainSeat & StreamName {
    const name = this.#stream?.stream ?? { vehicle: "", sensor: "" };
    const seen = this.#last?.frame.pose ?? null;
    return { ...name, mount: this.#options.mount, pose: this.#scene.pose ?? seen, seen };
  }

  #report(): void {
    const now = performance.now();
    const source = this.#source;
    const stats = this.#tally.stats(now);
    if (this.#town.look(now)) this.#wake();
    this.#overlay.where(this.#town.line, this.#town.lost);
    const unpaired = this.#options.compare && this.#last && !stats.stale && this.#comparing.lacksOriginals(now);
    if (this.#renderer) this.#overlay.message(this.#tooWide ? TOO_WIDE : unpaired ? NO_ORIGINALS : "");
    const gpuBytes = (this.#renderer?.bytes ?? 0) + this.#guests.bytes;
    const main = { ...this.#seat(), points: stats.points };
    const all = this.#guests.report(main, this.#scene, this.#renderer, this.#overlay.legend, now);
    // for measurements from outside: benchmarks/page.py
    const { frames, pictures } = this.#tally;
    const told = { age: stats.age_ms, frames, clouds: frames + this.#guests.frames, pictures, gpu: gpuBytes };
    this.#canvas.dataset.told = JSON.stringify(told);
    this.#tell({
      ...stats,
      ...all,
      connection: this.#gl ? (source?.connection ?? "closed") : "unable",
      problem: this.#gl ? (source?.problem ?? null) : NO_WEBGL,
      note: source?.note ?? this.#scene.map?.note ?? null,
      alive: source?.alive ?? null,
      comparison: this.#comparing.now,
      gpuBytes,
    });
    if (this.#film?.running) this.#wake(); // its caption changes also while no frame comes
  }
}
