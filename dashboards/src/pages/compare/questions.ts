/** What a comparison asks: which things can be compared, and their pairs on the same tasks. */
import { sql, traceName } from "../../lib/api";
import { link } from "../../lib/route.svelte";

/** What played the same tasks, or, for `preset`, what scored the same episodes. */
export type Kind = "policy" | "run" | "checkpoint" | "preset";
/** A kind whose pairs are episodes of one task. */
export type Player = Exclude<Kind, "preset">;

export const KINDS: Record<Kind, { title: string; plural: string }> = {
  policy: { title: "Policies", plural: "policies" },
  run: { title: "Runs", plural: "runs" },
  checkpoint: { title: "Checkpoints", plural: "checkpoints" },
  preset: { title: "Reward presets", plural: "reward presets" },
};

/** The column of `episodes` that tells who played. */
const COLUMN: Record<Player, string> = { policy: "policy", run: "run_id", checkpoint: "checkpoint" };
/** A condition on `episodes e`. Branches are no trials, and broken recordings have no outcome. */
const played = (kind: Player) => `e.success IS NOT NULL AND e.parent_trace IS NULL AND e.${COLUMN[kind]} IS NOT NULL`;

export interface Thing {
  name: string;
  episodes: number;
}

export function things(kind: Kind, signal: AbortSignal): Promise<Thing[]> {
  const text =
    kind !== "preset"
      ? `SELECT e.${COLUMN[kind]} AS name, count(*) AS episodes FROM episodes e WHERE ${played(kind)} GROUP BY 1 ORDER BY 1`
      : `SELECT preset AS name, count(DISTINCT episode_id) AS episodes
FROM (SELECT preset, episode_id FROM episodes UNION ALL SELECT preset, episode_id FROM rescored) GROUP BY preset ORDER BY preset`;
  return sql<Thing>(text, {}, signal);
}

/** How many tasks two of a kind share. */
export interface Shared {
  a: string;
  b: string;
  tasks: number;
}

/** Most that are paired with each other to find those that share the most tasks. */
const NEWEST = 20;

/** Every two of the newest, those that share the most tasks first. */
export function shared(kind: Player, signal: AbortSignal): Promise<Shared[]> {
  const text = `WITH newest AS (
  SELECT e.${COLUMN[kind]} AS name FROM episodes e WHERE ${played(kind)} GROUP BY 1 ORDER BY max(e.trace_modified_ns) DESC LIMIT ${NEWEST}
),
played AS (
  SELECT DISTINCT n.name, e.task_digest FROM episodes e JOIN newest n ON n.name = e.${COLUMN[kind]} WHERE ${played(kind)}
)
SELECT a.name AS a, b.name AS b, count(*) AS tasks FROM played a JOIN played b ON b.task_digest = a.task_digest AND b.name > a.name
GROUP BY a.name, b.name ORDER BY tasks DESC, a, b`;
  return sql<Shared>(text, {}, signal);
}

/** One task played by both, or one episode under two presets. Means, where a task was played several times. */
export interface Pair {
  key: string;
  task_id: string;
  family: string | null;
  success_a: number;
  success_b: number;
  return_a: number | null;
  return_b: number | null;
  steps_a: number;
  steps_b: number;
  episodes_a: number;
  episodes_b: number;
  trace_a: string;
  trace_b: string;
  step_a: number | null;
  step_b: number | null;
}

/** Most pairs that a page takes. */
export const MOST = 5000;

/** Equal by their digest, or, where the tasks were changed on purpose, by name. */
export function taskPairs(kind: Player, a: string, b: string, byName: boolean, signal: AbortSignal): Promise<Pair[]> {
  const key = byName ? "task_id" : "task_digest";
  // The episode to look at: one that ended as most did, so that a flip shows a success beside a failure.
  const text = `WITH played AS (
  SELECT e.${COLUMN[kind]} AS player, e.${key} AS key, e.task_id, e.family, CAST(e.success AS DOUBLE) AS success, e.total_reward, e.length, e.trace,
    coalesce(bl.step, c.step) AS step
  FROM episodes e
  LEFT JOIN blame bl ON bl.episode_id = e.episode_id AND bl.trace_digest = e.trace_digest
  LEFT JOIN classes c ON c.trace_digest = e.trace_digest
  WHERE ${played(kind)} AND e.${COLUMN[kind]} IN ($a, $b)
),
solved AS (
  SELECT player, key, min(task_id) AS task_id, min(family) AS family, avg(success) AS success, avg(total_reward) AS reward, avg(length) AS steps,
    count(*) AS episodes,
    CASE WHEN avg(success) > 0.5 THEN min(trace) FILTER (WHERE success = 1) ELSE min(trace) FILTER (WHERE success = 0) END AS trace
  FROM played GROUP BY player, key
),
told AS (SELECT s.*, p.step FROM solved s LEFT JOIN played p ON p.trace = s.trace)
SELECT a.key, a.task_id, a.family, a.success AS success_a, b.success AS success_b, a.reward AS return_a, b.reward AS return_b,
  a.steps AS steps_a, b.steps AS steps_b, a.episodes AS episodes_a, b.episodes AS episodes_b,
  a.trace AS trace_a, b.trace AS trace_b, a.step AS step_a, b.step AS step_b
FROM told a JOIN told b ON b.key = a.key AND a.player = $a AND b.player = $b
ORDER BY a.task_id, a.key LIMIT ${MOST}`;
  return sql<Pair>(text, { a, b }, signal);
}

export function presetPairs(a: string, b: string, signal: AbortSignal): Promise<Pair[]> {
  const text = `WITH scored AS (
  SELECT episode_id, preset, total_reward FROM episodes UNION ALL SELECT episode_id, preset, total_reward FROM rescored
),
once AS (SELECT episode_id, preset, avg(total_reward) AS reward FROM scored GROUP BY episode_id, preset)
SELECT e.episode_id AS key, e.task_id, e.family, CAST(e.success AS DOUBLE) AS success_a, CAST(e.success AS DOUBLE) AS success_b,
  a.reward AS return_a, b.reward AS return_b, e.length AS steps_a, e.length AS steps_b, 1 AS episodes_a, 1 AS episodes_b,
  e.trace AS trace_a, e.trace AS trace_b, CAST(NULL AS INT) AS step_a, CAST(NULL AS INT) AS step_b
FROM episodes e
JOIN once a ON a.episode_id = e.episode_id AND a.preset = $a
JOIN once b ON b.episode_id = e.episode_id AND b.preset = $b
WHERE e.success IS NOT NULL AND e.parent_trace IS NULL
ORDER BY e.task_id, key LIMIT ${MOST}`;
  return sql<Pair>(text, { a, b }, signal);
}

/** What became of a pair. */
export type Side = "only_a" | "only_b" | "both" | "neither";

export function side(pair: Pair): Side {
  const [a, b] = [pair.success_a > 0.5, pair.success_b > 0.5];
  return a ? (b ? "both" : "only_a") : b ? "only_b" : "neither";
}

/** Both episodes side by side, A left and B right, at the decisive step of A where A failed, else at that of B. */
export function besideLink(pair: Pair): string {
  const step = pair.success_a <= 0.5 ? pair.step_a : null;
  const beside_step = step === null && pair.success_b <= 0.5 ? pair.step_b : null;
  return link(`/episodes/${encodeURIComponent(traceName(pair.trace_a))}`, { beside: traceName(pair.trace_b), step, beside_step });
}
