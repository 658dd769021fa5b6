/** What the search box of all pages finds: pages, values of filters, episodes, and questions. */
import { sql, traceName } from "./api";
import { FILTERS, type Filter, LISTED, episodeLink, filterName } from "./episodes";
import { number } from "./format";
import { link } from "./route.svelte";

export interface Hit {
  kind: string;
  name: string;
  detail: string;
  address: string;
}

/** The filters whose values are found. */
const NAMED = ["task_id", "policy", "run_id", "family", "class", "sub_class"] as const satisfies Filter[];
/** Most values of one filter, and most episodes. */
const FEW = 4;

/** Values of filters with the number of their episodes, and episodes by name; `text` is not empty. */
export async function hits(text: string, signal: AbortSignal): Promise<Hit[]> {
  const has = (column: string) => `strpos(lower(${column}), lower($text)) > 0`;
  const parts = NAMED.map((filter) => `(SELECT '${filter}' AS kind, ${filter} AS value, count(*) AS episodes FROM listed
  WHERE ${has(filter)} GROUP BY ${filter} ORDER BY count(*) DESC, ${filter} LIMIT ${FEW})`);
  parts.push(`(SELECT 'episode' AS kind, trace AS value, CAST(NULL AS BIGINT) AS episodes FROM episodes
  WHERE ${has("episode_id")} OR ${has("regexp_replace(trace, '^.*[/]', '')")} ORDER BY length(trace), trace LIMIT ${FEW})`);
  const rows = await sql<{ kind: string; value: string; episodes: number | null }>(`${LISTED} ${parts.join(" UNION ALL ")}`, { text }, signal);
  const place = (kind: string) => (kind === "episode" ? FILTERS.length : FILTERS.indexOf(kind as Filter));
  rows.sort((a, b) => place(a.kind) - place(b.kind));
  return rows.map(({ kind, value, episodes }) =>
    kind === "episode"
      ? { kind, name: traceName(value), detail: "", address: episodeLink(value) }
      : {
          kind: filterName(kind as Filter), name: value, detail: `${number(episodes)} ${episodes === 1 ? "episode" : "episodes"}`,
          address: link("/episodes", { [kind]: value }),
        });
}
