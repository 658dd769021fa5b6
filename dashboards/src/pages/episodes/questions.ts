/** What the list of episodes asks: one question for the rows, one for all counts. */
import { sql } from "../../lib/api";
import { type Column, order, selected } from "../../lib/columns";
import { type CopyFormat, curlSql, markdownText, pythonSql } from "../../lib/copy";
import { BRANCHES, type Choice, type Episode, FACETS, type Facet, LISTED, chosenFilters, condition, facetOf, facetValue, facetValues } from "../../lib/episodes";
import { type Chosen, type List, conditionOf, listWords, parametersOf } from "../../lib/list";
import { excerpt, foundIn } from "../../lib/search";

export const SIZE = 50;

export interface Count {
  facet: Facet;
  value: string;
  episodes: number;
}

export interface Counts {
  total: number;
  counts: Count[];
}

export interface Part extends Omit<List, "columns"> {
  columns: Column[];
  /** From 1. */
  page: number;
}

/** The rows of a page of the list, with where the text stands that was searched, and with their branches. */
export async function rows(list: Part, signal: AbortSignal, size = SIZE): Promise<Episode[]> {
  const text = `${LISTED}
SELECT ${selected(list.columns, list.text ? ["instruction"] : [])} FROM listed WHERE ${conditionOf(list)}
ORDER BY ${order(list.sort, list.descending)} LIMIT ${size} OFFSET ${(list.page - 1) * size}`;
  const found = await sql<Episode>(text, parametersOf(list), signal);
  return withBranches(list.text ? await withPlaces(found, list.text, signal) : found, list.columns, signal);
}

/** What can be copied of a list: its link, and the question behind it. */
export function listFormats(list: List, columns: Column[]): CopyFormat[] {
  const question = () => `${LISTED}
SELECT ${selected(columns)} FROM listed WHERE ${conditionOf(list)}
ORDER BY ${order(list.sort, list.descending)}`;
  return [
    { name: "Link", text: () => location.href },
    { name: "curl", text: () => curlSql(question(), parametersOf(list)) },
    { name: "Python", text: () => pythonSql(question(), parametersOf(list)) },
    { name: "Markdown", text: () => `[${markdownText(listWords(list))}](${location.href})` },
  ];
}

/** Every row with the first step that says the text that was searched; where none does, it is the instruction. */
async function withPlaces(rows: Episode[], text: string, signal: AbortSignal): Promise<Episode[]> {
  const found = await foundIn(rows.map((row) => row.episode_id), text, signal);
  return rows.map((row) => {
    const instruction = excerpt(String(row["instruction"] ?? ""), text);
    return { ...row, found: found.get(row.episode_id) ?? (instruction ? { step: null, part: "instruction", ...instruction } : undefined) };
  });
}

/** Every row with its branches below it, and theirs below them. */
async function withBranches(rows: Episode[], columns: Column[], signal: AbortSignal): Promise<Episode[]> {
  const below = new Map<string, Episode[]>();
  for (let parents = rows; parents.length;) {
    const digests = parents.map((row) => `'${row.trace_digest}'`).join(", ");
    // Few have branches, and a look at one column is enough to know that none has.
    if (!(await sql(`SELECT DISTINCT parent_trace FROM episodes WHERE parent_trace IN (${digests})`, {}, signal)).length) break;
    const text = `${BRANCHES} SELECT ${selected(columns)} FROM listed WHERE parent_trace IN (${digests}) ORDER BY parent_call, trace`;
    parents = await sql<Episode>(text, {}, signal);
    for (const row of parents) below.set(row.parent_trace!, [...(below.get(row.parent_trace!) ?? []), row]);
  }
  const hung = (row: Episode, depth: number): Episode[] =>
    [{ ...row, depth }, ...(below.get(row.trace_digest) ?? []).flatMap((branch) => hung(branch, depth + 1))];
  return below.size ? rows.flatMap((row) => hung(row, 0)) : rows;
}

/** Counts of every facet, each under the choices of all others, in one pass over the table. */
export async function counts(chosen: Chosen, signal: AbortSignal): Promise<Counts> {
  const { choice } = chosen;
  const own = chosenFilters(choice).flatMap(([filter, values]) => {
    const facet = facetOf(filter)?.facet;
    return facet ? [{ facet, holds: condition(filter, values) }] : [];
  });
  const others = Object.fromEntries(chosenFilters(choice).filter(([filter]) => !facetOf(filter))) as Choice;
  const holds = (but?: Facet) => own.filter(({ facet }) => facet !== but).map(({ holds }) => holds).join(" AND ") || "true";
  // Episodes that agree in all facets are counted first: a few hundred rows are left for a pass by each facet.
  const text = `${LISTED},
alike AS (
  SELECT ${FACETS.map((facet) => `${facetValue(facet)} AS ${facet}`).join(", ")}, count(*) AS episodes
  FROM listed WHERE ${conditionOf({ ...chosen, choice: others })} GROUP BY ${FACETS.map((_, at) => at + 1).join(", ")}
)
SELECT ${FACETS.join(", ")}, sum(episodes) FILTER (WHERE ${holds()}) AS chosen
  ${[...new Set(own.map(({ facet }) => facet))].map((facet) => `, sum(episodes) FILTER (WHERE ${holds(facet)}) AS but_${facet}`).join("")}
FROM alike GROUP BY GROUPING SETS (${FACETS.map((facet) => `(${facet})`).join(", ")}, ())`;
  const got = await sql<Record<string, string | number | null>>(text, parametersOf(chosen), signal);
  const found: Counts = { total: 0, counts: [] };
  // Several values of an episode come as one text; each counts for itself.
  const sums = new Map<string, Count>();
  for (const row of got) {
    // A row of a facet has its value alone; the row of all has none.
    const facet = FACETS.find((facet) => row[facet] !== null);
    if (!facet) {
      found.total = Number(row["chosen"]);
      continue;
    }
    for (const value of facetValues(facet, String(row[facet]))) {
      const count = sums.get(`${facet} ${value}`) ?? { facet, value, episodes: 0 };
      count.episodes += Number(row[`but_${facet}`] ?? row["chosen"]);
      sums.set(`${facet} ${value}`, count);
    }
  }
  found.counts = [...sums.values()];
  found.counts.sort((a, b) => +(a.value === "none") - +(b.value === "none") || b.episodes - a.episodes || a.value.localeCompare(b.value));
  return found;
}

/** Everything that was chosen, for a selection; at most so many. */
export function matching(chosen: Chosen, most: number): Promise<{ episode_id: string; trace: string }[]> {
  const text = `${LISTED} SELECT episode_id, trace FROM listed WHERE ${conditionOf(chosen)} ORDER BY episode_id LIMIT ${most}`;
  return sql<{ episode_id: string; trace: string }>(text, parametersOf(chosen));
}
