/** The list of episodes in SQL: what a row is, what can be chosen, and how the choice becomes conditions. */
import { sql, traceName } from "./api";
import { words } from "./format";
import { PEOPLE, author } from "./labels";
import { REMARKED, starName } from "./remarks";
import { link } from "./route.svelte";
import type { Found } from "./search";

/** A row that every list of episodes has. */
export interface Episode {
  episode_id: string;
  trace: string;
  outcome: "success" | "failure" | "broken off" | "not judged";
  policy: string;
  family: string | null;
  task_id: string | null;
  class: string | null;
  sub_class: string | null;
  decisive_step: number | null;
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

/** The class of a failure, from `episodes e` and `classes c`. */
export const CLASS = "CASE WHEN e.success THEN NULL ELSE coalesce(c.class, 'not classified') END";

/** When a replay was last found to be so; those of before version 0.3 have no time, and come first. */
const last = (verdict: string) => `max(coalesce(at_ms, 0)) FILTER (WHERE verdict ${verdict})`;

/** What replays found of each trace: `diverged` where none that compared as much was exact since. */
export const VERDICTS = `SELECT trace_digest, CASE
      WHEN ${last("= 'diverged'")} >= coalesce(${last("= 'exact'")}, 0) THEN 'diverged'
      WHEN ${last("= 'diverged_without_rgb'")} >= coalesce(${last("LIKE 'exact%'")}, 0) THEN 'diverged'
      ELSE min(verdict) FILTER (WHERE verdict NOT LIKE 'diverged%') END AS verdict
    FROM verdicts GROUP BY trace_digest`;

/** Episodes with their class, decisive step, verdict and remarks, as `listed`. Rows of an older file of the same trace do not count. */
const listed = (condition: string) => `WITH listed AS (
  SELECT
    e.*,
    CASE WHEN e.success THEN 'success' WHEN e.end_reason IS NULL THEN 'broken off'
      WHEN e.success IS NULL THEN 'not judged' ELSE 'failure' END AS outcome,
    ${CLASS} AS class,
    c.sub_class, c.rule, c.step AS rule_step, c.last_step AS rule_last_step, c.evidence,
    coalesce(b.step, c.step) AS decisive_step,
    b.cause, b.explanation, b.advised_call, b.wasted_steps, b.point_of_no_return,
    coalesce(v.verdict, 'unverified') AS verdict, l.label, l.labelled_by,
    r.starred_by, r.tags, r.comments, CASE WHEN r.comments > 0 THEN 'some' END AS commented
  FROM episodes e
  LEFT JOIN classes c ON c.trace_digest = e.trace_digest
  LEFT JOIN blame b ON b.trace_digest = e.trace_digest
  LEFT JOIN (${VERDICTS}) v ON v.trace_digest = e.trace_digest
  LEFT JOIN (${PEOPLE}) l ON l.episode_id = e.episode_id
  LEFT JOIN (${REMARKED}) r ON r.episode_id = e.episode_id
  WHERE ${condition}
)`;
/** What was played. A branch is no trial of its policy: it stands below its parent, and counts nowhere. */
export const LISTED = listed("e.parent_trace IS NULL");
export const BRANCHES = listed("e.parent_trace IS NOT NULL");

/** What stands beside the list, in this order. */
export const FACETS = ["outcome", "policy", "family", "class", "sub_class", "run_id", "verdict", "end_reason", "label", "labelled_by",
  "starred_by", "tags", "commented"] as const;
export type Facet = (typeof FACETS)[number];
/** Facets of which an episode has several values, separated by `, `. */
const SEVERAL: readonly Facet[] = ["starred_by", "tags"];
/** Whoever it is that starred. */
const ANYONE = "anyone";
/** What links may choose besides. */
const OTHERS = ["task_id", "target_category", "dest", "picked", "placed_on"] as const;
/** The filter that leaves values of a facet out. */
export type Not = `not_${Facet}`;
export const not = (facet: Facet): Not => `not_${facet}`;
export type Filter = Facet | (typeof OTHERS)[number] | Not;
export const FILTERS: readonly Filter[] = [...FACETS, ...FACETS.map(not), ...OTHERS];
/** Values of filters. An episode is chosen if every filter has its value, or, for one that leaves out, none has. */
export type Choice = Partial<Record<Filter, string[]>>;

/** The facet whose values a filter chooses or leaves out, and which of both. */
export function facetOf(filter: Filter): { facet: Facet; leavesOut: boolean } | null {
  const leavesOut = filter.startsWith("not_");
  const facet = FACETS.find((facet) => facet === (leavesOut ? filter.slice("not_".length) : filter));
  return facet ? { facet, leavesOut } : null;
}

/** How a filter is called on a page. */
export function filterName(filter: Filter): string {
  const facet = facetOf(filter);
  if (facet?.leavesOut) return `not ${filterName(facet.facet)}`;
  const names: Partial<Record<Filter, string>> = {
    sub_class: "sub-class", run_id: "run", verdict: "replay", end_reason: "end", task_id: "task", target_category: "wanted", dest: "destination",
    placed_on: "placed on", labelled_by: "labelled by", starred_by: "starred by", tags: "tag", commented: "comments",
  };
  return names[filter] ?? filter;
}

/** The value of a filter as people read it; names that people gave stay as they are. */
export function filterValue(filter: Filter, value: string): string {
  const named = facetOf(filter)?.facet ?? filter;
  if (named === "starred_by" && value === starName(author.get())) return `${value} (you)`;
  return ["run_id", "policy", "task_id", "labelled_by", "starred_by", "tags"].includes(named) ? value : words(value);
}

/** The values of a filter in a sentence. */
export function filterValues(filter: Filter, values: string[]): string {
  return values.map((value) => filterValue(filter, value)).join(" or ");
}

/** What was chosen in the address. */
export function choiceOf(query: URLSearchParams): Choice {
  return Object.fromEntries(FILTERS.map((filter) => [filter, [...new Set(query.getAll(filter))].filter(Boolean)] as const).filter(([, values]) => values.length));
}

/** The value of a facet as text; what is not there is `none`, so that it can be chosen as well. */
export function facetValue(facet: Facet): string {
  return `coalesce(${facet}, 'none')`;
}

/** The values of a facet that an episode has, from the one text that the tables give. */
export function facetValues(facet: Facet, value: string): string[] {
  if (!SEVERAL.includes(facet) || value === "none") return [value];
  return [...(facet === "starred_by" ? [ANYONE] : []), ...value.split(", ")];
}

/** The condition that an episode has a value of a facet that may have several. */
function hasValue(facet: Facet, parameter: string): string {
  const value = facetValue(facet);
  const anyone = `CASE ${value} WHEN 'none' THEN 'none' ELSE concat('${ANYONE}, ', ${value}) END`;
  const all = facet === "starred_by" ? anyone : value;
  return `strpos(concat(', ', ${all}, ', '), concat(', ', $${parameter} || '', ', ')) > 0`;
}

/** Another object was picked than the goal's, or the goal's was placed elsewhere. */
const CONFUSED: Partial<Record<Filter, (values: string) => string>> = {
  picked: (values) => `episode_id IN (SELECT s.episode_id FROM steps s JOIN episodes x ON x.episode_id = s.episode_id
    JOIN objects o ON o.task_digest = x.task_digest AND o.instance = s.object
    WHERE s.tool = 'pick' AND s.error_code IS NULL AND NOT s.goal_object AND o.category IN (${values}))`,
  placed_on: (values) => `episode_id IN (SELECT episode_id FROM steps
    WHERE tool = 'place' AND error_code IS NULL AND goal_object AND NOT goal_receptacle AND receptacle IN (${values}))`,
};

/** The name of the parameter that is a value of a filter. */
const parameter = (filter: Filter, at: number) => `${filter}_${at}`;

/** The condition of one filter, on `listed`; its values are [`valuesOf`] the choice. */
export function condition(filter: Filter, values: string[]): string {
  const any = values.map((_, at) => `$${parameter(filter, at)}`).join(", ");
  const facet = facetOf(filter);
  if (facet && SEVERAL.includes(facet.facet)) {
    const holds = values.map((_, at) => hasValue(facet.facet, parameter(filter, at))).join(" OR ");
    return facet.leavesOut ? `NOT (${holds})` : `(${holds})`;
  }
  if (facet) return `${facetValue(facet.facet)} ${facet.leavesOut ? "NOT IN" : "IN"} (${any})`;
  return CONFUSED[filter]?.(any) ?? `${filter} IN (${any})`;
}

/** The filters of a choice with their values. */
export function chosenFilters(choice: Choice): [Filter, string[]][] {
  return Object.entries(choice) as [Filter, string[]][];
}

/** The values of a choice as parameters. */
export function valuesOf(choice: Choice): Record<string, string> {
  return Object.fromEntries(chosenFilters(choice).flatMap(([filter, values]) => values.map((value, at) => [parameter(filter, at), value])));
}

/** Conditions of a choice and of a clause that somebody wrote; a line break ends a comment in it. */
export function where(choice: Choice, clause = ""): string {
  const conditions = chosenFilters(choice).map(([filter, values]) => condition(filter, values));
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
