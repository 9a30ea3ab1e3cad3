/** Mouse, touch and keyboard, as movements of a camera. */
import type { Camera } from "./camera";

const TURN = 0.0055;
const KEY_TURN = 1.4;
const KEY_PAN = 0.8;
const KEY_ZOOM = 1.5;
const MOVES = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "+", "=", "-", "_"]);
/** A key that was pressed with shift may be let go without. */
const SAME: Record<string, string[]> = { "+": ["+", "="], "=": ["+", "="], "-": ["-", "_"], _: ["-", "_"] };

/** How far a finger or the mouse may go, in CSS pixels, and how long it may stay, for a tap. */
const TAP_PX = 6;
const TAP_MS = 500;

interface Finger {
  x: number;
  y: number;
  downX: number;
  downY: number;
  downMs: number;
}

export class Controls {
  readonly #fingers = new Map<number, Finger>();
  readonly #keys = new Set<string>();
  #shift = false;
  readonly #ended = new AbortController();

  constructor(
    private readonly element: HTMLElement,
    private readonly camera: Camera,
    private readonly changed: () => void,
    /** Called with the place of a tap or click, in CSS pixels from the upper left corner. */
    private readonly tapped: (x: number, y: number) => void,
  ) {
    const { signal } = this.#ended;
    const listen = <K extends keyof HTMLElementEventMap>(name: K, handler: (event: HTMLElementEventMap[K]) => void) =>
      element.addEventListener(name, handler, { signal, passive: false });
    listen("pointerdown", (event) => this.#down(event));
    listen("pointermove", (event) => this.#move(event));
    listen("pointerup", (event) => this.#up(event));
    listen("pointercancel", (event) => this.#fingers.delete(event.pointerId));
    listen("contextmenu", (event) => event.preventDefault());
    listen("wheel", (event) => this.#wheel(event));
    listen("dblclick", () => this.#reset());
    listen("keydown", (event) => this.#key(event));
    listen("keyup", (event) => {
      this.#shift = event.shiftKey;
      for (const name of SAME[event.key] ?? [event.key]) this.#keys.delete(name);
    });
    listen("blur", () => this.#keys.clear());
  }

  dispose(): void {
    this.#ended.abort();
  }

  /** Do what the keys that are down say. True while one is. */
  step(seconds: number): boolean {
    if (this.#keys.size === 0) return false;
    const time = Math.min(seconds, 0.1);
    const down = (name: string) => (this.#keys.has(name) ? 1 : 0);
    const right = down("ArrowRight") - down("ArrowLeft");
    const up = down("ArrowUp") - down("ArrowDown");
    if (this.#shift) this.camera.pan(right * KEY_PAN * time, up * KEY_PAN * time);
    else this.camera.rotate(-right * KEY_TURN * time, up * KEY_TURN * time);
    const near = Math.max(down("+"), down("=")) - Math.max(down("-"), down("_"));
    if (near !== 0) this.camera.zoom(KEY_ZOOM ** (-2 * near * time));
    return true;
  }

  #reset(): void {
    this.camera.reset(this.camera.kind);
    this.changed();
  }

  #down(event: PointerEvent): void {
    this.element.setPointerCapture(event.pointerId);
    this.element.focus({ preventScroll: true });
    const { clientX: x, clientY: y, timeStamp } = event;
    this.#fingers.set(event.pointerId, { x, y, downX: x, downY: y, downMs: timeStamp });
  }

  #up(event: PointerEvent): void {
    const finger = this.#fingers.get(event.pointerId);
    const alone = this.#fingers.size === 1;
    this.#fingers.delete(event.pointerId);
    if (!finger || !alone || event.button !== 0) return;
    const way = Math.hypot(event.clientX - finger.downX, event.clientY - finger.downY);
    if (way > TAP_PX || event.timeStamp - finger.downMs > TAP_MS) return;
    const { left, top } = this.element.getBoundingClientRect();
    this.tapped(event.clientX - left, event.clientY - top);
  }

  #move(event: PointerEvent): void {
    const finger = this.#fingers.get(event.pointerId);
    if (!finger) return;
    const dx = event.clientX - finger.x;
    const dy = event.clientY - finger.y;
    const before = this.#fingers.size === 2 ? this.#spread() : 0;
    finger.x = event.clientX;
    finger.y = event.clientY;
    const high = Math.max(this.element.clientHeight, 1);
    if (this.#fingers.size === 2) {
      this.camera.zoom(before / Math.max(this.#spread(), 1));
      this.camera.pan(-dx / high / 2, dy / high / 2);
    } else if (event.shiftKey || (event.buttons & 6) !== 0) {
      this.camera.pan(-dx / high, dy / high);
    } else {
      this.camera.rotate(dx * TURN, dy * TURN);
    }
    this.changed();
  }

  #spread(): number {
    const [a, b] = [...this.#fingers.values()];
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 1;
  }

  #wheel(event: WheelEvent): void {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    this.camera.zoom(Math.exp(Math.min(Math.max(event.deltaY * lines, -240), 240) * 0.0016));
    this.changed();
  }

  #key(event: KeyboardEvent): void {
    this.#shift = event.shiftKey;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Home" || event.key === "0") this.#reset();
    else if (MOVES.has(event.key)) this.#keys.add(event.key);
    else return;
    event.preventDefault();
    this.changed();
  }
}
