/** What the list of episodes asks: one question for the rows, one for all counts. */
import { sql } from "../../lib/api";
import { type Column, order, selected } from "../../lib/columns";
import { BRANCHES, type Choice, type Episode, FACETS, type Facet, LISTED, condition, facetValue, where } from "../../lib/episodes";

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

export interface List {
  choice: Choice;
  clause: string;
  columns: Column[];
  sort: string;
  descending: boolean;
  page: number;
}

export async function rows(list: List, signal: AbortSignal, size = SIZE): Promise<Episode[]> {
  const text = `${LISTED}
SELECT ${selected(list.columns)} FROM listed WHERE ${where(list.choice, list.clause)}
ORDER BY ${order(list.sort, list.descending)} LIMIT ${size} OFFSET ${(list.page - 1) * size}`;
  return withBranches(await sql<Episode>(text, { ...list.choice }, signal), list.columns, signal);
}

/** Every row with its branches below it, and theirs below them. */
async function withBranches(rows: Episode[], columns: Column[], signal: AbortSignal): Promise<Episode[]> {
  const below = new Map<string, Episode[]>();
  for (let parents = rows; parents.length;) {
    const digests = parents.map((row) => `'${row.trace_digest}'`).join(", ");
    const text = `${BRANCHES} SELECT ${selected(columns)} FROM listed WHERE parent_trace IN (${digests}) ORDER BY parent_call, trace`;
    parents = await sql<Episode>(text, {}, signal);
    for (const row of parents) below.set(row.parent_trace!, [...(below.get(row.parent_trace!) ?? []), row]);
  }
  const hung = (row: Episode, depth: number): Episode[] =>
    [{ ...row, depth }, ...(below.get(row.trace_digest) ?? []).flatMap((branch) => hung(branch, depth + 1))];
  return below.size ? rows.flatMap((row) => hung(row, 0)) : rows;
}

/** Counts of every facet, each under the choices of all others, in one pass over the table. */
export async function counts(choice: Choice, clause: string, signal: AbortSignal): Promise<Counts> {
  const own = Object.keys(choice).filter((filter): filter is Facet => FACETS.some((facet) => facet === filter));
  const others = Object.fromEntries(Object.entries(choice).filter(([filter]) => !own.some((facet) => facet === filter))) as Choice;
  const holds = (but?: Facet) => own.filter((facet) => facet !== but).map(condition).join(" AND ") || "true";
  const text = `${LISTED},
valued AS (
  SELECT ${FACETS.map((facet) => `${facetValue(facet)} AS f_${facet}`).join(", ")},
    ${holds()} AS holds, ${FACETS.map((facet) => `${holds(facet)} AS h_${facet}`).join(", ")}
  FROM listed WHERE ${where(others, clause)}
)
SELECT ${FACETS.map((facet) => `f_${facet}, grouping(f_${facet}) AS g_${facet}, count(*) FILTER (WHERE h_${facet}) AS n_${facet}`).join(", ")},
  count(*) FILTER (WHERE holds) AS total
FROM valued GROUP BY GROUPING SETS (${FACETS.map((facet) => `(f_${facet})`).join(", ")}, ())`;
  const got = await sql<Record<string, string | number | null>>(text, { ...choice }, signal);
  const found: Counts = { total: 0, counts: [] };
  for (const row of got) {
    const facet = FACETS.find((facet) => row[`g_${facet}`] === 0);
    if (facet) found.counts.push({ facet, value: String(row[`f_${facet}`]), episodes: Number(row[`n_${facet}`]) });
    else found.total = Number(row["total"]);
  }
  found.counts.sort((a, b) => +(a.value === "none") - +(b.value === "none") || b.episodes - a.episodes || a.value.localeCompare(b.value));
  return found;
}

/** Everything that was chosen, for a selection; at most so many. */
export function matching(choice: Choice, clause: string, most: number): Promise<{ episode_id: string; trace: string }[]> {
  const text = `${LISTED} SELECT episode_id, trace FROM listed WHERE ${where(choice, clause)} ORDER BY episode_id LIMIT ${most}`;
  return sql<{ episode_id: string; trace: string }>(text, { ...choice });
}
