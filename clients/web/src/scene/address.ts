/** The address of the page: which stream is shown, and a view that somebody sent. */
import { KEY, LONGEST_LINK, linkOf, type SavedView, viewOfLink } from "./views";

const FORM = new RegExp(String.raw`^#/(${KEY})(?:\?view=([\w-]+))?$`);

/** What a part behind # names: a stream as vehicle/sensor and a view; null for what is not there. */
export function readHash(hash: string): { key: string | null; view: SavedView | null } {
  const found = hash.length <= LONGEST_LINK + 200 ? FORM.exec(hash) : null;
  if (!found) return { key: null, view: null };
  return { key: found[1] ?? null, view: found[2] ? viewOfLink(found[2]) : null };
}

export function hashOf(view: SavedView): string {
  return `#/${view.stream}?view=${linkOf(view)}`;
}
