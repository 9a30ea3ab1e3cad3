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
      signal: AbortSignal.timeout(20_000),
      ...(body === undefined ? {} : { body: JSON.stringify(body) }),
    });
  } catch {
    throw new Problem(0, "the server does not answer", "away");
  }
  if (response.status === 204) return { status: 204, body: undefined as T };
  const given: unknown = await response.json().catch(() => null);
  if (!response.ok) {
    const problem = (given ?? {}) as ProblemBody;
    const kind = (problem.type ?? "").replace("urn:lidarcodec:problem:", "");
    const detail = problem.detail ?? problem.title ?? `the server answered ${response.status}`;
    throw new Problem(response.status, detail, kind, problem.field ?? null);
  }
  return { status: response.status, body: given as T };
}
