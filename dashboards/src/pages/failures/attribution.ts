/** What each capability cost: estimates of the service, and the episodes behind them. */
import { get, sql } from "../../lib/api";
import { type Choice, LISTED, valuesOf, where } from "../../lib/episodes";
import type { Estimate } from "../../lib/generated";

export type { Estimate };
/** The group of all policies. */
export const ALL = "all episodes";

/** What a perfect capability would be, as the beginning of a sentence. */
const HAD: Record<string, string> = {
  perception: "Had it always told apart what it saw",
  communication: "Had it always asked where several things fit",
  memory: "Had it remembered what it saw and did",
  primitives: "Had every skill of the robot worked",
};
export const had = (capability: string) => HAD[capability] ?? `Had its ${capability} been perfect`;

/** Success of groups of episodes as it was, and with each capability perfect. */
export async function estimates(signal: AbortSignal): Promise<Estimate[]> {
  return (await get("/api/attribution", signal)).estimates;
}

/** Failed episodes that can be attributed: what an aborted one would have become is unknown. */
const failures = (choice: Choice) => `SELECT * FROM listed WHERE outcome = 'failure' AND end_reason <> 'aborted' AND ${where(choice)}`;

/** A failed episode that succeeds with one capability perfect. */
export interface Rescued {
  capability: string;
  trace: string;
  episode_id: string;
  task_id: string | null;
  policy: string;
  /** The first call that differs. */
  step: number | null;
  /** The trace of the branch that succeeded; null where none was kept. */
  branch: string | null;
}

export function rescued(choice: Choice, signal: AbortSignal): Promise<Rescued[]> {
  const text = `${LISTED}
SELECT a.capability, l.trace, l.episode_id, l.task_id, l.policy, coalesce(b.parent_call, a.first_step) AS step, a.branch
FROM attribution a
JOIN (${failures(choice)}) l ON l.trace_digest = a.trace_digest
LEFT JOIN episodes b ON b.parent_trace = a.trace_digest AND regexp_replace(b.trace, '^.*/', '') = regexp_replace(a.branch, '^.*/', '')
WHERE a.success ORDER BY l.task_id, l.trace`;
  return sql<Rescued>(text, valuesOf(choice), signal);
}

/** How many episodes failed, and how many of them nobody has attributed yet. */
export async function failed(choice: Choice, signal: AbortSignal): Promise<{ all: number; missing: number }> {
  const text = `${LISTED}
SELECT count(*) AS "all", count(*) FILTER (WHERE a.trace_digest IS NULL) AS missing
FROM (${failures(choice)}) l LEFT JOIN (SELECT DISTINCT trace_digest FROM attribution) a ON a.trace_digest = l.trace_digest`;
  const [row] = await sql<{ all: number; missing: number }>(text, valuesOf(choice), signal);
  return row!;
}
