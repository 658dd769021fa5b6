/** Search in what was said: the instruction, the calls, their results, questions, replies, the policy's own words, tags and comments. */
import { type Row, sql } from "./api";

/** What of a step is searched, and how it is called. */
const PARTS = {
  call: "concat(call_name, ' ', arguments)", result: "text", question: "question", reply: "reply", reasoning: "reasoning", plan: "plan", summary: "history",
} as const;
type Part = keyof typeof PARTS | "instruction" | "tag" | "comment";

/** The condition that a text occurs in a column, in upper or lower case. A parameter like `42` is a number unless it stands beside a text. */
export function contains(column: string, parameter: string): string {
  return `strpos(lower(${column}), lower($${parameter} || '')) > 0`;
}

const STEP_CONTAINS = `(${Object.values(PARTS).map((column) => contains(column, "search")).join(" OR ")})`;

const REMARK_CONTAINS = `kind <> 'star' AND ${contains("text", "search")}`;

/** The condition on `listed`: the text of `$search` occurs somewhere in the episode, or in a tag or comment of it. */
export const CONTAINS_TEXT = `(${contains("instruction", "search")}
  OR episode_id IN (SELECT episode_id FROM steps WHERE ${STEP_CONTAINS})
  OR episode_id IN (SELECT episode_id FROM remarks WHERE ${REMARK_CONTAINS}))`;

/** Where a text was found first: in a step, in a remark, or in the instruction. */
export interface Found {
  step: number | null;
  part: Part;
  before: string;
  match: string;
  after: string;
}

/** Letters on both sides of what was found. */
const AROUND = 60;

/** The words around the first place of a text; null if it is not there. */
export function excerpt(said: string, text: string): Pick<Found, "before" | "match" | "after"> | null {
  const at = said.toLowerCase().indexOf(text.toLowerCase());
  if (at < 0) return null;
  const end = at + text.length;
  const from = Math.max(0, at - AROUND);
  return {
    before: (from ? "…" : "") + said.slice(from, at), match: said.slice(at, end),
    after: said.slice(end, end + AROUND) + (said.length > end + AROUND ? "…" : ""),
  };
}

/** The first step of each of these episodes that says it; where none does, the first remark. */
export async function foundIn(episodes: string[], text: string, signal: AbortSignal): Promise<Map<string, Found>> {
  const found = new Map<string, Found>();
  if (!episodes.length) return found;
  const parts = Object.entries(PARTS).map(([part, column]) => `${column} AS "${part}"`);
  const question = `SELECT episode_id, step, ${parts.join(", ")} FROM steps
WHERE episode_id IN (${named(episodes)}) AND ${STEP_CONTAINS}
QUALIFY row_number() OVER (PARTITION BY episode_id ORDER BY step) = 1`;
  for (const row of await sql<Row>(question, { ...parameters(episodes), search: text }, signal)) {
    const id = String(row["episode_id"]);
    for (const part of Object.keys(PARTS) as Part[]) {
      const words = typeof row[part] === "string" ? excerpt(row[part], text) : null;
      if (!words) continue;
      found.set(id, { step: Number(row["step"]), part, ...words });
      break;
    }
  }
  const rest = episodes.filter((id) => !found.has(id));
  if (rest.length) await findRemarks(rest, text, found, signal);
  return found;
}

/** Adds the first remark on each of these episodes that says it. */
async function findRemarks(episodes: string[], text: string, found: Map<string, Found>, signal: AbortSignal) {
  const question = `SELECT episode_id, kind, text, step FROM remarks
WHERE episode_id IN (${named(episodes)}) AND ${REMARK_CONTAINS}
QUALIFY row_number() OVER (PARTITION BY episode_id ORDER BY at_ms) = 1`;
  type Said = { episode_id: string; kind: "tag" | "comment"; text: string; step: number | null };
  const rows = await sql<Said>(question, { ...parameters(episodes), search: text }, signal);
  for (const { episode_id, kind, text: said, step } of rows) {
    const words = excerpt(said, text);
    if (words) found.set(episode_id, { step, part: kind, ...words });
  }
}

/** Ids as a list of parameters, and their values. */
const named = (episodes: string[]) => episodes.map((_, index) => `$e${index}`).join(", ");
const parameters = (episodes: string[]) => Object.fromEntries(episodes.map((id, index) => [`e${index}`, id]));
