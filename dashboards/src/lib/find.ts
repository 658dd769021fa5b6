/** What the search box of all pages finds: pages, values of filters, episodes, and questions. */
import { sql, traceName } from "./api";
import { CLASS, FILTERS, type Filter, episodeLink, filterName, filterValue } from "./episodes";
import { number } from "./format";
import { link } from "./route.svelte";
import { contains, excerpt } from "./search";

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

/** Tags that contain it, with the number of their episodes. */
const TAGS = `
UNION ALL
(SELECT 'tags', text, count(DISTINCT episode_id) AS n FROM remarks
WHERE kind = 'tag' AND ${contains("text", "text")} GROUP BY text ORDER BY n DESC, text LIMIT ${FEW})`;

/** The newest comments that say it, each with the place that it is about. */
async function comments(text: string, signal: AbortSignal): Promise<Hit[]> {
  const question = `SELECT e.trace, r.step, r.author, r.text FROM remarks r JOIN episodes e ON e.episode_id = r.episode_id
WHERE r.kind = 'comment' AND ${contains("r.text", "text")} ORDER BY r.at_ms DESC LIMIT ${FEW}`;
  type Said = { trace: string; step: number | null; author: string; text: string };
  const rows = await sql<Said>(question, { text }, signal);
  return rows.map(({ trace, step, author, text: said }) => {
    const { before, match, after } = excerpt(said, text) ?? { before: "", match: said, after: "" };
    const address = link(episodeLink(trace), { step, comments: 1 });
    return { kind: "comment", name: before + match + after, detail: author, address };
  });
}

/** Values of filters with the number of their episodes, episodes by name, and comments; `text` is not empty. */
export async function hits(text: string, signal: AbortSignal): Promise<Hit[]> {
  return (await Promise.all([values(text, signal), comments(text, signal)])).flat();
}

async function values(text: string, signal: AbortSignal): Promise<Hit[]> {
  const kinds = NAMED.map((filter) => `WHEN grouping(${filter}) = 0 THEN '${filter}'`);
  const question = `WITH named AS (
  SELECT e.task_id, e.policy, e.run_id, e.family, ${CLASS} AS class, c.sub_class
  FROM episodes e LEFT JOIN classes c ON c.trace_digest = e.trace_digest WHERE e.parent_trace IS NULL
),
counted AS (
  SELECT CASE ${kinds.join(" ")} END AS kind, coalesce(${NAMED.join(", ")}) AS value, count(*) AS episodes
  FROM named GROUP BY GROUPING SETS (${NAMED.map((filter) => `(${filter})`).join(", ")})
)
(SELECT kind, value, episodes FROM counted WHERE ${contains("value", "text")}
QUALIFY row_number() OVER (PARTITION BY kind ORDER BY episodes DESC, value) <= ${FEW} ORDER BY episodes DESC, value)
UNION ALL
(SELECT 'episode', trace, CAST(NULL AS BIGINT) FROM episodes
WHERE ${contains("episode_id", "text")} OR ${contains("regexp_replace(trace, '^.*[/]|[.]mcap$', '', 'g')", "text")}
ORDER BY length(trace), trace LIMIT ${FEW})${TAGS}`;
  const rows = await sql<{ kind: string; value: string; episodes: number | null }>(question, { text }, signal);
  const place = (kind: string) => (kind === "episode" ? FILTERS.length : FILTERS.indexOf(kind as Filter));
  rows.sort((a, b) => place(a.kind) - place(b.kind) || (b.episodes ?? 0) - (a.episodes ?? 0));
  return rows.map(({ kind, value, episodes }) =>
    kind === "episode"
      ? { kind, name: traceName(value), detail: "", address: episodeLink(value) }
      : {
          kind: filterName(kind as Filter), name: filterValue(kind as Filter, value), detail: `${number(episodes)} ${episodes === 1 ? "episode" : "episodes"}`,
          address: link("/episodes", { [kind]: value }),
        });
}
