/** Requests to the server that gave the page. Addresses are relative, so that a proxy may put a path in front. */

/** What the server, or the way to it, has against a request: RFC 9457. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly detail: string,
    readonly kind: string,
    readonly field: string | null = null,
  ) {
    super(detail);
  }

  /** Whether the server did not answer at all. */
  get away(): boolean {
    return this.status === 0;
  }
}

interface ProblemBody {
  title?: string;
  detail?: string;
  type?: string;
  field?: string;
}

export interface Answer<T> {
  status: number;
  body: T;
}

export async function request<T>(
  method: string,
  path: string,
  token: string | null,
  body?: unknown,
  limitMs = 20_000,
): Promise<Answer<T>> {
  const headers: Record<string, string> = { Accept: "application/json" };
  if (token !== null) headers.Authorization = `Bearer ${token}`;
  if (body !== undefined || method === "PATCH" || method === "POST" || method === "DELETE") {
    headers["Content-Type"] = "application/json";
  }
  let response: Response;
  try {
    response = await fetch(new URL(path, document.baseURI), {
      method,
      headers,
      cache: "no-store",
      signal: AbortSignal.timeout(limitMs),
      ...(body === undefined ? {} : { body: JSON.stringify(body) }),
    });
  } catch {
    throw new Problem(0, "the server does not answer", "away");
  }
  if (response.status === 204) return { status: 204, body: undefined as T };
  const given: unknown = await response.json().catch(() => null);
  if (!response.ok) throw problemOf(response.status, given);
  return { status: response.status, body: given as T };
}

function problemOf(status: number, given: unknown): Problem {
  const problem = (given ?? {}) as ProblemBody;
  const kind = (problem.type ?? "").replace("urn:lidarcodec:problem:", "");
  return new Problem(status, problem.detail ?? problem.title ?? `the server answered ${status}`, kind, problem.field);
}

/** A file from the server. `told` is called with the bytes that are here, and may abort through the signal. */
export async function fetchFile(
  path: string,
  token: string | null,
  told: (bytes: number) => void,
  signal: AbortSignal,
): Promise<Blob> {
  const headers: Record<string, string> = token === null ? {} : { Authorization: `Bearer ${token}` };
  const response = await fetch(new URL(path, document.baseURI), { headers, cache: "no-store", signal }).catch(
    (error) => {
      signal.throwIfAborted();
      throw new Problem(0, `the server does not answer (${error})`, "away");
    },
  );
  if (!response.ok || response.body === null) throw problemOf(response.status, await response.json().catch(() => null));
  let here = 0;
  const counted = new TransformStream<Uint8Array, Uint8Array>({
    transform(part, rest) {
      here += part.length;
      told(here);
      rest.enqueue(part);
    },
  });
  try {
    return await new Response(response.body.pipeThrough(counted)).blob();
  } catch (error) {
    signal.throwIfAborted();
    throw new Problem(0, `the download was cut after ${here} bytes (${error})`, "cut");
  }
}
