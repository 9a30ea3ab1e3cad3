/** Saved views: what the picture shows and from where, by name, kept by the browser or sent as a link. */
import type { Camera, Colour, Stand, ViewOptions } from "../view";
import { type Box, checkedBox } from "../view/scene/box";
import { MOST_STREAMS } from "../view/scene/mounts";
import { DEFAULT_OPTIONS } from "../view/types";

export const COLOURS: readonly Colour[] = ["height", "intensity", "distance", "ring", "stream"];
export const CAMERAS: readonly Camera[] = ["orbit", "follow"];
export const MOST_VIEWS = 30;
export const LONGEST_NAME = 40;
/** Characters of a view in a link. */
export const LONGEST_LINK = 4000;
const NAME = String.raw`\.{0,63}[\w-][\w.-]{0,63}`;
/** A stream as vehicle/sensor, as a part of a regular expression. */
export const KEY = `${NAME}/${NAME}`;
const ONLY_KEY = new RegExp(`^${KEY}$`);
const FIELDS = ["yaw", "pitch", "distance", "x", "y", "z"] as const;

/** What of the options a view has. */
type Look = Pick<ViewOptions, "colour" | "camera" | "pointSize" | "trail" | "rangeImage">;

export interface SavedView extends Look {
  name: string;
  /** The chosen stream, as vehicle/sensor, and the others in the picture. */
  stream: string;
  beside: string[];
  stand: Stand;
  box: Box | null;
}

const isKey = (value: unknown): value is string => typeof value === "string" && ONLY_KEY.test(value);
const isNumber = (value: unknown): value is number => typeof value === "number" && Number.isFinite(value);
const within = (value: unknown, least: number, most: number, otherwise: number) =>
  isNumber(value) ? Math.min(Math.max(value, least), most) : otherwise;

/** How the picture looks, of something that was kept or sent by somebody: within its limits, and else as at first. */
function checkedLook({ colour, camera, pointSize, trail, rangeImage }: Partial<Look>): Look {
  return {
    colour: COLOURS.includes(colour as Colour) ? (colour as Colour) : DEFAULT_OPTIONS.colour,
    camera: CAMERAS.includes(camera as Camera) ? (camera as Camera) : DEFAULT_OPTIONS.camera,
    pointSize: within(pointSize, 0.5, 5, DEFAULT_OPTIONS.pointSize),
    trail: Math.round(within(trail, 0, 10, DEFAULT_OPTIONS.trail)),
    rangeImage: rangeImage !== false,
  };
}

/** The options in a text of the browser's store, within their limits; what belongs to the streams is not among them. */
export function optionsIn(text: string | null): ViewOptions {
  const found = (parsed(text ?? "{}") ?? {}) as Partial<ViewOptions>;
  const yes = (name: "compare" | "decodeInBrowser" | "fillGaps" | "measure") =>
    typeof found[name] === "boolean" ? found[name] : DEFAULT_OPTIONS[name];
  return {
    ...DEFAULT_OPTIONS,
    ...checkedLook(found),
    compare: yes("compare"),
    decodeInBrowser: yes("decodeInBrowser"),
    fillGaps: yes("fillGaps"),
    measure: yes("measure"),
    map: typeof found.map === "string" ? found.map : null,
  };
}

/** A view that was kept or sent by somebody; null for anything else. Numbers are brought into their limits. */
export function checkedView(value: unknown): SavedView | null {
  const { name, stream, beside, stand, box, ...look } = (value ?? {}) as Partial<SavedView>;
  const text = typeof name === "string" ? name.trim().slice(0, LONGEST_NAME) : "";
  if (!text || !isKey(stream) || !COLOURS.includes(look.colour as Colour)) return null;
  if (!CAMERAS.includes(look.camera as Camera)) return null;
  if (!stand || !FIELDS.every((field) => isNumber(stand[field]))) return null;
  const others = Array.isArray(beside) ? beside.filter((one) => isKey(one) && one !== stream) : [];
  return {
    name: text,
    stream,
    beside: [...new Set(others)].slice(0, MOST_STREAMS - 1),
    stand: Object.fromEntries(FIELDS.map((field) => [field, stand[field]])) as unknown as Stand,
    box: checkedBox(box),
    ...checkedLook(look),
  };
}

/** The views in a text of the browser's store, at most 30. */
export function viewsIn(text: string | null): SavedView[] {
  const found = parsed(text ?? "[]");
  if (!Array.isArray(found)) return [];
  return found.slice(0, MOST_VIEWS).flatMap((one) => checkedView(one) ?? []);
}

/** The views with one more, in place of that of the same name; the oldest goes where there are too many. */
export function withView(views: readonly SavedView[], one: SavedView): SavedView[] {
  return [one, ...views.filter(({ name }) => name !== one.name)].slice(0, MOST_VIEWS);
}

/** A view as a part of an address: base64 of its JSON, with letters that addresses allow. */
export function linkOf(view: SavedView): string {
  const bytes = new TextEncoder().encode(JSON.stringify(view));
  const text = btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  return text.replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}

/** The view of such a part; null if it is none. */
export function viewOfLink(text: string): SavedView | null {
  if (text.length > LONGEST_LINK) return null;
  try {
    const bytes = Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (one) => one.charCodeAt(0));
    return checkedView(parsed(new TextDecoder().decode(bytes)));
  } catch {
    return null;
  }
}

function parsed(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}
