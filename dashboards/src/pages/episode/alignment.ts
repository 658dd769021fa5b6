/** Two episodes on one clock. A row has a call of each where the calls match, or a call of only one. */
import type { Comparison } from "../../lib/generated";
import { START, callText, rewardOf, shortName, type Episode, type Recording, type Step } from "../../lib/trace";
import { momentOf } from "./camera";

/** `a` is the episode of the page and stands left, `b` the one beside it. */
export type Side = "a" | "b";

/** How the calls of a row compare. `state`: nothing that the agent is told differs, but the state of the simulator does. */
export type Match = "same" | "state" | "outcome" | "call" | "one";

export interface Row {
  /** Index of the call of each side; null if the side has none in this row. */
  a: number | null;
  b: number | null;
  /** Null if the episodes play different tasks, whose calls are not compared. */
  match: Match | null;
}

export interface Alignment {
  rows: Row[];
  /** So many first rows are the same in every respect. */
  shared: number;
  /** The side that branches from the other, before this step. */
  branch: Branching | null;
  /** The first row below the line that separates what both have in common: where the branch begins, else where the calls differ first. */
  parting: number | null;
  /** Inputs known before the first call that differ, besides the policy. */
  inputs: string[];
  sameStart: boolean;
  /** False if the episodes play different tasks: row n then has call n of each. */
  sameTask: boolean;
}

export interface Branching {
  side: Side;
  step: number;
}

function branching(a: Episode, b: Episode): Branching | null {
  const from = (branch: Episode, parent: Episode) =>
    branch.header.parent?.trace === parent.digest ? branch.header.parent.call : null;
  const [own, other] = [from(a, b), from(b, a)];
  return own !== null ? { side: "a", step: own } : other !== null ? { side: "b", step: other } : null;
}

export function sameTask(a: Recording, b: Recording): boolean {
  return a.episode.header.task_digest === b.episode.header.task_digest;
}

/** The calls as the service aligned them. `exchanged`: the service was asked about b and a. */
export function aligned(a: Recording, b: Recording, comparison: Comparison, exchanged: boolean): Alignment {
  const shared = Array.from({ length: comparison.same_calls }, (_, call): Row => ({ a: call, b: call, match: "same" }));
  const rows = comparison.rows.map((row): Row => {
    const [one, other] = exchanged ? [row.b, row.a] : [row.a, row.b];
    const calls = { a: one?.call ?? null, b: other?.call ?? null };
    if (calls.a === null || calls.b === null) return { ...calls, match: "one" };
    if (!row.same_call) return { ...calls, match: "call" };
    if (row.same_outcome) return { ...calls, match: "same" };
    return { ...calls, match: sameResult(a.steps[calls.a]!, b.steps[calls.b]!) ? "state" : "outcome" };
  });
  const all = [...shared, ...rows];
  const branch = branching(a.episode, b.episode);
  const begins = branch ? all.findIndex(({ a, b }) => Math.max(a ?? START, b ?? START) >= branch.step) : shared.length;
  return {
    rows: all, shared: shared.length, branch, parting: all[begins] && begins > 0 ? begins : null, inputs: comparison.inputs,
    sameStart: comparison.same_start, sameTask: true,
  };
}

/** Call n beside call n, compared by nothing. */
export function numbered(a: Recording, b: Recording): Alignment {
  const call = ({ steps }: Recording, index: number) => (index < steps.length ? index : null);
  const rows = Array.from({ length: Math.max(a.steps.length, b.steps.length) }, (_, index): Row =>
    ({ a: call(a, index), b: call(b, index), match: null }));
  return { rows, shared: 0, branch: null, parting: null, inputs: [], sameStart: false, sameTask: false };
}

/** Whether the agent was told the same, the world graphs changed alike and the reward is the same as far as it is shown. */
function sameResult(a: Step, b: Step): boolean {
  const told = ({ outcome, reply, changes }: Step) => JSON.stringify([outcome.error, outcome.text, reply, changes]);
  return told(a) === told(b) && Math.abs(rewardOf(a) - rewardOf(b)) < 0.005;
}

export const differs = ({ match }: Row) => match === "outcome" || match === "call" || match === "one";

/** The next row that differs; null if there is none. */
export function nextDifference(rows: Row[], row: number): number | null {
  const next = rows.findIndex((one, index) => index > row && differs(one));
  return next < 0 ? null : next;
}

