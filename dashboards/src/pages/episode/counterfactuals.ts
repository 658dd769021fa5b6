/** What other calls would have changed: rows of table `counterfactuals` of one episode, and what is said of them. */
import { ApiError, get } from "../../lib/api";
import { percent } from "../../lib/format";
import { markersBefore, shortName, type Call, type Episode, type Recording, type Step } from "../../lib/trace";

/** A plausible call of a step with what came of it. */
export interface Counterfactual {
  episode_id: string;
  trace_digest: string;
  step: number;
  /** The call in the place of the recorded one, as JSON with `name` and `arguments`. */
  call: string;
  tool: string;
  origin: string;
  with_recorded_success: boolean;
  with_recorded_completion: number;
  /** Null where the recorded calls succeed already. */
  with_planner_success: boolean | null;
  with_planner_completion: number | null;
  with_planner_length: number | null;
}

/** What came when somebody went on after a call: the recorded calls of the parent, or the competent agent. */
export interface Outcome {
  then: "parent" | "planner";
  success: boolean;
  /** Share of the goal, from 0 to 1. */
  completion: number;
  /** Decisions of the whole episode, where known. */
  length: number | null;
}

export interface OtherCall {
  call: Call;
  origin: string;
  /** What came of the call, the better continuation first. */
  outcomes: Outcome[];
}

/** The best outcome of the plausible calls of a step, from best to worst. `none`: no other call was plausible. */
export type Rescue = "call" | "planner" | "part" | "nothing" | "none";

export interface StepCalls {
  rescue: Rescue;
  calls: OtherCall[];
}

/** Rows of the trace that the page shows. Where there are no tables yet, nothing was played. */
export async function counterfactualsOf(episode: Episode, signal: AbortSignal): Promise<Counterfactual[]> {
  try {
    const id = encodeURIComponent(episode.header.episode_id);
    const rows: unknown = await get(`/api/counterfactuals?episode=${id}`, signal);
    return (rows as Counterfactual[]).filter(({ trace_digest }) => trace_digest === episode.digest);
  } catch (error) {
    if (error instanceof ApiError && error.status === 404) return [];
    throw error;
  }
}

/** The share of the goal that the episode reached. */
export const reached = ({ end }: Episode) => end?.metrics?.completion ?? 0;

const ORDER: Rescue[] = ["call", "planner", "part", "nothing"];

function rescueOf({ outcomes }: OtherCall, completion: number): Rescue {
  const succeeded = outcomes.find(({ success }) => success);
  if (succeeded) return succeeded.then === "parent" ? "call" : "planner";
  return outcomes.some((outcome) => outcome.completion > completion + 1e-9) ? "part" : "nothing";
}

function otherCall(row: Counterfactual): OtherCall {
  const outcomes: Outcome[] = [
    { then: "parent", success: row.with_recorded_success, completion: row.with_recorded_completion, length: null },
  ];
  if (row.with_planner_success !== null) {
    outcomes.push({
      then: "planner", success: row.with_planner_success, completion: row.with_planner_completion ?? 0,
      length: row.with_planner_length,
    });
  }
  outcomes.sort((a, b) => Number(b.success) - Number(a.success) || b.completion - a.completion);
  return { call: JSON.parse(row.call) as Call, origin: row.origin, outcomes };
}

/** The plausible calls of every step, the best ones first. */
export function bySteps(rows: Counterfactual[], steps: number, completion: number): StepCalls[] {
  return Array.from({ length: steps }, (_, step) => {
    const tried = rows.filter((row) => row.step === step).map(otherCall)
      .map((call) => ({ call, rank: ORDER.indexOf(rescueOf(call, completion)) }))
      .sort((a, b) => a.rank - b.rank);
    return { rescue: ORDER[tried[0]?.rank ?? -1] ?? "none", calls: tried.map(({ call }) => call) };
  });
}

const FAILED: Record<Rescue, string> = {
  call: "rescued alone: this one call, then the agent's own calls",
  planner: "rescued with help: this call, then a competent agent",
  part: "partly: more of the goal than the episode reached",
  nothing: "nothing helps",
  none: "no other call was plausible",
};
const SUCCEEDED: Record<Rescue, string> = {
  ...FAILED,
  call: "succeeds too: this one call, then the agent's own calls",
  planner: "succeeds too: this call, then a competent agent",
  nothing: "fails with every other call",
};

/** What an outcome of a step is called, for an episode that failed or succeeded. */
export const rescueWords = (success: boolean) => (success ? SUCCEEDED : FAILED);

const ORIGINS: Record<string, string> = {
  advice: "what a competent agent would call here",
  question: "what a competent agent would ask",
  marker: "the same tool with another marker",
  receptacle: "another place of the same kind",
};
export const originText = (origin: string) => ORIGINS[origin] ?? origin;

export function outcomeText({ then, success, completion, length }: Outcome): string {
  const who = then === "parent" ? "then the agent's own calls" : "then a competent agent";
  const after = length === null ? "" : `, ${length} ${length === 1 ? "decision" : "decisions"} in all`;
  return `${who}: ${success ? "success" : `failure with ${percent(completion)} of the goal`}${after}`;
}

/** What the marker of a call stood for; nothing where the call names none. */
export function markedThing(steps: Step[], at: number, { arguments: given }: Call): string {
  const marker = markersBefore(steps, at).find(({ id }) => id === given?.["marker_id"]);
  return marker ? shortName(marker.target.id) : "";
}

const stepsText = (count: number) => (count === 1 ? "1 step" : `${count} steps`);

/** The last step at which another call, played in its place, led to success; null if none did. */
export function lastRescue(steps: StepCalls[]): number | null {
  const last = steps.findLastIndex(({ rescue }) => rescue === "call" || rescue === "planner");
  return last < 0 ? null : last;
}

/** At how many steps another call would have changed the end, and after which none does. */
export function summary(steps: StepCalls[], { episode }: Recording): string {
  const count = (wanted: Rescue) => steps.filter(({ rescue }) => rescue === wanted).length;
  const [alone, helped, partly] = [count("call"), count("planner"), count("part")];
  const all = stepsText(steps.length);
  if (episode.end?.metrics?.success) return `With one other call it succeeds too at ${alone + helped} of ${all}.`;
  if (!alone && !helped) {
    const more = partly ? ` At ${stepsText(partly)} one reaches more of the goal.` : "";
    return `No plausible call would have rescued it at any of its ${all}.${more}`;
  }
  const end = lastRescue(steps);
  const last = end === null || end === steps.length - 1 ? "" : `, at step ${end} for the last time`;
  if (!alone) {
    return `No other call alone would have rescued it; a competent agent who took over would have at ${helped} of ${all}${last}.`;
  }
  const more = helped ? `; a competent agent who took over would have at ${helped} more` : "";
  return `One other call would have rescued it at ${alone} of ${all}${more}${last}.`;
}
