/** What SQL can name here: tables with their columns, functions, and the queries that come with the service. */
import { get, sql } from "../../lib/api";
import type { NamedQuery } from "../../lib/generated";

export interface Column {
  name: string;
  type: string;
}

export interface Table {
  name: string;
  view: boolean;
  columns: Column[];
}

export interface Func {
  name: string;
  syntax: string;
  tells: string;
}

export type { NamedQuery };

export interface Schema {
  tables: Table[];
  functions: Func[];
  queries: NamedQuery[];
}

export async function schema(signal: AbortSignal): Promise<Schema> {
  const [columns, routines, queries] = await Promise.all([
    sql<{ table_name: string; table_type: string; column_name: string; data_type: string }>(
      `SELECT c.table_name, t.table_type, c.column_name, c.data_type FROM information_schema.columns c
JOIN information_schema.tables t ON t.table_name = c.table_name AND t.table_schema = c.table_schema
WHERE c.table_schema = 'public' ORDER BY c.table_name, c.ordinal_position`, {}, signal,
    ),
    sql<{ name: string; syntax: string | null; tells: string | null }>(
      `SELECT routine_name AS name, max(syntax_example) AS syntax, max(description) AS tells FROM information_schema.routines
GROUP BY routine_name ORDER BY routine_name`, {}, signal,
    ),
    get("/api/queries", signal),
  ]);
  const named = new Set(queries.map((query) => query.name));
  const tables = new Map<string, Table>();
  for (const row of columns) {
    const table = tables.get(row.table_name) ?? { name: row.table_name, view: row.table_type === "VIEW", columns: [] };
    table.columns.push({ name: row.column_name, type: short(row.data_type) });
    tables.set(row.table_name, table);
  }
  // Tables first, then what is made of them; queries can be asked like tables, too, and come last.
  const rank = (table: Table) => (named.has(table.name) ? 2 : table.view ? 1 : 0);
  return {
    tables: [...tables.values()].sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name)),
    functions: routines.map(({ name, syntax, tells }) => ({ name, syntax: syntax ?? `${name}(…)`, tells: tells?.trim() ?? "" })),
    queries,
  };
}

/** `List(non-null Struct("step": …` is `list of rows`; nobody wants to read the rest at this place. */
function short(type: string): string {
  if (type.startsWith("List")) return type.includes("Struct") ? "list of rows" : "list of text";
  const names: Record<string, string> = { Utf8: "text", Utf8View: "text", Boolean: "true/false", Int32: "integer", Int64: "integer", UInt64: "integer", Float64: "number" };
  return names[type] ?? type.replace(/\(.*/, "").toLowerCase();
}

/** The names of `$parameters`, outside of texts and comments. */
export function parametersOf(text: string): string[] {
  const bare = text.replace(/'(?:[^']|'')*'|--[^\n]*|\/\*[\s\S]*?\*\//g, "");
  return [...new Set([...bare.matchAll(/\$([A-Za-z_]\w*)/g)].map((match) => match[1]!))];
}

/** Where an error is, if it says so: an offset in the text, and what stands there. */
export function placeOf(message: string, text: string): { offset: number; length: number; line: number; column: number } | null {
  const told = /at Line: (\d+), Column: (\d+)/.exec(message);
  let offset = -1;
  let length = 0;
  if (told) {
    const lines = text.split("\n");
    const before = lines.slice(0, Number(told[1]) - 1).reduce((sum, line) => sum + line.length + 1, 0);
    offset = Math.min(text.length, before + Number(told[2]) - 1);
    length = /^\w+/.exec(text.slice(offset))?.[0].length ?? 1;
  } else if (/found: EOF/.test(message)) {
    offset = text.trimEnd().length;
  } else {
    const name = /(?:No field named|Invalid function|table) '?(?:\w+\.)*"?([A-Za-z_]\w*)/.exec(message)?.[1];
    const found = name ? new RegExp(`\\b${name}\\b`, "i").exec(text) : null;
    if (!found) return null;
    offset = found.index;
    length = found[0].length;
  }
  const before = text.slice(0, offset).split("\n");
  return { offset, length, line: before.length, column: before.at(-1)!.length + 1 };
}

export interface Candidate {
  text: string;
  kind: string;
}

const KEYWORDS =
  "SELECT FROM WHERE GROUP BY ORDER LIMIT JOIN LEFT USING HAVING DISTINCT WITH CASE WHEN THEN ELSE END UNION AND NOT NULL FILTER OVER PARTITION CAST BETWEEN LIKE".split(" ");

/** What may stand where a word begins: columns of the tables that the text names come first. */
export function candidates(schema: Schema, text: string, prefix: string): Candidate[] {
  const wanted = prefix.toLowerCase();
  if (!wanted) return [];
  const words = new Set(text.toLowerCase().match(/\w+/g) ?? []);
  const found = new Map<string, Candidate>();
  const add = (name: string, kind: string) => {
    if (!found.has(name) && name.toLowerCase().startsWith(wanted) && name.length > prefix.length) found.set(name, { text: name, kind });
  };
  for (const table of schema.tables) if (words.has(table.name)) for (const column of table.columns) add(column.name, table.name);
  for (const table of schema.tables) add(table.name, table.view ? "view" : "table");
  for (const word of KEYWORDS) add(prefix === prefix.toLowerCase() ? word.toLowerCase() : word, "keyword");
  for (const { name } of schema.functions) add(name, "function");
  for (const table of schema.tables) for (const column of table.columns) add(column.name, table.name);
  return [...found.values()].slice(0, 40);
}
