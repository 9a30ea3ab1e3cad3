/** What is in the picture beside the chosen stream: other streams, the box, and views that are saved. */
import { computed, signal } from "@preact/signals";
import { keyOf } from "../model/minute";
import { type Poller, poll } from "../model/poll";
import type { Stream } from "../model/wire";
import { call, choose, chosen, nameOf, options, pathOf, setOptions, stream } from "../state";
import type { Beside, Box, Mount, Stand } from "../view";
import { hashOf, readHash } from "./address";
import * as store from "./store";
import { LONGEST_LINK, type SavedView, viewsIn, withView } from "./views";

const VIEWS = "lidarcodec.views";
const MOUNTS_MS = 5000;

/** Other streams that are asked for, as vehicle/sensor. */
export const besideKeys = signal<readonly string[]>([]);
/** Points outside are not drawn; null draws all. */
export const box = signal<Box | null>(null);
export const views = signal<readonly SavedView[]>(viewsIn(store.kept(VIEWS)));
/** Where the camera is to go; null once it went. */
export const wantedStand = signal<Stand | null>(null);
const mounts = signal<ReadonlyMap<string, Mount | null>>(new Map());

export const mount = computed<Mount | null>(() => stream.value?.mount ?? null);
export const beside = computed<readonly Beside[]>(() =>
  besideKeys.value
    .filter((key) => key !== chosen.value)
    .map((key) => ({ name: nameOf(key), mount: mounts.value.get(key) ?? null })),
);

/** Show another stream, too, or no longer. */
export function setBeside(key: string, on: boolean): void {
  const others = besideKeys.value.filter((one) => one !== key);
  besideKeys.value = on ? [...others, key] : others;
}

/** Ask where the sensors of these streams sit, until the returned function is called. */
export function watchMounts(keys: readonly string[]): (() => void) | undefined {
  if (keys.length === 0) return undefined;
  const asking: Poller = poll(MOUNTS_MS, async () => {
    const found = await Promise.all(
      keys.map((key) =>
        call<Stream>("GET", pathOf(nameOf(key))).then(
          ({ body }) => [key, body.mount] as const,
          () => [key, mounts.value.get(key) ?? null] as const, // it is not known now: the last answer holds
        ),
      ),
    );
    mounts.value = new Map(found);
  });
  return () => asking.stop();
}

/** The view that is shown now. */
export function viewNow(name: string, stand: Stand): SavedView | null {
  if (chosen.value === null) return null;
  const { colour, camera, pointSize, trail, rangeImage } = options.value;
  const look = { colour, camera, pointSize, trail, rangeImage };
  const others = beside.value.map(({ name: one }) => keyOf(one));
  return { name, stream: chosen.value, beside: others, stand, box: box.value, ...look };
}

/** Show a saved view. */
export function show(view: SavedView): void {
  const { colour, camera, pointSize, trail, rangeImage } = view;
  setOptions({ colour, camera, pointSize, trail, rangeImage });
  choose(view.stream);
  besideKeys.value = view.beside;
  box.value = view.box;
  wantedStand.value = view.stand;
}

export function keep(view: SavedView): void {
  setViews(withView(views.value, view));
}

export function forget(name: string): void {
  setViews(views.value.filter((one) => one.name !== name));
}

/** The address that shows a view; null for one that no address holds. */
export function addressOf(view: SavedView): string | null {
  const hash = hashOf(view);
  return hash.length <= LONGEST_LINK ? `${location.origin}${location.pathname}${location.search}${hash}` : null;
}

function setViews(changed: SavedView[]): void {
  views.value = changed;
  store.keep(VIEWS, changed);
}

function showSent(): void {
  const { view } = readHash(location.hash);
  if (view) show(view);
}

window.addEventListener("hashchange", showSent);
showSent();
