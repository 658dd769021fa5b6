/** Claims: a sentence bound to a condition or a pattern of calls. What episodes say of it, and how surely, the service answers. */
import { ApiError, get, post } from "./api";
import { percent } from "./format";
import type { Claim, ClaimExample, ClaimReport, RunTally } from "./generated";
import { link } from "./route.svelte";

export type { Claim, ClaimExample, ClaimReport, RunTally };
/** How many of the counted episodes bear a claim out, with the 95% interval of their share: of all, or of one run. */
export type Tally = Pick<RunTally, "verdict" | "episodes" | "tasks" | "holding" | "share" | "low" | "high">;

/** What a kept claim comes to now. */
export const evaluateKept = (name: string, signal?: AbortSignal) => get(`/api/claims/${encodeURIComponent(name)}`, signal);
export const evaluate = (claim: Claim, signal?: AbortSignal) => post("/api/claims", claim, signal);

/** Whether the service refused the claim itself, as for a condition that is no SQL. */
export const refused = (error: unknown): error is ApiError => error instanceof ApiError && error.status === 422;

/** `41 to 70%`, or with points `44 to 70`. */
export function range(low: number, high: number, unit = "%"): string {
  return `${(100 * low).toFixed(0)} to ${(100 * high).toFixed(0)}${unit}`;
}

/** What a claim promises: `at least 50%`; empty if nothing. */
export function promise({ at_least, at_most }: Claim): string {
  const part = (share: number) => `${Number((100 * share).toFixed(2))}%`;
  const [least, most] = [at_least ?? null, at_most ?? null];
  if (least !== null && most !== null) return `${part(least)} to ${part(most)}`;
  if (least !== null) return `at least ${part(least)}`;
  return most === null ? "" : `at most ${part(most)}`;
}

/** The counts in words, as in `23 of 41 (56%, 95% interval 41 to 70%)`; without a share only the numbers. */
export function counted({ holding, episodes, share, low, high }: Tally): string {
  if (share === null || low === null || high === null) return `${holding} of ${episodes}`;
  return `${holding} of ${episodes} (${percent(share)}, 95% interval ${range(low, high)})`;
}

/** The condition of a claim on an episode, in SQL. A line break ends a comment in what somebody wrote. */
function condition({ holds, pattern }: Claim): string {
  return holds ? `(${holds}\n)` : `sequence_match(steps, '${(pattern ?? "").replaceAll("'", "''")}')`;
}

/** The list of the counted episodes that are as the claim says, or that are not. */
export function listLink(claim: Claim, holding: boolean): string {
  const parts = ["end_reason <> 'aborted'", claim.of ? `(${claim.of}\n)` : "", holding ? condition(claim) : `NOT coalesce(${condition(claim)}, false)`];
  return link("/episodes", { where: parts.filter(Boolean).join(" AND ") });
}
