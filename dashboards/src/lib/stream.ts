/** The first rows of an answer in SQL: what comes after them is not read, so that no question is too large for a page. */
import { BROKE_OFF } from "./advice";
import { type Row, send } from "./api";

/** Most text that is read, whatever the number of rows. */
const MOST = 24 << 20;

export interface FirstRows {
  rows: Row[];
  /** Whether there are more. */
  more: boolean;
}

export async function firstRows(text: string, parameters: Record<string, string>, most: number, signal: AbortSignal): Promise<FirstRows> {
  const answer = await send("POST", "/api/sql", { sql: text, parameters }, signal);
  const reader = answer.body!.pipeThrough(new TextDecoderStream()).getReader();
  const rows: Row[] = [];
  let rest = "";
  // Where the scan stands in `rest`, and within what.
  let at = 0;
  let begin = -1;
  let depth = 0;
  let quoted = false;
  let read = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error) => {
      throw signal.aborted ? error : new Error(BROKE_OFF);
    });
    if (done) {
      // The service ends the array, unless the question broke off half-way.
      if (!rest.trimEnd().endsWith("]")) throw new Error(BROKE_OFF);
      return { rows, more: false };
    }
    rest += value;
    read += value.length;
    for (; at < rest.length; at += 1) {
      const char = rest[at];
      if (quoted) {
        if (char === "\\") at += 1;
        else if (char === '"') quoted = false;
      } else if (char === '"') {
        quoted = true;
      } else if (char === "{" || char === "[") {
        depth += 1;
        if (depth === 2) begin = at;
      } else if (char === "}" || char === "]") {
        depth -= 1;
        if (depth !== 1) continue;
        if (rows.length === most || read > MOST) {
          void reader.cancel();
          return { rows, more: true };
        }
        rows.push(JSON.parse(rest.slice(begin, at + 1)) as Row);
        begin = -1;
      }
    }
    const cut = begin >= 0 ? begin : Math.max(0, rest.length - 1);
    rest = rest.slice(cut);
    at -= cut;
    if (begin >= 0) begin = 0;
  }
}