/** The last step of a side at or before a row. */
export function stepAt(rows: Row[], side: Side, row: number): number {
  return rows.slice(0, row + 1).findLast((one) => one[side] !== null)?.[side] ?? START;
}

/** Why a side shows its last step at a row: the row has a call of the other one only. Undefined if it has a call there. */
export function absence(rows: Row[], side: Side, row: number): string | undefined {
  if (row === START || rows[row]?.[side] !== null) return undefined;
  return rows.findLastIndex((one) => one[side] !== null) < row ? "Ended." : "No call here.";
}

/** The row of a step; the last row if the side has no such step. */
export function rowOf(rows: Row[], side: Side, step: number): number {
  if (step <= START) return START;
  const row = rows.findIndex((one) => one[side] === step);
  return row < 0 ? rows.length - 1 : row;
}

/** The row that an address asks for, by itself, by a step of the other episode (`beside_step`) or by one of this episode. */
export function rowOfAddress(query: URLSearchParams, rows: Row[]): number {
  const [row, other] = [query.get("row"), query.get("beside_step")].map((text) => Number.parseInt(text ?? "", 10));
  if (!Number.isNaN(row!)) return Math.min(rows.length - 1, Math.max(START, row!));
  return Number.isNaN(other!) ? rowOf(rows, "a", momentOf(query)) : rowOf(rows, "b", other!);
}

/** A value of one side at the start and at every row, up to its last call. */
export function alongRows(rows: Row[], side: Side, start: number | null, values: (number | null)[]): (number | null)[] {
  const last = rows.findLastIndex((row) => row[side] !== null);
  return [start, ...rows.map((_, row) => {
    const step = stepAt(rows, side, row);
    return row > last ? null : step === START ? start : (values[step] ?? null);
  })];
}

/** The sides by letter, with what tells the two apart: the policy, else its checkpoint, the run or the seed. */
export function sideNames(a: Episode, b: Episode): [string, string] {
  const [one, other] = [a.header, b.header];
  const both = (name: (header: Episode["header"]) => string): [string, string] => [`A (${name(one)})`, `B (${name(other)})`];
  if (one.policy.name !== other.policy.name) return both(({ policy }) => policy.name);
  if (one.policy.checkpoint !== other.policy.checkpoint) return both(({ policy }) => `${policy.name}, ${policy.checkpoint ?? "no checkpoint"}`);
  if (one.run_id !== other.run_id) return both(({ policy, run_id }) => `${policy.name}, run ${run_id}`);
  if (one.seed !== other.seed) return both(({ policy, seed }) => `${policy.name}, seed ${seed}`);
  return both(({ policy }) => policy.name);
}

/** The step that each side has in a row. */
export function rowSteps({ a, b }: Row): string {
  const text = (letter: string, step: number | null) => `${letter} ${step === null ? "no call" : `step ${step}`}`;
  return `${text("A", a)}, ${text("B", b)}`;
}

/** In what two tasks differ, as far as their traces tell. */
export function taskDifferences(a: Episode, b: Episode): string[] {
  const short = (digest: string) => digest.slice(0, 8);
  const unlike = (of: (episode: Episode) => unknown) => JSON.stringify(of(a)) !== JSON.stringify(of(b));
  const values = (name: string, of: (episode: Episode) => string) => (unlike(of) ? [`${name} (${of(a)} and ${of(b)})`] : []);
  const named = (name: string, of: (episode: Episode) => unknown) => (unlike(of) ? [name] : []);
  const scene = values("scene", ({ header }) => header.scene_id);
  const found = [
    ...values("family", ({ header }) => header.family),
    ...named("instruction", ({ task }) => task.instruction),
    ...values("target", ({ task }) => shortName(task.target)),
    ...values("source", ({ task }) => task.src),
    ...values("destination", ({ task }) => task.dest),
    ...named("distractors", ({ task }) => [task.object_distractors, task.src_distractors, task.dest_distractors]),
    ...named("goal", ({ task }) => task.goal),
    ...(scene.length ? scene : values("scene digest", ({ header }) => short(header.scene_digest))),
    ...named("start state", ({ start }) => start.graphs),
    ...values("seed", ({ header }) => String(header.seed)),
  ];
  return found.length ? found : values("task digest", ({ header }) => short(header.task_digest));
}

/** The call of a side at a row, or that it has none. */
export function callAt({ steps }: Recording, step: number | null): string {
  return step === null || !steps[step] ? "no call" : callText(steps[step].input.call);
}
