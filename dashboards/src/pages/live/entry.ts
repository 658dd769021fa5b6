/** Live sessions, the questions that they ask people, and what the service tells of a session's course. */
import { get } from "../../lib/api";
import type { OpenQuestion, Session as Entry, Step } from "../../lib/generated";
import { shortName } from "../../lib/trace";

export type { Question, Session as Entry } from "../../lib/generated";
export type Decision = OpenQuestion["decisions"][number];

export interface Course {
  decisions: Decision[];
  /** What the robot sees, as far as a call or the trace names it. */
  inView: string[];
}

/** What was told last, by session and episode: a session tells its calls only while a question waits and after the end. */
const courses = new Map<string, Course>();

export async function course(entry: Entry, waits: boolean, signal: AbortSignal): Promise<Course> {
  const path = `/api/sessions/${encodeURIComponent(entry.session)}` as const;
  const key = `${entry.session} ${entry.episodes}`;
  if (waits) {
    const { decisions } = await get(`${path}/question`, signal);
    courses.set(key, { decisions, inView: listed(decisions) });
  } else if (entry.state === "ended" && entry.trace) {
    const trace = `/api/traces/${encodeURIComponent(entry.trace)}` as const;
    const steps = await get(`${trace}/steps`, signal);
    courses.set(key, {
      decisions: steps.map(decision),
      inView: steps.at(-1)?.visible.map(({ object }) => shortName(object)) ?? [],
    });
  }
  return courses.get(key) ?? { decisions: [], inView: [] };
}

function decision({ step, input, reply, outcome }: Step): Decision {
  return {
    step, tool: input.call.name, arguments: Object.values(input.call.arguments ?? {}).map(String), reasoning: input.policy?.reasoning || null,
    text: reply?.text ?? outcome.text.trim(), error: outcome.error ?? null,
  };
}

/** The latest result that lists what is in view, one numbered thing a line. */
function listed(decisions: Decision[]): string[] {
  const latest = decisions.findLast(({ text }) => text.includes("in view"))?.text ?? "";
  return [...latest.matchAll(/^\s*\d+: (.+)$/gm)].map(([, name]) => name!);
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
