/** What the short names of the benchmark mean (docs/spec.md, Task families and Metrics). */
export const FAMILIES: Readonly<Record<string, string>> = {
  FDP: "Pick and place among similar furniture; the instruction is precise.",
  FODP: "Pick and place among similar furniture and similar objects; the instruction is precise.",
  FDO: "Furniture has doors that must be opened, and closed again.",
  SUL: "The instruction leaves open which object is meant: the agent has to ask.",
};
export const METRICS = {
  CR: "Completion rate: the share of the goal's changes that hold at the end.",
  SPL: "Success weighted by path length: 1 is a success by the shortest way, 0 a failure.",
} as const;

/** What a short name means, for a tooltip; nothing where it is none of them. */
export const termTitle = (name: string): string | undefined => FAMILIES[name] ?? (METRICS as Readonly<Record<string, string>>)[name];
