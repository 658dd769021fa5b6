/** A bar chart has one bar for each value of x and colour: which rows share one, and which column separates them. */
import type { Row } from "./api";
import { isNumeric, text } from "./rows";

/** The first row that would be drawn over another one. */
function hidden(rows: Row[], x: string, group: string): Row | undefined {
  const seen = new Set<string>();
  return rows.find((row) => {
    const bar = JSON.stringify([text(row[x]), group && text(row[group])]);
    if (seen.has(bar)) return true;
    seen.add(bar);
    return false;
  });
}

/** The column by which the bars need a colour: `""` if x alone separates the rows, or if no column separates them. */
export function separating(rows: Row[], columns: string[], x: string, y: string): string {
  if (!hidden(rows, x, "")) return "";
  const others = columns.filter((column) => column !== x && column !== y);
  const numbers = others.filter((column) => isNumeric(rows, column));
  // Measured numbers differ in every row by chance; those that a question groups by come back.
  const repeats = (column: string) => new Set(rows.map((row) => text(row[column]))).size < rows.length;
  const wanted = [...others.filter((column) => !numbers.includes(column)), ...numbers.filter(repeats)];
  return wanted.find((column) => !hidden(rows, x, column)) ?? "";
}

/** Why these bars cannot be drawn, and what to do; null if each row has a bar of its own. */
export function barsProblem(rows: Row[], columns: string[], { x, y, group }: { x: string; y: string; group: string }): string | null {
  const row = hidden(rows, x, group);
  if (!row) return null;
  const shared = [x, ...(group ? [group] : [])].map((column) => `${column} = ${text(row[column]) || "null"}`).join(" and ");
  const better = separating(rows, columns, x, y);
  const advice = better
    ? `Choose ${better} as group: one colour for each ${better}.`
    : `No column separates them as group. Aggregate in the question: GROUP BY ${[x, ...(group ? [group] : [])].join(", ")}.`;
  return `Several rows have ${shared}, and a bar chart would show one of them. ${advice}`;
}
