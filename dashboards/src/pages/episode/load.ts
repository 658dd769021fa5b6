/** What the page of an episode reads of the service. */
import { ApiError, get } from "../../lib/api";
import { episodeLink, traceOf } from "../../lib/episodes";
import { route } from "../../lib/route.svelte";
import type { Recording, Scene } from "../../lib/trace";
import { pathsOf } from "./ahead";

const unknown = (error: unknown) => error instanceof ApiError && error.status === 404;

export async function recorded(name: string, signal: AbortSignal): Promise<Recording> {
  const path = pathsOf(name);
  const [episode, steps] = await Promise.all([get(path.episode, signal), get(path.steps, signal)]);
  return { episode, steps };
}

/** The trace of the address, which may also name an episode by its id. */
export async function named(trace: string, signal: AbortSignal): Promise<Recording> {
  try {
    return await recorded(trace, signal);
  } catch (error) {
    const found = unknown(error) ? await traceOf(trace, signal) : null;
    if (!found) throw error;
    route.correct(episodeLink(found, null) + location.search);
    return new Promise(() => {}); // the page of the trace begins
  }
}

export async function sceneOf(name: string, signal: AbortSignal): Promise<Scene | "none"> {
  try {
    return await get(pathsOf(name).scene, signal);
  } catch (error) {
    if (unknown(error)) return "none";
    throw error;
  }
}
