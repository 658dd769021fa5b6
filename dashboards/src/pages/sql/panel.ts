/** A panel: a question and how its answer is drawn, as a file of dashboards/definitions. */
import type { Row } from "../../lib/api";
import { isNumeric } from "./rows";

export const KINDS = ["table", "bar", "line", "scatter"] as const;
export type Kind = (typeof KINDS)[number];

export interface Plotted {
  kind: Kind;
  x: string;
  y: string;
  group: string;
}

/** What the address says of the chart; what it leaves open follows from the columns. */
export function plottedOf(query: URLSearchParams, rows: Row[], columns: string[]): Plotted {
  const kind = KINDS.find((kind) => kind === query.get("as")) ?? "table";
  const numbers = columns.filter((column) => isNumeric(rows, column));
  const named = (key: string, from: string[]) => from.find((column) => column === query.get(key));
  const y = named("y", numbers) ?? (kind === "scatter" ? (numbers[1] ?? numbers[0]) : numbers[0]) ?? "";
  const usualX = kind === "scatter" ? numbers[0] : columns.find((column) => !numbers.includes(column));
  return { kind, x: named("x", columns) ?? usualX ?? columns[0] ?? "", y, group: named("group", columns) ?? "" };
}

export function panel(name: string, sql: string, parameters: Record<string, string>, plotted: Plotted): string {
  const { kind, x, y, group } = plotted;
  const chart = kind === "table" ? { kind } : { kind, x, y, ...(group ? { group } : {}) };
  return `${JSON.stringify({ name, sql, parameters, chart }, null, 2)}\n`;
}
