/** The list of episodes in SQL: what a row is, what can be chosen, and how the choice becomes conditions. */
import { sql, traceName } from "./api";
import { words } from "./format";
import { PEOPLE } from "./labels";
import { link } from "./route.svelte";
import type { Found } from "./search";

/** A row that every list of episodes has. */
export interface Episode {
  episode_id: string;
  trace: string;
  outcome: "success" | "failure" | "broken off";
  policy: string;
  family: string | null;
  task_id: string | null;
  class: string | null;
  sub_class: string | null;
  decisive_step: number | null;
  instruction: string | null;
  trace_digest: string;
  /** Digest of the trace that this one branches from, and the first call that differs. */
  parent_trace: string | null;
  parent_call: number | null;
  /** How many branchings lie between it and a row of the list. */
  depth?: number;
  /** Where the text that was searched stands in it. */
  found?: Found;
  [column: string]: unknown;
}

/** Episodes with their class, decisive step and verdict, as `listed`. Rows of an older file of the same trace do not count. */
const listed = (condition: string) => `WITH listed AS (
  SELECT
    e.*,
    CASE WHEN e.success THEN 'success' WHEN e.end_reason IS NULL OR e.success IS NULL THEN 'broken off' ELSE 'failure' END AS outcome,
    CASE WHEN e.success THEN NULL ELSE coalesce(c.class, 'not classified') END AS class,
    c.sub_class, c.rule, c.step AS rule_step, c.last_step AS rule_last_step, c.evidence,
    coalesce(b.step, c.step) AS decisive_step,
    b.cause, b.explanation, b.advised_call, b.wasted_steps, b.point_of_no_return,
    coalesce(v.verdict, 'unverified') AS verdict, l.label, l.labelled_by
  FROM episodes e
  LEFT JOIN classes c ON c.trace_digest = e.trace_digest
  LEFT JOIN blame b ON b.trace_digest = e.trace_digest
  LEFT JOIN (
    SELECT trace_digest, CASE WHEN bool_or(verdict LIKE 'diverged%') THEN 'diverged' ELSE min(verdict) END AS verdict
    FROM verdicts GROUP BY trace_digest
  ) v ON v.trace_digest = e.trace_digest
  LEFT JOIN (${PEOPLE}) l ON l.episode_id = e.episode_id
  WHERE ${condition}
)`;
/** What was played. A branch is no trial of its policy: it stands below its parent, and counts nowhere. */
export const LISTED = listed("e.parent_trace IS NULL");
export const BRANCHES = listed("e.parent_trace IS NOT NULL");

/** What stands beside the list, in this order. */
export const FACETS = ["outcome", "policy", "family", "class", "sub_class", "run_id", "verdict", "end_reason", "label", "labelled_by"] as const;
export type Facet = (typeof FACETS)[number];
/** What links may choose besides. */
export const FILTERS = [...FACETS, "task_id", "target_category", "dest", "picked", "placed_on"] as const;
export type Filter = (typeof FILTERS)[number];
export type Choice = Partial<Record<Filter, string>>;

/** How a filter is called on a page. */
export function filterName(filter: Filter): string {
  const names: Partial<Record<Filter, string>> = {
    sub_class: "sub-class", run_id: "run", verdict: "replay", end_reason: "end", task_id: "task", target_category: "wanted", dest: "destination",
    placed_on: "placed on", labelled_by: "labelled by",
  };
  return names[filter] ?? filter;
}

/** The value of a filter as people read it; names that people gave stay as they are. */
export function filterValue(filter: Filter, value: string): string {
  return ["run_id", "policy", "task_id", "labelled_by"].includes(filter) ? value : words(value);
}

/** What was chosen in the address. */
export function choiceOf(query: URLSearchParams): Choice {
  return Object.fromEntries(FILTERS.flatMap((filter) => (query.get(filter) ? [[filter, query.get(filter)]] : [])));
}

/** The value of a facet as text; what is not there is `none`, so that it can be chosen as well. */
export function facetValue(facet: Facet): string {
  return `coalesce(${facet}, 'none')`;
}

/** Another object was picked than the goal's, or the goal's was placed elsewhere. */
const CONFUSED: Partial<Record<Filter, string>> = {
  picked: `episode_id IN (SELECT s.episode_id FROM steps s JOIN episodes x ON x.episode_id = s.episode_id
    JOIN objects o ON o.task_digest = x.task_digest AND o.instance = s.object
    WHERE s.tool = 'pick' AND s.error_code IS NULL AND NOT s.goal_object AND o.category = $picked)`,
  placed_on: `episode_id IN (SELECT episode_id FROM steps
    WHERE tool = 'place' AND error_code IS NULL AND goal_object AND NOT goal_receptacle AND receptacle = $placed_on)`,
};

/** The condition of one filter, on `listed`; its value is the parameter of the same name. */
export function condition(filter: Filter): string {
  const facet = FACETS.find((facet) => facet === filter);
  return facet ? `${facetValue(facet)} = $${facet}` : (CONFUSED[filter] ?? `${filter} = $${filter}`);
}

/** Conditions of a choice and of a clause that somebody wrote; a line break ends a comment in it. */
export function where(choice: Choice, clause = ""): string {
  const conditions = (Object.keys(choice) as Filter[]).map(condition);
  if (clause.trim()) conditions.push(`(${clause}\n)`);
  return conditions.length ? conditions.join(" AND ") : "true";
}

/** The page of an episode, at a step where one is known, and in a list where it was found in one. */
export function episodeLink(trace: string, step?: number | null, list?: string): string {
  return link(`/episodes/${encodeURIComponent(traceName(trace))}`, { step, list });
}

/** The trace of an episode that is named by its id; null where the tables have none, or there are no tables. */
export async function traceOf(id: string, signal: AbortSignal): Promise<string | null> {
  try {
    const [row] = await sql<{ trace: string }>("SELECT trace FROM episodes WHERE episode_id = $id", { id }, signal);
    return row?.trace ?? null;
  } catch {
    return null;
  }
}
