/** Panels (a question and how its answer is drawn) and pages of them, as the service keeps them in JSON files. */
import { get, remove, send, type Row } from "./api";
import { separating } from "./bars";
import type { Definition, Listed } from "./generated";
import { link } from "./route.svelte";
import { isNumeric } from "./rows";

export const KINDS = ["table", "bar", "line", "scatter"] as const;
export type Kind = (typeof KINDS)[number];

export interface Plotted {
  kind: Kind;
  x: string;
  y: string;
  group: string;
}

/** How rows are drawn where so much is said of it; what is left open follows from the columns. */
export function plottedOf(said: Partial<Record<keyof Plotted, string | null>>, rows: Row[], columns: string[]): Plotted {
  const kind = KINDS.find((kind) => kind === said.kind) ?? "table";
  const numbers = columns.filter((column) => isNumeric(rows, column));
  const named = (key: "x" | "y" | "group", from: string[]) => from.find((column) => column === said[key]);
  const y = named("y", numbers) ?? (kind === "scatter" ? (numbers[1] ?? numbers[0]) : numbers[0]) ?? "";
  const usualX = kind === "scatter" ? numbers[0] : columns.find((column) => !numbers.includes(column));
  const x = named("x", columns) ?? usualX ?? columns[0] ?? "";
  return { kind, x, y, group: named("group", columns) ?? (kind === "bar" ? separating(rows, columns, x, y) : "") };
}

export type { Definition, Listed };

const path = (name: string) => `/api/definitions/${encodeURIComponent(name)}`;
export const definitions = (signal?: AbortSignal) => get("/api/definitions", signal);
export const keep = (name: string, definition: Definition) => send("PUT", path(name), definition);
export const drop = (name: string) => remove(path(name));

/** The name of a file for a title. */
export function fileName(title: string): string {
  return title.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(0, 60) || "untitled";
}

export function panel(title: string, sql: string, parameters: Record<string, string>, plotted: Plotted): Definition {
  const { kind, x, y, group } = plotted;
  return { title, sql, parameters, ...(kind === "table" ? {} : { chart: { kind, x, y, ...(group ? { group } : {}) } }) };
}

/** The page of SQL with the question of a panel. */
export function questionLink(sql: string, parameters: Record<string, string>, chart: Definition["chart"]): string {
  const values = Object.fromEntries(Object.entries(parameters).map(([name, value]) => [`p.${name}`, value]));
  return link("/sql", { q: sql, ...values, as: chart?.kind === "table" ? null : chart?.kind, x: chart?.x, y: chart?.y, group: chart?.group });
}
