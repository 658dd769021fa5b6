/** A list of episodes as an address describes it: what is chosen, what is searched, in which order; and what stands beside an episode in it. */
import { sql } from "./api";
import { order } from "./columns";
import { type Choice, type Episode, LISTED, choiceOf, filterName, filterValue, where } from "./episodes";
import { link } from "./route.svelte";
import { SAID } from "./search";

export interface Chosen {
  choice: Choice;
  /** A condition in SQL. */
  clause: string;
  /** What the instruction, a call, a reply or the reasoning says. */
  text?: string;
}

export interface List extends Chosen {
  sort: string;
  descending: boolean;
}

const USUAL = "trace_modified_ns";

export function listOf(query: URLSearchParams): List {
  return {
    choice: choiceOf(query), clause: query.get("where") ?? "", text: query.get("search") ?? "", sort: query.get("sort") ?? USUAL,
    descending: query.get("order") !== "up",
  };
}

/** The part of an address that describes a list. */
export function listAddress({ choice, clause, text, sort, descending }: List): string {
  return link("", { ...choice, where: clause, search: text, sort, order: descending ? null : "up" }).slice(1);
}

/** What a list holds, in words. */
export function listWords({ choice, clause, text }: Chosen): string {
  const parts = (Object.entries(choice) as [keyof Choice, string][]).map(([filter, value]) => `${filterName(filter)}: ${filterValue(filter, value)}`);
  if (text) parts.push(`“${text}”`);
  if (clause) parts.push(clause);
  return parts.join(", ") || "all episodes";
}

/** The conditions of a list on `listed`, and the parameters that they name. */
export function conditionOf({ choice, clause, text }: Chosen): string {
  return text ? `${where(choice, clause)} AND ${SAID}` : where(choice, clause);
}
export function parametersOf({ choice, text }: Chosen): Record<string, string> {
  return { ...choice, ...(text ? { search: text } : {}) };
}

export interface Place {
  /** From 1. */
  at: number;
  total: number;
  before: string | null;
  before_step: number | null;
  next: string | null;
  next_step: number | null;
}

/** Where an episode stands in a list; null if it does not. */
export async function placeIn(list: List, digest: string, signal: AbortSignal): Promise<Place | null> {
  const text = `${LISTED},
placed AS (
  SELECT trace_digest, row_number() OVER ordered AS at, count(*) OVER () AS total,
    lag(trace) OVER ordered AS before, lag(decisive_step) OVER ordered AS before_step,
    lead(trace) OVER ordered AS next, lead(decisive_step) OVER ordered AS next_step
  FROM listed WHERE ${conditionOf(list)}
  WINDOW ordered AS (ORDER BY ${order(list.sort, list.descending)})
)
SELECT at, total, before, before_step, next, next_step FROM placed WHERE trace_digest = $digest`;
  const [place] = await sql<Place & Episode>(text, { ...parametersOf(list), digest }, signal);
  return place ?? null;
}
