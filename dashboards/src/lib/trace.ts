/** What a trace says, as the service tells it, and what follows from it for one moment of the episode. */

import type { Body, Call, Change, Marker, Robot, Step, TraceEpisode } from "./generated";

export type {
  Blame, Body, Call, Robot, Scene, Step, StepCost as Cost, Task, Term, TraceEpisode as Episode,
} from "./generated";
export type Point = Body["position"];

/** The moment before the first call. */
export const START = -1;
/** How fast an episode plays. */
export const SPEEDS = [0.5, 1, 2, 4];

export type Recording = { episode: TraceEpisode; steps: Step[] };

/** Whether the task says what shall be moved where: costs, blame and rewards are measured against that. */
export const hasGoal = ({ episode }: Recording) => episode.task.target !== "";

/** Whether there are images: a simulator that draws them, or those that came with the trace. */
export const hasImages = ({ episode, steps }: Recording) =>
  episode.header.backend === "sim" || [episode.start, ...steps].some(({ digests }) => digests?.frame);

/** `pick(marker_id=2)`. */
export function callText(call: Call): string {
  const given = Object.entries(call.arguments ?? {}).map(([name, value]) =>
    `${name}=${typeof value === "string" ? value : JSON.stringify(value)}`);
  // A policy that answered no call at all is recorded with an empty name.
  return call.name || given.length ? `${call.name}(${given.join(", ")})` : "no call";
}

/** What was said beside a call. An answer that spells its call is told by the call. */
export function wordsBeside({ input: { call, policy } }: Step): string {
  const raw = policy?.raw?.trim() ?? "";
  return raw === policy?.reasoning?.trim() || raw.includes(`"${call.name}"`) ? "" : raw;
}

export function changeText(change: Change): string {
  if (change.event === "door") return `${change.receptacle}: door ${change.from} → ${change.to}`;
  return `${change.receptacle}: ${change.event === "add" ? "+" : "−"} ${shortName(change.object ?? "?")}`;
}

/** `teddy_bear_04_on_counter_1_at_home_0001` without the part that every object of the task has. */
export function shortName(instance: string): string {
  return instance.replace(/_at_[A-Za-z0-9]+_\d+$/, "");
}

export function rewardOf(step: Step): number {
  return step.reward.reduce((sum, term) => sum + term.value, 0);
}

/** What was earned up to a moment, this step included. */
export function earned(steps: Step[], moment: number): number {
  return steps.slice(0, moment + 1).reduce((sum, step) => sum + rewardOf(step), 0);
}

/** The state of the robot and the bodies at a moment. A branch that is shorter stays at its end. */
export function stateAt({ episode, steps }: Recording, moment: number): { robot?: Robot; bodies: Body[]; held?: string } {
  const step = steps[Math.min(moment, steps.length - 1)];
  return moment === START || !step ? episode.start : step;
}

/** Which doors stand open at a moment. */
export function openDoors({ episode, steps }: Recording, moment: number): Set<string> {
  const open = new Set(Object.entries(episode.start.graphs.physics).filter(([, place]) => place.door === "open").map(([id]) =>
    id));
  for (const { changes } of steps.slice(0, moment + 1)) {
    for (const change of changes.physics) {
      if (change.event !== "door") continue;
      if (change.to === "open") open.add(change.receptacle);
      else open.delete(change.receptacle);
    }
  }
  return open;
}

/** The markers that the agent could name before a call: those of the latest map. */
export function markersBefore(steps: Step[], at: number): Marker[] {
  return steps.slice(0, at).findLast((step) => step.markers.length > 0)?.markers ?? [];
}

export function framePath(trace: string, moment: number, query = ""): string {
  return `/api/traces/${encodeURIComponent(trace)}/frames/${moment === START ? "start" : moment}${query}`;
}
