/** Times of tools, out of the histogram that Prometheus reads. */

export type Latency = { tool: string; calls: number; mean: number; median: number; p95: number };

const LINE = /^reel_tool_call_seconds_(bucket|sum|count)\{([^}]*)\} (\S+)$/;

export function latencies(metrics: string): Latency[] {
  const tools = new Map<string, { sum: number; count: number; buckets: [number, number][] }>();
  for (const line of metrics.split("\n")) {
    const found = LINE.exec(line);
    if (!found) continue;
    const [, kind, labels = "", value] = found;
    const tool = /tool="([^"]*)"/.exec(labels)?.[1] ?? "?";
    const known = tools.get(tool) ?? { sum: 0, count: 0, buckets: [] };
    tools.set(tool, known);
    if (kind === "sum") known.sum = Number(value);
    else if (kind === "count") known.count = Number(value);
    else known.buckets.push([Number(/le="([^"]*)"/.exec(labels)?.[1]?.replace("+Inf", "Infinity")), Number(value)]);
  }
  return [...tools]
    .filter(([, { count }]) => count > 0)
    .map(([tool, { sum, count, buckets }]) => ({
      tool, calls: count, mean: sum / count, median: quantile(buckets, count, 0.5), p95: quantile(buckets, count, 0.95),
    }))
    .sort((a, b) => b.p95 - a.p95);
}

/** Within its bucket a quantile is taken as evenly spread, as Prometheus does. */
function quantile(buckets: [number, number][], count: number, share: number): number {
  const wanted = share * count;
  let [low, below] = [0, 0];
  for (const [high, upTo] of buckets.toSorted((a, b) => a[0] - b[0])) {
    if (upTo >= wanted) return Number.isFinite(high) ? low + ((high - low) * (wanted - below)) / Math.max(1, upTo - below) : low;
    [low, below] = [high, upTo];
  }
  return low;
}
