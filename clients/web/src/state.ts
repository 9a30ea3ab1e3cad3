/** The state of the page: the user, the streams, and the chosen stream. Components read signals from here. */
import { computed, signal } from "@preact/signals";
import { Problem, request } from "./model/api";
import { fillsFor } from "./model/filling";
import { added, keyOf, lacks, type Minutes } from "./model/minute";
import { Steady } from "./model/missed";
import { type Poller, poll } from "./model/poll";
import type { Codec, FleetRow, Link, Schema, Session, Stream, TargetWarning } from "./model/wire";
import { readHash } from "./scene/address";
import { keep, keepInTab, kept, keptInTab } from "./scene/store";
import { optionsIn } from "./scene/views";
import type { StreamName, ViewOptions, ViewStats } from "./view";

const TOKEN = "lidarcodec.token";
const OPTIONS = "lidarcodec.view";
const FLEET_MS = 1000;
const STREAM_MS = 1000;
/** Interval while there is no stream, so that a new vehicle appears at once. */
const EMPTY_MS = 300;

export const token = signal<string | null>(keptInTab(TOKEN));
export const session = signal<Session | null>(null);
/** `asking`: it is not known yet whether a token is needed. */
export const gate = signal<"asking" | "closed" | "open">("asking");
/** Why the page asks for a token again. */
export const gateReason = signal<string | null>(null);
/** Since when the server does not answer; null while it does. */
export const awaySince = signal<number | null>(null);

export const rows = signal<FleetRow[] | null>(null);
export const minutes = signal<Minutes>(new Map());
export const codecs = signal<Codec[]>([]);
export const schema = signal<Schema | null>(null);
export const links = signal<Link[]>([]);
/** Names of the maps that the server has. */
export const maps = signal<string[]>([]);

export const chosen = signal<string | null>(fromHash());
export const chosenRow = computed(() => rows.value?.find((row) => keyOf(row) === chosen.value) ?? null);
/** The last state of the chosen stream; null before the first. */
export const stream = signal<Stream | null>(null);
/** Why its target bitrate is missed; null while it is reached. */
export const missed = signal<TargetWarning | null>(null);
export const stats = signal<ViewStats | null>(null);
export const options = signal<ViewOptions>(optionsIn(kept(OPTIONS)));
/** Streams of recordings and for programs for which the user has switched on filling. */
const filledAnyway = signal<ReadonlySet<string>>(new Set());
/** Whether gaps of the chosen stream are filled. */
export const fillGaps = computed(() =>
  fillsFor(chosenRow.value, stream.value) ? options.value.fillGaps : filledAnyway.value.has(chosen.value ?? ""),
);
/** The options, as they hold for the chosen stream and this server. */
export const optionsInForce = computed<ViewOptions>(() => {
  const { map } = options.value;
  return { ...options.value, fillGaps: fillGaps.value, map: map !== null && maps.value.includes(map) ? map : null };
});
export const mayChange = computed(() => session.value?.role === "operator");

/** Whether a token is needed, and there is none. */
function signedOut(): boolean {
  return gate.value === "closed";
}

/** Sends a request with the token, and updates the state of server and token from the answer. After a sign-out nothing
 * is sent, because panels may exist for a moment longer. */
export async function call<T>(
  method: string,
  path: string,
  body?: unknown,
  limitMs?: number,
): Promise<{ status: number; body: T }> {
  if (signedOut()) throw new Problem(401, "a token is needed", "token");
  try {
    const answer = await request<T>(method, path, token.value, body, limitMs);
    awaySince.value = null;
    return answer;
  } catch (error) {
    if (error instanceof Problem) {
      if (error.away) awaySince.value ??= Date.now();
      else awaySince.value = null;
      if (error.status === 401 && !signedOut()) signOut("This token is no longer valid.");
    }
    throw error;
  }
}

/** The path of a stream's routes. */
export function pathOf(stream: StreamName): string {
  return `api/v1/streams/${encodeURIComponent(stream.vehicle)}/${encodeURIComponent(stream.sensor)}`;
}

export function nameOf(key: string): StreamName {
  const [vehicle = "", sensor = ""] = key.split("/");
  return { vehicle, sensor };
}

