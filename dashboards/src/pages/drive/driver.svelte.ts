/** An episode that a person drives: what the agent would be told, the calls, and how it goes on after a reload. */
import { ApiError, get, post, remove, send } from "../../lib/api";
import { markersOf, type MarkerBox } from "../../lib/markers";
import { framePath, type Call, type Step } from "../../lib/trace";
import { policyOf, type Receptacle, type Tool } from "./tools";

/** A call of the episode with what came back. */
export interface Turn {
  /** Its number in the trace; null where it is not recorded, as a list of tasks. */
  number: number | null;
  call: Call;
  text: string;
  error: string | null;
}

/** A recorded step as the agent that made it knew it. */
export function turnOf({ step, input, outcome }: Step): Turn {
  return { number: step, call: input.call, text: outcome.text, error: outcome.error ?? null };
}

/** The latest image that the agent was given. */
export interface Seen {
  png: string;
  /** The call that returned it; null for what the episode began with. */
  call: number | null;
  boxes: MarkerBox[];
}

/** An observation of OpenEnv, as far as the page shows it. */
interface Observation {
  text: string;
  error: { code: string } | null;
  image: string | null;
  instruction: string | null;
  markers: number[] | null;
  decision: number | null;
  decisions_left: number | null;
  ended: string | null;
  receptacles: Receptacle[] | null;
  available_tools: Tool[] | null;
  metadata: { trace?: string; episode_id?: string; marker_boxes?: MarkerBox[] | null };
}
type Observed = { observation: Observation; done: boolean };

/** What a reload needs to go on. */
export interface Episode {
  id: string;
  trace: string;
  policy: string;
  briefing: string;
  instruction: string | null;
  /** Whether it is a trial of the person, and no branch. */
  trial: boolean;
  tools: Tool[];
  receptacles: Receptacle[];
  turns: Turn[];
  seen: Seen | null;
  markers: number[] | null;
  left: number | null;
  /** Why it ended; null while it runs. */
  ended: string | null;
  /** A call whose answer has not come. */
  pending: Call | null;
}

export class Driver {
  episode = $state.raw<Episode | null>(null);
  busy = $state(false);
  problem = $state.raw<unknown>(null);
  readonly open = $derived(this.episode !== null && this.episode.ended === null);
  /** How many recorded calls the person made. */
  readonly made = $derived(this.episode?.turns.filter(({ number }) => number !== null).length ?? 0);

  constructor(
    /** The trace that the episode starts from, and how many of its calls come before. */
    readonly parent: string,
    readonly call: number,
  ) {
    const kept = sessionStorage.getItem(this.key);
    try {
      if (kept) this.episode = JSON.parse(kept) as Episode;
    } catch {
      sessionStorage.removeItem(this.key);
    }
  }

  private get key() {
    return `reel-drive ${this.parent} ${this.call}`;
  }

  private set(changes: Partial<Episode>) {
    if (!this.episode) return;
    this.episode = { ...this.episode, ...changes };
    this.keep();
  }

  private keep() {
    const write = (episode: Episode | null) => sessionStorage.setItem(this.key, JSON.stringify(episode));
    try {
      write(this.episode);
    } catch {
      // An image is what may not fit: without it the episode still goes on.
      if (this.episode) write({ ...this.episode, seen: null });
    }
  }

  private async during(work: () => Promise<void>) {
    if (this.busy) return;
    this.busy = true;
    this.problem = null;
    try {
      await work();
    } catch (error) {
      this.problem = error;
    } finally {
      this.busy = false;
    }
  }

