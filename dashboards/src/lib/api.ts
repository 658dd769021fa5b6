/** What the service answers: REST under /api, SQL among it. Every failure is an ApiError that a page can show. */

import type { GetAnswer, PostAnswer } from "./generated";

export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    message: string,
  ) {
    super(message);
  }
}

export type Row = Record<string, unknown>;

const TOKEN = "reel-token";

/** The token of this browser, where the service demands one. */
export const token = {
  get: () => localStorage.getItem(TOKEN),
  set: (value: string) => localStorage.setItem(TOKEN, value),
};

export async function send(method: string, path: string, body?: unknown, signal?: AbortSignal): Promise<Response> {
  const headers: Record<string, string> = {};
  const known = token.get();
  if (known) headers["authorization"] = `Bearer ${known}`;
  if (body !== undefined) headers["content-type"] = "application/json";
  let answer: Response;
  try {
    answer = await fetch(path, { method, headers, body: body === undefined ? undefined : JSON.stringify(body), signal });
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") throw error;
    throw new ApiError(0, "unreachable", "The service does not answer. Does `reel serve` still run?");
  }
  if (answer.ok) return answer;
  const text = await answer.text();
  try {
    const { code, message } = JSON.parse(text).error;
    throw new ApiError(answer.status, code, message);
  } catch (error) {
    if (error instanceof ApiError) throw error;
    throw new ApiError(answer.status, "unknown", text || answer.statusText);
  }
}

/** The type of the answer follows from the path; a path that does not exist has the type `never`. */
export async function get<const P extends string>(path: P, signal?: AbortSignal): Promise<GetAnswer<P>> {
  return (await fetched(path, signal)).json();
}

export async function post<const P extends string>(path: P, body: unknown, signal?: AbortSignal): Promise<PostAnswer<P>> {
  const answer = await send("POST", path, body, signal);
  return answer.status === 204 ? (undefined as never) : answer.json();
}

/** An answer that is no JSON. */
export async function text(path: string, signal?: AbortSignal): Promise<string> {
  return (await send("GET", path, undefined, signal)).text();
}

/** What a `GET` answers, as the bytes that came. */
export async function bytes(path: string, signal?: AbortSignal): Promise<ArrayBuffer> {
  return (await fetched(path, signal)).arrayBuffer();
}

export async function remove(path: string): Promise<void> {
  await send("DELETE", path);
}

/** Answers that were asked for before somebody wanted them. */
const foreseen = new Map<string, Promise<Response>>();

/** Asks for what will be wanted in a moment, once each. What was foreseen before and wanted by nobody is forgotten. */
export function foresee(paths: string[]) {
  for (const path of [...foreseen.keys()]) if (!paths.includes(path)) foreseen.delete(path);
  for (const path of paths) {
    if (foreseen.has(path)) continue;
    const answer = send("GET", path);
    // Whoever wants it is told what went wrong.
    answer.catch(() => null);
    foreseen.set(path, answer);
  }
}

function fetched(path: string, signal?: AbortSignal): Promise<Response> {
  const known = foreseen.get(path);
  foreseen.delete(path);
  return known ?? send("GET", path, undefined, signal);
}

/** An image, as an address for <img>; to be given back to URL.revokeObjectURL. */
export async function image(path: string, signal?: AbortSignal): Promise<string> {
  return addressOf(await fetched(path, signal));
}

/** An image as [`image`] gives it, or null where the episode has none: nothing was recorded and nothing can be drawn. */
export async function imageIfAny(path: string, signal?: AbortSignal): Promise<string | null> {
  const answer = await fetched(`${path}${path.includes("?") ? "&" : "?"}if_any=true`, signal);
  return answer.status === 204 ? null : addressOf(answer);
}

async function addressOf(image: Response): Promise<string> {
  return URL.createObjectURL(await image.blob());
}

/** Asks the tables. Values go as `$parameters`, never into the text. */
export async function sql<T = Row>(text: string, parameters: Record<string, string> = {}, signal?: AbortSignal): Promise<T[]> {
  return (await send("POST", "/api/sql", { sql: text, parameters }, signal)).json();
}

/** A name of a trace, from the path that the tables tell. */
export function traceName(path: string): string {
  return path.replace(/^.*[/\\]/, "").replace(/\.mcap$/, "");
}
