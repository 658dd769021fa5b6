/** What the service tells of live sessions. */

export type Entry = {
  session: string;
  state: "empty" | "playing" | "parked" | "over" | "broken";
  task_id: string | null;
  steps: number;
  episodes: number;
  policy: string;
  ended: { reason: string; success: boolean; total_reward: number } | null;
  trace: string | null;
  idle_s: number;
  group_id: string | null;
};

export type Question = { session: string; question: string; waiting_s: number };
