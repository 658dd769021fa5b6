/** What the columns of named queries mean, as the comment at the head of each says. */
import { get } from "./api";
import type { NamedQuery } from "./generated";
import type { Terms } from "./terms";

let known: Promise<NamedQuery[]> | undefined;

/** Columns of the named queries that a question reads from, with their meanings. */
export async function meaningsOf(question: string): Promise<Terms> {
  known ??= get("/api/queries");
  const queries = await known.catch(() => ((known = undefined), []));
  const read = queries.filter(({ name }) => new RegExp(`\\b(from|join)\\s+${name}\\b`, "i").test(question));
  return Object.assign({}, ...read.map(({ sql }) => columnsIn(sql)));
}

/** The part `Columns:` of a comment: names, two spaces or more, and what they mean, which may go on in the next lines. */
function columnsIn(sql: string): Terms {
  const [, part = ""] = /^-- Columns:\n((?:--  .*\n)+)/m.exec(sql) ?? [];
  const lines = part.replace(/\n-- {8,}/g, " ").split("\n");
  return Object.fromEntries(lines.flatMap((line) => {
    const [, names = "", meaning = ""] = /^-- +(.+?) {2,}(.+)$/.exec(line) ?? [];
    return names ? names.split(", ").map((name) => [name, meaning]) : [];
  }));
}
