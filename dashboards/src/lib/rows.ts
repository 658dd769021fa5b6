/** Rows of any answer: as text, in order, as CSV. */
import type { Row } from "./api";

export function columnsOf(rows: Row[]): string[] {
  return Object.keys(rows[0] ?? {});
}

export function isNumeric(rows: Row[], column: string): boolean {
  let any = false;
  for (const row of rows) {
    const value = row[column];
    if (value === null || value === undefined) continue;
    if (typeof value !== "number") return false;
    any = true;
  }
  return any;
}

export function text(value: unknown): string {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(7)));
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

/** A value in a table: of a number four decimals, or four digits if it is below one. */
export function short(value: unknown): string {
  if (typeof value !== "number" || Number.isInteger(value)) return text(value);
  return String(Number(Math.abs(value) < 1 ? value.toPrecision(4) : value.toFixed(4)));
}

/** What is not there comes last, whichever way the order goes. */
export function sorted(rows: Row[], column: string, down: boolean): Row[] {
  const by = new Intl.Collator("en", { numeric: true });
  return [...rows].sort((one, other) => {
    const [a, b] = [one[column], other[column]];
    if (a === null || b === null) return a === b ? 0 : a === null ? 1 : -1;
    const order = typeof a === "number" && typeof b === "number" ? a - b : by.compare(text(a), text(b));
    return down ? -order : order;
  });
}

export function csv(rows: Row[], columns: string[]): string {
  const field = (value: unknown) => {
    const written = value === null || value === undefined ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
    return /[",\r\n]/.test(written) ? `"${written.replaceAll('"', '""')}"` : written;
  };
  return [columns, ...rows.map((row) => columns.map((column) => row[column]))].map((line) => line.map(field).join(",")).join("\r\n");
}
