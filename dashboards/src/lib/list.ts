/** A list of episodes as an address describes it: what is chosen, what is searched, in which order; and what stands beside an episode in it. */
import { type Row, sql } from "./api";
import { order } from "./columns";
import { type Choice, LISTED, choiceOf, chosenFilters, filterName, filterValues, valuesOf, where } from "./episodes";
import { link } from "./route.svelte";
import { CONTAINS_TEXT, foundIn } from "./search";

export interface Chosen {
  choice: Choice;
  /** A condition in SQL. */
  clause: string;
  /** What the instruction, a call, a reply, the reasoning, a tag or a comment says. */
  text?: string;
}

export interface List extends Chosen {
  sort: string;
  descending: boolean;
  /** The columns that are shown, as the address names them. */
  columns?: string | null;
}

const USUAL = "trace_modified_ns";

export function listOf(query: URLSearchParams): List {
  return {
    choice: choiceOf(query), clause: query.get("where") ?? "", text: query.get("search") ?? "", sort: query.get("sort") ?? USUAL,
    descending: query.get("order") !== "up", columns: query.get("columns"),
  };
}

/** The part of an address that describes a list. */
export function listAddress({ choice, clause, text, sort, descending, columns }: List): string {
  return link("", { ...choice, where: clause, search: text, sort, order: descending ? null : "up", columns }).slice(1);
}

/** What a list holds, in words. */
export function listWords({ choice, clause, text }: Chosen): string {
  const parts = chosenFilters(choice).map(([filter, values]) => `${filterName(filter)}: ${filterValues(filter, values)}`);
  if (text) parts.push(`“${text}”`);
  if (clause) parts.push(clause);
  return parts.join(", ") || "all episodes";
}

/** The conditions of a list on `listed`, and the parameters that they name. */
export function conditionOf({ choice, clause, text }: Chosen): string {
  return text ? `${where(choice, clause)} AND ${CONTAINS_TEXT}` : where(choice, clause);
}
export function parametersOf({ choice, text }: Chosen): Record<string, string> {
  return { ...valuesOf(choice), ...(text ? { search: text } : {}) };
}

export interface ListPosition {
  /** From 1. */
  at: number;
  total: number;
  before: Neighbour | null;
  next: Neighbour | null;
}

export interface Neighbour {
  trace: string;
  /** The step that its row leads to. */
  step: number | null;
}

/** Where an episode stands in a list; null if it does not. */
export async function positionIn(list: List, digest: string, signal: AbortSignal): Promise<ListPosition | null> {
  const beside = ["before", "next"] as const;
  const columns = beside.flatMap((side) =>
    ["trace", "episode_id", "decisive_step"].map((column) => `${side === "next" ? "lead" : "lag"}(${column}) OVER ordered AS ${side}_${column}`));
  const text = `${LISTED},
placed AS (
  SELECT trace_digest, row_number() OVER ordered AS at, count(*) OVER () AS total, ${columns.join(", ")}
  FROM listed WHERE ${conditionOf(list)}
  WINDOW ordered AS (ORDER BY ${order(list.sort, list.descending)})
)
SELECT * FROM placed WHERE trace_digest = $digest`;
  const [row] = await sql<Row>(text, { ...parametersOf(list), digest }, signal);
  if (!row) return null;
  const ids = beside.map((side) => row[`${side}_episode_id`]).filter((id) => id !== null).map(String);
  const found = list.text ? await foundIn(ids, list.text, signal) : null;
  const neighbour = (side: (typeof beside)[number]): Neighbour | null => {
    const [trace, id, step] = [row[`${side}_trace`], row[`${side}_episode_id`], row[`${side}_decisive_step`]];
    return trace === null ? null : { trace: String(trace), step: found?.get(String(id))?.step ?? (step === null ? null : Number(step)) };
  };
  return { at: Number(row["at"]), total: Number(row["total"]), before: neighbour("before"), next: neighbour("next") };
}
