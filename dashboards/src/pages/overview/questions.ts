/** What the overview asks the tables. Episodes whose trace breaks off count nowhere but in the totals, branches nowhere. */
import { VERDICTS } from "../../lib/episodes";

export interface Totals {
  episodes: number;
  /** Different tasks; those of one name differ in scene, objects or wording. */
  tasks: number;
  names: number;
  policies: number;
  runs: number;
  steps: number | null;
  /** Of which nobody told whether they succeeded. */
  not_judged: number;
}

export const TOTALS = `SELECT count(*) AS episodes, count(DISTINCT task_digest) AS tasks, count(DISTINCT task_id) AS names, count(DISTINCT policy) AS policies,
  count(DISTINCT run_id) AS runs, sum(length) AS steps,
  count(*) FILTER (WHERE success IS NULL AND end_reason IS NOT NULL) AS not_judged FROM episodes WHERE parent_trace IS NULL`;

/** A policy in a family, or in all (`family` is null and `whole` is 1). */
export interface Cell {
  policy: string;
  family: string | null;
  whole: number;
  episodes: number;
  won: number;
  done: number;
  spl: number | null;
  steps: number;
}

export const CELLS = `SELECT policy, family, grouping(family) AS whole, count(*) AS episodes, count(*) FILTER (WHERE success) AS won,
  avg(completion) AS done, avg(spl) AS spl, avg(length) AS steps
FROM episodes WHERE success IS NOT NULL AND parent_trace IS NULL
GROUP BY GROUPING SETS ((policy, family), (policy))`;

export interface Run {
  run: string;
  policy: string;
  /** When its last trace was written. */
  at_ms: number;
  episodes: number;
  won: number;
  done: number;
}

export const RUNS = `SELECT coalesce(run_id, 'none') AS run, policy, max(trace_modified_ns) / 1000000 AS at_ms, count(*) AS episodes,
  count(*) FILTER (WHERE success) AS won, avg(completion) AS done
FROM episodes WHERE success IS NOT NULL AND parent_trace IS NULL
GROUP BY run_id, policy ORDER BY at_ms DESC LIMIT 400`;

export interface Reason {
  class: string;
  sub_class: string | null;
  episodes: number;
}

export const REASONS = `SELECT coalesce(c.class, 'not classified') AS class, c.sub_class, count(*) AS episodes
FROM episodes e LEFT JOIN classes c ON c.trace_digest = e.trace_digest
WHERE NOT e.success AND e.parent_trace IS NULL GROUP BY c.class, c.sub_class ORDER BY episodes DESC, class, sub_class`;

export interface Sound {
  verdict: string;
  episodes: number;
}

export const HEALTH = `SELECT coalesce(v.verdict, 'unverified') AS verdict, count(*) AS episodes
FROM episodes e LEFT JOIN (${VERDICTS}) v ON v.trace_digest = e.trace_digest
WHERE e.parent_trace IS NULL GROUP BY v.verdict`;

export interface LeftOut {
  reason: string;
  files: number;
}

export const QUARANTINE = "SELECT reason, count(*) AS files FROM quarantine GROUP BY reason ORDER BY files DESC, reason";

export interface Statement {
  number: number;
  sentence: string;
  traces: string[];
}

export const SUMMARY = "SELECT number, sentence, traces FROM summary ORDER BY number";