  /** Begins after the recorded calls, or, as a trial, an episode of the same task and seed that is no branch. */
  begin = (author: string, before: Turn[], trial: { task_id: string; seed: number } | null) => this.during(async () => {
    const policy = policyOf(author);
    const origin = trial ? { task: trial.task_id, seed: trial.seed } : { trace: this.parent, call: this.call };
    const { observation } = (await post("/reset", { ...origin, image: true, policy })) as unknown as Observed;
    this.episode = {
      id: observation.metadata.episode_id ?? "", trace: observation.metadata.trace ?? "", policy, briefing: observation.text,
      instruction: observation.instruction, trial: trial !== null, tools: observation.available_tools ?? [], receptacles: observation.receptacles ?? [], turns: [],
      seen: (await this.seenBefore(before, observation)) ?? seenIn(observation, null), markers: observation.markers, left: observation.decisions_left, ended: null, pending: null,
    };
    this.keep();
  });

  /** The image that the latest recorded call returned, with its numbers; null where the one of the reset shows as much. */
  private async seenBefore(before: Turn[], { markers, metadata }: Observation): Promise<Seen | null> {
    if (!markers?.length || metadata.marker_boxes?.length) return null;
    const call = before.findLast(({ call, error }) => error === null && call.name !== "ask")?.number ?? null;
    if (call === null) return null;
    const boxes = await markersOf(this.parent, call);
    if (!boxes.length) return null;
    const blob = await (await send("GET", framePath(this.parent, call))).blob();
    const bytes = new Uint8Array(await blob.arrayBuffer());
    return { png: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")), call: null, boxes };
  }

  step = (call: Call, reasoning: string) => this.during(async () => {
    // Without an answer to the last call nobody knows whether it was made.
    if (this.episode?.pending) await this.catchUp();
    const { episode } = this;
    if (!episode || episode.ended !== null) return;
    const action = { ...call, ...(reasoning.trim() ? { metadata: { "reel/policy": { reasoning: reasoning.trim() } } } : {}) };
    this.set({ pending: call });
    try {
      const { observation, done } = (await post("/step", { action, episode_id: episode.id, image: true })) as unknown as Observed;
      // Answers that are no calls of the episode, as the list of tasks, name no trace.
      const number = observation.metadata.trace ? this.call + this.made : null;
      this.set({
        pending: null, turns: [...episode.turns, { number, call, text: observation.text, error: observation.error?.code ?? null }],
        seen: seenIn(observation, number) ?? episode.seen, markers: observation.markers ?? episode.markers,
        left: observation.decisions_left ?? episode.left, ended: done ? (observation.ended ?? "over") : null,
      });
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 0)) this.set({ pending: null });
      if (error instanceof ApiError && error.status === 404) this.set({ ended: "closed by the service" });
      throw error;
    }
  });

  /** After a reload: whether the service still has the episode, and whether a call was made whose answer nobody saw. */
  resume = () => this.during(() => this.catchUp());

  private async catchUp() {
    const { episode } = this;
    if (!episode || episode.ended !== null) return;
    try {
      const state = (await get(`/state?episode_id=${encodeURIComponent(episode.id)}`)) as { step_count: number };
      const lost = state.step_count > this.call + this.made && episode.pending;
      const turn = lost && { number: this.call + this.made, call: lost, text: "The answer to this call did not arrive.", error: null };
      this.set({ pending: null, turns: turn ? [...episode.turns, turn] : episode.turns });
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 404)) throw error;
      this.set({ ended: "closed by the service", pending: null });
    }
  }

  /** Ends the episode, so that its trace is complete; one that is gone already is complete. */
  async close() {
    if (!this.episode || this.episode.ended !== null) return;
    try {
      await remove(`/api/sessions/openenv-${encodeURIComponent(this.episode.id)}`);
    } catch (error) {
      if (!(error instanceof ApiError && error.status === 404)) throw error;
    }
    this.set({ ended: "handed back" });
  }

  /** Forgets the episode in this browser; its trace stays. */
  forget() {
    sessionStorage.removeItem(this.key);
    this.episode = null;
  }
}

function seenIn({ image, metadata }: Observation, call: number | null): Seen | null {
  return image ? { png: image, call, boxes: metadata.marker_boxes ?? [] } : null;
}
