/** The tools that a session tells, what they take, and the key of each. */
import type { Call } from "../../lib/trace";
import type { Turn } from "./driver.svelte";

/** A tool as an observation describes it. */
export interface Tool {
  name: string;
  description: string;
  input_schema: { properties?: Record<string, { type?: string; description?: string }>; required?: string[] };
}

export interface Receptacle {
  id: string;
  category: string;
  room: string;
}

/** The argument that holds a marker's number. */
export const MARKER = "marker_id";

export function argumentsOf(tool: Tool | undefined): string[] {
  return Object.keys(tool?.input_schema.properties ?? {});
}

/** Whether a call without this argument is incomplete. */
export function isRequired(tool: Tool, argument: string): boolean {
  return tool.input_schema.required?.includes(argument) ?? true;
}

/** Keys of the page itself: `g` leads to another page. */
const TAKEN = "g";

/** A letter for each tool: the first of its name that no tool before it has. */
export function keysOf(tools: Tool[]): Record<string, string> {
  const taken = new Set(TAKEN);
  const keys: Record<string, string> = {};
  for (const { name } of tools) {
    const letter = [...name].find((letter) => /[a-z]/.test(letter) && !taken.has(letter));
    if (!letter) continue;
    taken.add(letter);
    keys[letter] = name;
  }
  return keys;
}

/** A call from what the fields say: whole numbers where the tool wants them. */
export function callOf(tool: Tool, given: Record<string, string>): Call {
  const entries = argumentsOf(tool).flatMap((name) => {
    const text = (given[name] ?? "").trim();
    if (!text && !isRequired(tool, name)) return [];
    const whole = tool.input_schema.properties?.[name]?.type === "integer" && /^-?\d+$/.test(text);
    return [[name, whole ? Number(text) : text] as const];
  });
  return { name: tool.name, arguments: Object.fromEntries(entries) };
}

/** The name of a person as that of a policy: `person-ann`. */
export function policyOf(author: string): string {
  const plain = author.normalize("NFD").replace(/\p{M}/gu, "").replace(/[^A-Za-z0-9_.]+/g, "-");
  return `person-${plain}`.slice(0, 48).replace(/[-.]+$/, "");
}

/** The latest call that picked something up, of which nothing says that it was put down: what the calls told of the hand. */
export function holding(turns: Turn[]): Turn | null {
  const hand = turns.findLast(({ call, error }) => error === null && (call.name === "pick" || call.name === "place"));
  return hand?.call.name === "pick" ? hand : null;
}