/** Show a stream; null for none. */
export function choose(key: string | null): void {
  chosen.value = key;
  const hash = key === null ? "" : `#/${key}`;
  if (location.hash !== hash) history.replaceState(null, "", hash || location.pathname + location.search);
}

export function setOptions(changed: Partial<ViewOptions>): void {
  options.value = { ...options.value, ...changed };
  keep(OPTIONS, options.value);
}

/** Switch filling of gaps of the chosen stream on or off. */
export function setFillGaps(on: boolean): void {
  if (fillsFor(chosenRow.value, stream.value)) {
    setOptions({ fillGaps: on });
    return;
  }
  const others = [...filledAnyway.value].filter((key) => key !== chosen.value);
  filledAnyway.value = new Set(on && chosen.value !== null ? [...others, chosen.value] : others);
}

let fleet: Poller | null = null;

/** Find out whether a token is needed, and begin. */
export async function begin(): Promise<void> {
  for (;;) {
    try {
      const { body } = await request<Session>("GET", "api/v1/session", token.value);
      awaySince.value = null;
      if (body.role === null) signOut(null);
      else open(body);
      return;
    } catch (error) {
      if (error instanceof Problem && error.status === 401) {
        signOut("This token is no longer valid.");
        return;
      }
      awaySince.value ??= Date.now();
      await new Promise((resolve) => setTimeout(resolve, 1000));
    }
  }
}

/** Try a token. Throws a Problem if it is not valid. */
export async function signIn(given: string): Promise<void> {
  const { body } = await request<Session>("GET", "api/v1/session", given);
  if (body.role === null) throw new Problem(401, "a token is needed", "token");
  keepInTab(TOKEN, given);
  token.value = given;
  open(body);
}

export function signOut(reason: string | null): void {
  fleet?.stop();
  fleet = null;
  keepInTab(TOKEN, null);
  token.value = null;
  session.value = null;
  gateReason.value = reason;
  gate.value = "closed";
  rows.value = null;
  minutes.value = new Map();
}

function open(answer: Session): void {
  session.value = answer;
  gate.value = "open";
  fleet?.stop();
  fleet = poll(() => (rows.value?.length === 0 ? EMPTY_MS : FLEET_MS), askFleet);
}

async function askFleet(): Promise<void> {
  const whole = rows.value === null || lacks(minutes.value, rows.value);
  const { body } = await call<FleetRow[]>("GET", `api/v1/fleet${whole ? "?minute=true" : ""}`);
  if (gate.value !== "open") return;
  minutes.value = added(minutes.value, body);
  rows.value = body;
  if (chosen.value === null) {
    const first = body.find((row) => row.alive) ?? body[0];
    if (first) choose(keyOf(first));
  }
  if (codecs.value.length === 0) await askTables();
}

async function askTables(): Promise<void> {
  const [table, common, presets, towns] = await Promise.all([
    call<Codec[]>("GET", "api/v1/codecs"),
    call<Schema>("GET", "api/v1/settings"),
    call<Link[]>("GET", "api/v1/links"),
    call<{ name: string }[]>("GET", "api/v1/maps"),
  ]);
  codecs.value = table.body;
  schema.value = common.body;
  links.value = presets.body;
  maps.value = towns.body.map(({ name }) => name);
}

let watching: Poller | null = null;

/** Poll a stream, until the returned function is called. */
export function watchStream(key: string): () => void {
  const steady = new Steady();
  const asking = poll(STREAM_MS, async () => {
    const { body } = await call<Stream>("GET", pathOf(nameOf(key)));
    if (watching !== asking) return;
    stream.value = body;
    missed.value = steady.take(body.warnings[0] ?? null, performance.now());
  });
  watching = asking;
  return () => {
    asking.stop();
    if (watching === asking) watching = null;
    stream.value = missed.value = null;
  };
}

/** Request the chosen stream at once. */
export function refreshStream(): void {
  watching?.now();
}

/** Request the list of streams at once. */
export function refreshFleet(): void {
  fleet?.now();
}

function fromHash(): string | null {
  return readHash(location.hash).key;
}

window.addEventListener("hashchange", () => {
  const key = fromHash();
  if (key !== null) chosen.value = key;
});
