/** Search in what was said: the instruction, the calls, their results, questions, replies and the policy's own words. */
import { type Row, sql } from "./api";

/** What of a step is searched, and how it is called. */
const PARTS = {
  call: "concat(call_name, ' ', arguments)", result: "text", question: "question", reply: "reply", reasoning: "reasoning", plan: "plan", summary: "history",
} as const;
type Part = keyof typeof PARTS | "instruction";

/** The condition that a text occurs in a column, in upper or lower case. A parameter like `42` is a number unless it stands beside a text. */
export function contains(column: string, parameter: string): string {
  return `strpos(lower(${column}), lower($${parameter} || '')) > 0`;
}

const STEP_CONTAINS = `(${Object.values(PARTS).map((column) => contains(column, "search")).join(" OR ")})`;

/** The condition on `listed`: the text of `$search` occurs somewhere in the episode. */
export const CONTAINS_TEXT = `(${contains("instruction", "search")} OR episode_id IN (SELECT episode_id FROM steps WHERE ${STEP_CONTAINS}))`;

/** Where a text was found first: in a step, or in the instruction. */
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

/** The first step of each of these episodes that says it. */
export async function foundIn(episodes: string[], text: string, signal: AbortSignal): Promise<Map<string, Found>> {
  const found = new Map<string, Found>();
  if (!episodes.length) return found;
  const names = episodes.map((_, index) => `$e${index}`);
  const parts = Object.entries(PARTS).map(([part, column]) => `${column} AS "${part}"`);
  const question = `SELECT episode_id, step, ${parts.join(", ")} FROM steps
WHERE episode_id IN (${names.join(", ")}) AND ${STEP_CONTAINS}
QUALIFY row_number() OVER (PARTITION BY episode_id ORDER BY step) = 1`;
  const values = Object.fromEntries(episodes.map((id, index) => [`e${index}`, id]));
  for (const row of await sql<Row>(question, { ...values, search: text }, signal)) {
    const id = String(row["episode_id"]);
    for (const part of Object.keys(PARTS) as Part[]) {
      const words = typeof row[part] === "string" ? excerpt(row[part], text) : null;
      if (!words) continue;
      found.set(id, { step: Number(row["step"]), part, ...words });
      break;
    }
  }
  return found;
}
