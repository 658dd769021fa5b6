/** Statistics of pairs, all of them in closed form: equal data gives equal numbers. */

const Z = 1.959964;

/** McNemar's exact test, two-sided: how likely so uneven a split of the tasks that only one solved is by chance. */
export function mcnemar(onlyA: number, onlyB: number): number {
  const n = onlyA + onlyB;
  if (n === 0) return 1;
  let term = -n * Math.LN2;
  let sum = 0;
  for (let k = 0; k <= Math.min(onlyA, onlyB); k += 1) {
    sum += Math.exp(term);
    term += Math.log((n - k) / (k + 1));
  }
  return Math.min(1, 2 * sum);
}

/** 95% interval of the difference of two paired shares (Bonett and Price 2012). */
export function pairedShares(onlyA: number, onlyB: number, n: number): [number, number] {
  const [a, b] = [(onlyA + 1) / (n + 2), (onlyB + 1) / (n + 2)];
  const half = Z * Math.sqrt((a + b - (a - b) ** 2) / (n + 2));
  return [Math.max(-1, a - b - half), Math.min(1, a - b + half)];
}

/** Mean of paired differences with its 95% interval, by the normal approximation; null where there are too few. */
export function meanDifference(differences: number[]): { mean: number; low: number; high: number } | null {
  const n = differences.length;
  if (n < 2) return null;
  const mean = differences.reduce((sum, one) => sum + one, 0) / n;
  const variance = differences.reduce((sum, one) => sum + (one - mean) ** 2, 0) / (n - 1);
  const half = Z * Math.sqrt(variance / n);
  return { mean, low: mean - half, high: mean + half };
}
