/** What the service tells of training sets. */

import type { Export as Listed } from "../../lib/generated";

export type { Example, Lint } from "../../lib/generated";
export type Export = Listed & { manifest: Manifest };

/** The fields of `manifest.json` that pages show. */
export type Manifest = {
  format?: string; style?: string; table_version?: number; shards?: Record<string, { rows: number }[]>;
  tokens?: { examples: number; longest: number; over: number; budget: number }; excluded?: Record<string, number>;
  counts?: Record<string, number>;
};

export function rowsOf({ manifest }: Export): number {
  const shards = Object.values(manifest.shards ?? {}).flat();
  return shards.length ? shards.reduce((sum, { rows }) => sum + rows, 0) : (manifest.tokens?.examples ?? manifest.counts?.["pairs"] ?? 0);
}

export function size(bytes: number): string {
  const steps = [[1e9, "GB"], [1e6, "MB"], [1e3, "kB"]] as const;
  const [unit, name] = steps.find(([unit]) => bytes >= unit) ?? [1, "B"];
  return `${(bytes / unit).toFixed(unit === 1 ? 0 : 1)} ${name}`;
}
