/** Measuring in the view: picks returns, and shows them with their fields and the distance between two. */
import type { Camera } from "../draw/camera";
import type { Pane, Rect } from "../draw/layout";
import type { Renderer, Scene } from "../draw/renderer";
import { between, identity, multiply } from "../matrix";
import { isInside } from "../scene/box";
import { Panel, rows } from "./panel";
import { pick, type Seen } from "./pick";
import { onScreen, Ruler } from "./ruler";

/** How near to the pointer a return must be, in CSS pixels. */
const REACH_PX = 9;

export class Measure {
  readonly #ruler = new Ruler();
  readonly #panel: Panel;
  readonly #view = identity();
  #on = false;

  constructor(host: HTMLElement) {
    this.#panel = new Panel(host);
    this.#panel.show(null);
  }

  /** Switch it on or off. What was picked is forgotten. */
  set on(yes: boolean) {
    if (yes === this.#on) return;
    this.#on = yes;
    this.clear();
  }

  clear(): void {
    this.#ruler.clear();
    this.#panel.show(this.#on ? rows([], 0, null) : null);
    this.#panel.place([]);
  }

  /** Pick the return at a place of the picture, in CSS pixels from the upper left corner. False if there is none. */
  take(x: number, y: number, renderer: Renderer, camera: Camera, scene: Scene): boolean {
    const { table } = renderer;
    if (!this.#on || !table) return false;
    const high = renderer.high / scene.ratio;
    const pane = renderer.panes(scene).find(({ cloud }) => inside(cloud, x * scene.ratio, (high - y) * scene.ratio));
    if (!pane) return false;
    const { cloud } = pane;
    const reach = REACH_PX * scene.ratio;
    const spot = {
      x: (2 * (x * scene.ratio - cloud.x)) / cloud.wide - 1,
      y: (2 * ((high - y) * scene.ratio - cloud.y)) / cloud.high - 1,
      reachX: (2 * reach) / cloud.wide,
      reachY: (2 * reach) / cloud.high,
    };
    const view = renderer.viewOf(camera, scene, pane, this.#view);
    const { shown, now } = renderer.layers;
    const pose = scene.pose ?? shown[0]?.frame.pose ?? null;
    const seen: Seen[] = shown.slice(0, now).map(({ frame }) => ({
      frame,
      table,
      view: pose && frame.pose ? multiply(identity(), view, between(identity(), pose, frame.pose)) : view,
    }));
    for (const guest of scene.compare ? [] : scene.guests) {
      const { layers, table: own } = guest;
      if (!layers || !own) continue;
      const name = `${guest.name.vehicle}/${guest.name.sensor}`;
      for (const { frame } of layers.shown.slice(0, layers.now)) {
        const place = Float32Array.from(guest.placeOf(frame));
        const stream = { name, place, pose: pose && Float64Array.from(pose) };
        seen.push({ frame, table: own, view: multiply(identity(), view, place), stream });
      }
    }
    const { box, ground } = scene;
    const found = pick(seen, spot, (point) => !box || isInside(box, point, ground));
    if (found) this.#ruler.take(found);
    this.#panel.show(rows(this.#ruler.picked, scene.ground, this.#ruler.between, !found));
    return found !== null;
  }

  /** Put the marks where the points are in the picture that is drawn now. */
  draw(renderer: Renderer, camera: Camera, scene: Scene): void {
    const pane = renderer.panes(scene)[0] as Pane;
    if (!this.#on || this.#ruler.picked.length === 0) return;
    const view = renderer.viewOf(camera, scene, pane, this.#view);
    const pose = scene.pose ?? renderer.layers.shown[0]?.frame.pose ?? null;
    const { x, y, wide, high } = pane.cloud;
    const top = renderer.high - y - high;
    this.#panel.place(
      this.#ruler.picked.map((one) => {
        const at = onScreen(view, this.#ruler.placed(one, pose));
        if (!at || Math.abs(at[0]) > 1 || Math.abs(at[1]) > 1) return null;
        return [(x + ((at[0] + 1) * wide) / 2) / scene.ratio, (top + ((1 - at[1]) * high) / 2) / scene.ratio];
      }),
    );
  }
}

function inside({ x, y, wide, high }: Rect, atX: number, atY: number): boolean {
  return atX >= x && atX < x + wide && atY >= y && atY < y + high;
}
