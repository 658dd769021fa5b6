/** Long work of the service. */
import { post } from "./api";

export interface Job {
  id: number;
  work: { kind: string };
  stage: "waiting" | "running" | "done" | "failed" | "cancelled";
  done: number;
  total: number | null;
  message: string;
  report: unknown[];
  complaints: string[];
  created: number;
}

export type Work =
  | { kind: "replay"; traces: string[] }
  | { kind: "ingest"; traces?: string[] }
  | { kind: "blame" }
  | { kind: "taxonomy" }
  | { kind: "reward"; preset: string }
  | { kind: "export"; set: "sft" | "rl" | "preferences"; name: string; options: Record<string, unknown> };

export function start(work: Work): Promise<Job> {
  return post<Job>("/api/jobs", work);
}
