/** Plays another future of an episode and shows it beside the episode, for What if and the counterfactual strip. */
import { onDestroy } from "svelte";
import { post } from "../../lib/api";
import { route } from "../../lib/route.svelte";
import type { Call } from "../../lib/trace";
import { branchName } from "./tools";

/** Who goes on after the call: the recorded calls, nobody, or a built-in policy. */
export type Then = "parent" | "stop" | "planner" | "oracle";

/** To be called while a component is made; what it waits for ends with the component. */
export function branchPlayer() {
  let busy = $state(false);
  let problem = $state("");
  const leaving = new AbortController();
  onDestroy(() => leaving.abort());

  /** Plays `call` in place of step `at`; null: whoever goes on begins there. */
  async function play(trace: string, at: number, call: Call | null, then: Then): Promise<void> {
    busy = true;
    problem = "";
    const body = {
      at, calls: call ? [call] : [], name: branchName(trace, at, call),
      ...(then === "parent" ? { parent_from: at + 1 } : then === "stop" ? {} : { policy: then }),
    };
    try {
      const branch = await post(`/api/traces/${encodeURIComponent(trace)}/branches`, body, leaving.signal);
      if (!leaving.signal.aborted) {
        route.choose({ beside: branch.trace, branch: null, step: at, row: null, beside_step: null, whatif: null }, true);
      }
    } catch (error) {
      if (!leaving.signal.aborted) problem = (error as Error).message;
    }
    busy = false;
  }
  return {
    get busy() { return busy; },
    /** Why the last one could not be played. */
    get problem() { return problem; },
    play,
  };
}
