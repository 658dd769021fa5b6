/** Live sessions, the questions that they ask people, and what the service tells of a session's course. */
import { get } from "../../lib/api";
import type { Decision, Session as Entry, Step } from "../../lib/generated";
import { shortName } from "../../lib/trace";

export type { Decision, Question, Session as Entry } from "../../lib/generated";

export interface Course {
  decisions: Decision[];
  /** The objects in the image. */
  inView: string[];
}

/** What the service tells of a session: of its episode while it is at play, and of the trace after the end. */
export async function course(entry: Entry, signal: AbortSignal): Promise<Course> {
  if (["playing", "suspended"].includes(entry.state)) {
    const { decisions, in_view } = await get(`/api/sessions/${encodeURIComponent(entry.session)}/calls`, signal);
    return { decisions, inView: in_view.map(shortName) };
  }
  if (entry.state !== "ended" || !entry.trace) return { decisions: [], inView: [] };
  const steps = await get(`/api/traces/${encodeURIComponent(entry.trace)}/steps`, signal);
  return { decisions: steps.map(decision), inView: steps.at(-1)?.visible.map(({ object }) => shortName(object)) ?? [] };
}

function decision({ step, input, reply, outcome }: Step): Decision {
  return {
    step, tool: input.call.name, arguments: Object.values(input.call.arguments ?? {}).map(String), reasoning: input.policy?.reasoning || null,
    text: reply?.text ?? outcome.text.trim(), error: outcome.error ?? null,
  };
}

/** Names of the finished traces of a session, the oldest first. */
export async function finished(session: string, latest: string | null, signal: AbortSignal): Promise<string[]> {
  const names: string[] = [];
  // Names begin with the run, and a server calls its own run so unless it is told otherwise.
  let after: string | null | undefined = latest ? latest.slice(0, latest.lastIndexOf(`--${session}--`)) : "serve-";
  for (let page = 0; page < 5 && after !== null && after !== undefined; page += 1) {
    const part: Awaited<ReturnType<typeof list>> = await list(after, signal);
    names.push(...part.traces.filter(({ trace, recording }) => !recording && trace.includes(`--${session}--`)).map(({ trace }) => trace));
    after = part.next;
  }
  return names;
}

function list(after: string, signal: AbortSignal) {
  return get(`/api/traces?limit=1000&after=${encodeURIComponent(after)}`, signal);
}
