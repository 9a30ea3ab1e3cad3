/** The address of the page: which stream is shown, and a view that somebody sent. */
import { LONGEST_LINK, linkOf, type SavedView, viewOfLink } from "./views";

const FORM = /^#\/(\.{0,63}[\w-][\w.-]{0,63})\/(\.{0,63}[\w-][\w.-]{0,63})(?:\?view=([\w-]+))?$/;

/** What a part behind # names: a stream as vehicle/sensor and a view; null for what is not there. */
export function readHash(hash: string): { key: string | null; view: SavedView | null } {
  const found = hash.length <= LONGEST_LINK + 200 ? FORM.exec(hash) : null;
  if (!found) return { key: null, view: null };
  return { key: `${found[1]}/${found[2]}`, view: found[3] ? viewOfLink(found[3]) : null };
}

export function hashOf(view: SavedView): string {
  return `#/${view.stream}?view=${linkOf(view)}`;
}
