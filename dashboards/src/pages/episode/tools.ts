/** The tools that a call of a branch may name, and what they take. */
import { callText, markersBefore, shortName, type Call, type Recording } from "../../lib/trace";

const KNOWN: Record<string, string[]> = {
  nav_to: ["receptacle_name"], walk_around: [], show_object_by_category: ["target_category"], show_receptacles: [],
    gaze_at: ["marker_id"],
  pick: ["marker_id"], place: ["marker_id"], open: ["marker_id"], close: ["marker_id"], ask: ["question"], finish: [],
};

/** Tools with their arguments: those of every session, and what else this trace called. */
export function toolsOf({ steps }: Recording): Record<string, string[]> {
  const tools = { ...KNOWN };
  for (const { tool, input } of steps) {
    if (tool === input.call.name) tools[tool] ??= Object.keys(input.call.arguments ?? {});
  }
  return tools;
}

/** What may stand for an argument at a call: value and what people read. Empty: free text. */
export function choices(recording: Recording, argument: string, at: number): { value: string; label: string }[] {
  const { episode, steps } = recording;
  if (argument === "receptacle_name") {
    return Object.keys(episode.start.graphs.physics).map((id) => ({ value: id, label: id }));
  }
  if (argument === "target_category") {
    return [...new Set(episode.task.objects.map(({ category }) => category))].sort().map((name) =>
      ({ value: name, label: name }));
  }
  if (argument === "marker_id") {
    return markersBefore(steps, at).map(({ id, target }) => ({ value: String(id), label: `${id}: ${shortName(target.id)}` }));
  }
  return [];
}

/** A call from what the fields say: numbers where the tool wants numbers. */
export function made(name: string, given: Record<string, string>, wanted: string[]): Call {
  const entries = wanted.map((argument) => {
    const text = given[argument] ?? "";
    return [argument, argument === "marker_id" && /^\d+$/.test(text) ? Number(text) : text];
  });
  return { name, arguments: Object.fromEntries(entries) };
}

/** A name for a branch that no trace has yet: of the parent, the step and what is done there, and the time. */
export function branchName(trace: string, at: number, call: Call | null): string {
  const what = call ? callText(call).replace(/[^A-Za-z0-9]+/g, "-").replace(/^-|-$/g, "").slice(0, 24) : "handed-over";
  return `${trace.slice(0, 140)}--at-${at}--${what}--${Date.now().toString(36)}`;
}
