/** Questions for the archive of the server. */

/** What the user wrote; empty texts do not choose. Times as of an input for local times, places in metres. */
export interface Search {
  vehicle: string;
  from: string;
  to: string;
  x: string;
  y: string;
  radius: string;
}

export const PAGE = 20;
export const NOTHING: Search = { vehicle: "", from: "", to: "", x: "", y: "", radius: "100" };

/** The address of a search. after: `next` of the answer before. It throws an Error for people if a field is wrong. */
export function searchPath(search: Search, after: string | null = null): string {
  const query = new URLSearchParams({ limit: String(PAGE) });
  const vehicle = search.vehicle.trim();
  if (vehicle !== "") query.set("vehicle", vehicle);
  for (const name of ["from", "to"] as const) {
    if (search[name] !== "") query.set(name, new Date(search[name]).toISOString());
  }
  const [x, y] = [search.x.trim(), search.y.trim()];
  if ((x === "") !== (y === "")) throw new Error("A place needs X and Y.");
  if (x !== "") {
    const radius = search.radius.trim();
    if ([x, y, radius].some((text) => text === "" || !Number.isFinite(Number(text)))) {
      throw new Error("X, Y and the radius are numbers, in metres.");
    }
    query.set("around", `${Number(x)},${Number(y)}`);
    query.set("radius", `${Number(radius)}`);
  }
  if (after !== null) query.set("after", after);
  return `api/v1/archive?${query}`;
}

/** What is missing from a list; null if it is whole. lost: segments of the archive that no search finds */
export function missing(lost: number): string | null {
  if (lost === 0) return null;
  return `The list may be incomplete: the archive lost the tables of ${lost} segment${lost === 1 ? "" : "s"}.`;
}

/** How a segment was coded. */
export function coded(codec: string, bound_m: number | null): string {
  if (bound_m === null) return `${codec}, no bound`;
  return bound_m === 0 ? `${codec}, lossless` : `${codec}, within ${Number((bound_m * 1000).toPrecision(3))} mm`;
}
