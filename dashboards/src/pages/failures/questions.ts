/** What the page of failures asks the tables. An empty policy means all. */
import { sql } from "../../lib/api";
import { LISTED } from "../../lib/episodes";

export interface Flow {
  family: string;
  class: string;
  sub_class: string;
  episodes: number;
}

export function flows(policy: string, signal: AbortSignal): Promise<Flow[]> {
  const text = `${LISTED}
SELECT coalesce(family, 'none') AS family, class, coalesce(sub_class, 'none') AS sub_class, count(*) AS episodes
FROM listed WHERE outcome = 'failure' AND ($policy = '' OR policy = $policy)
GROUP BY family, class, sub_class ORDER BY episodes DESC, class, sub_class`;
  return sql<Flow>(text, { policy }, signal);
}

export function policies(signal: AbortSignal): Promise<{ policy: string; failed: number }[]> {
  return sql("SELECT policy, count(*) AS failed FROM episodes WHERE NOT success GROUP BY policy ORDER BY failed DESC, policy", {}, signal);
}

/** Something that was taken for something else, so often. */
export interface Confusion {
  wanted: string;
  taken: string;
  alike: boolean | null;
  episodes: number;
  example: string;
}

const OF_POLICY = "($policy = '' OR policy = $policy)";

export function objectConfusions(policy: string, look: boolean, signal: AbortSignal): Promise<Confusion[]> {
  const [wanted, taken] = look ? ["wanted_caption", "picked_caption"] : ["wanted", "picked"];
  const text = `SELECT coalesce(${wanted}, 'not told') AS wanted, coalesce(${taken}, 'not told') AS taken, bool_or(alike) AS alike,
  sum(episodes) AS episodes, min(example) AS example
FROM object_confusions WHERE ${OF_POLICY} GROUP BY 1, 2 ORDER BY episodes DESC, 1, 2 LIMIT 400`;
  return sql<Confusion>(text, { policy }, signal);
}

export function receptacleConfusions(policy: string, signal: AbortSignal): Promise<Confusion[]> {
  const text = `SELECT wanted, placed_on AS taken, bool_or(alike) AS alike, sum(episodes) AS episodes, min(example) AS example
FROM receptacle_confusions WHERE ${OF_POLICY} GROUP BY wanted, placed_on ORDER BY episodes DESC, 1, 2 LIMIT 400`;
  return sql<Confusion>(text, { policy }, signal);
}

/** A failed episode to be labelled. */
export interface Failed {
  episode_id: string;
  trace: string;
  task_id: string | null;
  policy: string;
  instruction: string | null;
  length: number | null;
  class: string;
  sub_class: string | null;
  rule: string | null;
  rule_step: number | null;
  rule_last_step: number | null;
  decisive_step: number | null;
  explanation: string | null;
  own_sub_class: string | null;
  own_class: string | null;
}

export const QUEUE = 500;

/** Failed episodes under a condition, with what this author said of them. */
export function queue(condition: string, parameters: Record<string, string>, author: string, signal: AbortSignal): Promise<Failed[]> {
  const text = `${LISTED}
SELECT l.episode_id, l.trace, l.task_id, l.policy, l.instruction, l.length, l.class, l.sub_class, l.rule, l.rule_step, l.rule_last_step,
  l.decisive_step, l.explanation, own.class AS own_class, own.sub_class AS own_sub_class
FROM (SELECT * FROM listed WHERE ${condition}) l
LEFT JOIN (SELECT episode_id, max(class) AS class, max(sub_class) AS sub_class FROM labels WHERE author = $author GROUP BY episode_id) own
  ON own.episode_id = l.episode_id
ORDER BY l.task_id, l.episode_id LIMIT ${QUEUE}`;
  return sql<Failed>(text, { ...parameters, author }, signal);
}

export interface Call {
  step: number;
  tool: string;
  argument: string | null;
  text: string;
  error_code: string | null;
}

export function calls(episode: string, signal: AbortSignal): Promise<Call[]> {
  return sql<Call>("SELECT step, tool, argument, text, error_code FROM steps WHERE episode_id = $episode ORDER BY step", { episode }, signal);
}

/** How often an author gave a class where the rules gave another or the same. */
export interface Pair {
  author: string;
  kind: string;
  labelled: string;
  found: string;
  episodes: number;
  same: number;
}

export const PAIRS = `SELECT l.author, l.kind, coalesce(l.class, 'none') AS labelled, coalesce(c.class, 'not classified') AS found,
  count(*) AS episodes, count(*) FILTER (WHERE l.sub_class = c.sub_class) AS same
FROM labels l
JOIN episodes e ON e.episode_id = l.episode_id
LEFT JOIN classes c ON c.trace_digest = e.trace_digest
GROUP BY l.author, l.kind, l.class, c.class ORDER BY l.author, l.kind`;
