/** What the page of failures asks the tables. */
import { sql } from "../../lib/api";
import { type Choice, LISTED, valuesOf, where } from "../../lib/episodes";

export interface Flow {
  family: string;
  class: string;
  sub_class: string;
  episodes: number;
}

export function flows(choice: Choice, signal: AbortSignal): Promise<Flow[]> {
  const text = `${LISTED}
SELECT coalesce(family, 'none') AS family, class, coalesce(sub_class, 'none') AS sub_class, count(*) AS episodes
FROM listed WHERE outcome = 'failure' AND ${where(choice)}
GROUP BY family, class, sub_class ORDER BY episodes DESC, class, sub_class`;
  return sql<Flow>(text, valuesOf(choice), signal);
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

/** Objects that were picked instead of the goal's, as the named query `object_confusions` counts them, within a choice. */
export function objectConfusions(choice: Choice, look: boolean, signal: AbortSignal): Promise<Confusion[]> {
  const [wanted, taken] = look ? ["l.target_caption", "o.caption"] : ["l.target_category", "o.category"];
  const text = `${LISTED}
SELECT coalesce(${wanted}, 'not told') AS wanted, coalesce(${taken}, 'not told') AS taken, bool_or(o.category = l.target_category) AS alike,
  count(DISTINCT l.episode_id) AS episodes, min(l.trace) AS example
FROM steps s
JOIN (SELECT * FROM listed WHERE ${where(choice)}) l ON l.episode_id = s.episode_id
LEFT JOIN objects o ON o.task_digest = l.task_digest AND o.instance = s.object
WHERE s.tool = 'pick' AND s.error_code IS NULL AND NOT s.goal_object
GROUP BY 1, 2 ORDER BY episodes DESC, 1, 2 LIMIT 400`;
  return sql<Confusion>(text, valuesOf(choice), signal);
}

/** Furniture that the goal's object was placed on instead of the destination, as the named query `receptacle_confusions` counts it. */
export function receptacleConfusions(choice: Choice, signal: AbortSignal): Promise<Confusion[]> {
  const text = `${LISTED}
SELECT l.dest AS wanted, s.receptacle AS taken, bool_or(array_has(t.dest_distractors, s.receptacle)) AS alike,
  count(DISTINCT l.episode_id) AS episodes, min(l.trace) AS example
FROM steps s
JOIN (SELECT * FROM listed WHERE ${where(choice)}) l ON l.episode_id = s.episode_id
JOIN tasks t ON t.task_digest = l.task_digest
WHERE s.tool = 'place' AND s.error_code IS NULL AND s.goal_object AND NOT s.goal_receptacle
GROUP BY 1, 2 ORDER BY episodes DESC, 1, 2 LIMIT 400`;
  return sql<Confusion>(text, valuesOf(choice), signal);
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
  own_class: string | null;
  own_sub_class: string | null;
  own_step: number | null;
}

/** What a person says of an episode. */
export interface Answer {
  class: string;
  sub_class: string | null;
  step: number | null;
}

export const QUEUE = 500;

/** Episodes of a choice, with what this author said of them. */
export function queue(choice: Choice, author: string, signal: AbortSignal): Promise<Failed[]> {
  const text = `${LISTED}
SELECT l.episode_id, l.trace, l.task_id, l.policy, l.instruction, l.length, l.class, l.sub_class, l.rule, l.rule_step, l.rule_last_step,
  l.decisive_step, l.explanation, own.class AS own_class, own.sub_class AS own_sub_class, own.step AS own_step
FROM (SELECT * FROM listed WHERE ${where(choice)}) l
LEFT JOIN (SELECT * FROM labels WHERE author = $author AND kind = 'human') own ON own.episode_id = l.episode_id
ORDER BY l.task_id, l.episode_id LIMIT ${QUEUE}`;
  return sql<Failed>(text, { ...valuesOf(choice), author }, signal);
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

/** How often an author gave a class, and what the rules gave there: null where they gave none, as for a success. */
export interface Pair {
  author: string;
  kind: string;
  /** Whether these labels were given before the rule's answer was seen; null where nobody recorded that. */
  blind: boolean | null;
  labelled: string;
  found: string | null;
  episodes: number;
  same: number;
}

export const PAIRS = `SELECT l.author, l.kind, l.blind, l.class AS labelled, c.class AS found,
  count(*) AS episodes, count(*) FILTER (WHERE l.sub_class = c.sub_class) AS same
FROM labels l
JOIN episodes e ON e.episode_id = l.episode_id
LEFT JOIN classes c ON c.trace_digest = e.trace_digest
GROUP BY l.author, l.kind, l.blind, l.class, c.class ORDER BY l.author, l.kind, l.blind DESC NULLS LAST`;
