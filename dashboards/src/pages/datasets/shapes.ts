/** What the service tells of training sets. */

export type Export = {
  name: string;
  created: number;
  bytes: number;
  card?: string;
  manifest: {
    format?: string; style?: string; table_version?: number; shards?: Record<string, { rows: number }[]>;
    tokens?: { examples: number; longest: number; over: number; budget: number }; left_out?: Record<string, number>;
  };
};

export type Part = { text: string } | { image: number } | { call: { name: string; arguments: Record<string, unknown> } };
export type Example = {
  number: number;
  error?: string;
  split?: string | null;
  turns?: { role: string; learned: boolean; parts: Part[] }[];
  tools?: unknown;
  images?: (string | null)[];
  meta?: Record<string, unknown> | null;
  oddities?: string[];
};

export type Finding = { kind: string; severity: string; message: string; excerpt?: string;
  examples: { index: number; line: number }[] };
export type Check = {
  check: string; what: string; applies: boolean; findings: number; rows: number; share: number; worst: string | null;
  kinds: Record<string, number>; note: string; examples: Finding[];
};
export type Lint = { rows: number; unreadable: number; checks: Check[] };

export function rowsOf({ manifest }: Export): number {
  const shards = Object.values(manifest.shards ?? {}).flat();
  return shards.length ? shards.reduce((sum, { rows }) => sum + rows, 0) : (manifest.tokens?.examples ?? 0);
}

export function size(bytes: number): string {
  const steps = [[1e9, "GB"], [1e6, "MB"], [1e3, "kB"]] as const;
  const [unit, name] = steps.find(([unit]) => bytes >= unit) ?? [1, "B"];
  return `${(bytes / unit).toFixed(unit === 1 ? 0 : 1)} ${name}`;
}
