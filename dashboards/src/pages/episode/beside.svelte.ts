/** The episode that stands beside the one of the page, and how their calls are aligned. */
import { get } from "../../lib/api";
import { asked } from "../../lib/asked.svelte";
import type { Blame, Recording, Scene } from "../../lib/trace";
import { pathsOf } from "./ahead";
import { aligned, numbered, sameTask, sideNames, type Alignment } from "./alignment";
import { recorded, sceneOf } from "./load";

export interface Pair {
  own: Recording;
  other: Recording;
  alignment: Alignment;
  /** What the two are called in charts and tables. */
  names: [string, string];
}

/** Asked in the order of the names: two episodes have the same rows whichever of them the page is of. */
async function compared(own: Recording, other: Recording, signal: AbortSignal): Promise<Alignment> {
  if (!sameTask(own, other)) return numbered(own, other);
  const traces = [own.episode.trace, other.episode.trace];
  const exchanged = traces[0]! > traces[1]!;
  const [first, second] = (exchanged ? traces.toReversed() : traces).map(encodeURIComponent);
  const comparison = await get(`/api/traces/${first}/compare/${second}`, signal);
  return aligned(own, other, comparison, exchanged);
}

/** To be called while a component is made. `name` is the trace beside it, or nothing. */
export function besideOf(own: () => Recording | undefined, name: () => string) {
  const read = asked((signal) => (name() ? recorded(name(), signal) : null));
  const compare = asked((signal) => {
    const [one, other] = [own(), read.value];
    if (!one || other?.episode.trace !== name()) return null;
    return compared(one, other, signal).then((alignment): Pair =>
      ({ own: one, other, alignment, names: sideNames(one.episode, other.episode) }));
  });
  // While another episode is awaited, the one before is no answer.
  const pair = $derived(compare.value?.other.episode.trace === name() ? compare.value : undefined);
  const blame = asked((signal) => (pair ? get(pathsOf(pair.other.episode.trace).blame, signal) : null));
  const scene = asked((signal): Promise<Scene | "none"> | null =>
    pair && pair.own.episode.header.scene_digest !== pair.other.episode.header.scene_digest
      ? sceneOf(pair.other.episode.trace, signal) : null);
  return {
    get pair(): Pair | undefined { return pair; },
    get error(): unknown { return read.error ?? compare.error; },
    get blame(): Blame | null { return pair && blame.value?.trace_digest === pair.other.episode.digest ? blame.value : null; },
    get blameError(): unknown { return blame.error; },
    /** Its scene where it is another one than that of the page. */
    get scene(): Scene | "none" | undefined { return scene.value; },
    again: () => (read.error ? read.again() : compare.again()),
  };
}
