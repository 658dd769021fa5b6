/** What a trace says, as the service tells it, and what follows from it for one moment of the episode. */

export type Call = { name: string; arguments?: Record<string, unknown> };
export type Point = [number, number, number];
export type Body = { body: string; position: Point };
export type Robot = { base: [number, number]; yaw: number; camera: Point; pitch: number; path_length_m: number };
export type Marker = { id: number; target: { kind: string; id: string } };
export type Change = { event: string; receptacle: string; object?: string; from?: string; to?: string };
export type Term = { component: string; value: number; reason: string };
export type Digests = { state?: string; chain?: string; frame?: { rgb: string; ids: string; depth: string } };
export type Place = { content: Record<string, number>; door?: string };
export type Graph = Record<string, Place>;

export type Step = {
  step: number;
  input: { call: Call; policy?: { raw?: string; reasoning?: string; history?: string; plan?: string } };
  outcome: { text: string; error?: string };
  tool?: string;
  reply?: { text: string; source: string };
  held?: string;
  receptacle?: string;
  markers: Marker[];
  visible: { object: string; pixels: number }[];
  changes: { physics: Change[]; registry: Change[] };
  bodies: Body[];
  robot?: Robot;
  sim_step?: number;
  reward: Term[];
  digests: Digests;
};

export type TaskObject = { instance: string; category: string; caption?: string };
export type Task = {
  task_id: string; family: string; task_type?: string; scene_id: string; instruction: string; purpose?: string;
  objects: TaskObject[]; target: string; src: string; dest: string; src_distractors: string[]; dest_distractors: string[];
};
export type Header = {
  episode_id: string; run_id: string; group_id?: string; task_id: string; family: string; scene_id: string; seed: number;
  backend: string; profile: string; reward_preset: string; policy: { name: string; checkpoint?: string };
  parent?: { trace: string; call: number };
};
export type Metrics = {
  success: boolean; completion: number; total_reward: number; discounted_return: number; length: number; asks: number;
    spl?: number;
};
export type Episode = {
  trace: string; digest: string; header: Header; task: Task; steps: number; images: number;
  start: { graphs: { physics: Graph; registry: Graph }; bodies: Body[]; robot?: Robot; visible: { object: string }[];
    digests: Digests };
  end?: { reason: string; metrics: Metrics };
};

export type Cost = { step: number; before: number | null; after: number | null; hindsight: number | null; regret: number | null };
export type Blame = {
  success: boolean | null;
  decisive: { step: number; call: Call; outcome: string; harm: string; cause: string; explanation: string; advised_call: Call | null } | null;
  wasted_steps: number; point_of_no_return: number | null; repairable_at_end: boolean;
  shares: Record<string, number>; costs: Cost[];
};

export type Rect = { min: [number, number]; max: [number, number] };
export type Scene = {
  rooms: { name: string; min: [number, number]; max: [number, number]; rects?: Rect[] }[];
  walls?: { from: [number, number]; to: [number, number] }[];
  receptacles: { id: string; category: string; surface_min: Point; surface_max: Point }[];
};

/** The moment before the first call. */
export const START = -1;

export type Recording = { episode: Episode; steps: Step[] };

/** `pick(marker_id=2)`. */
export function callText(call: Call): string {
  const given = Object.entries(call.arguments ?? {}).map(([name, value]) =>
    `${name}=${typeof value === "string" ? value : JSON.stringify(value)}`);
  // A policy that answered no call at all is recorded with an empty name.
  return call.name || given.length ? `${call.name}(${given.join(", ")})` : "no call";
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
