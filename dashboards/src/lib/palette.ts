/** Colours for charts, which cannot read those of the style sheet. */

export type Palette = { ink: string; soft: string; line: string; accent: string; good: string; bad: string; warn: string;
  series: string[] };

const light: Palette = {
  ink: "#1d2226", soft: "#565f66", line: "#dcd8ce", accent: "#1f6660", good: "#2c6e37", bad: "#a8352b", warn: "#b67a0c",
  series: ["#1f6660", "#4a86c5", "#a8352b", "#a67a10", "#7d5fb0", "#6b7479", "#d2568f", "#5f8f2a", "#2b3f8c", "#d9662a"],
};
const dark: Palette = {
  ink: "#e8e6e1", soft: "#a3abb2", line: "#333a41", accent: "#6fc3ba", good: "#7cc489", bad: "#ef8a80", warn: "#e2b55b",
  series: ["#6fc3ba", "#5b9be6", "#ef8a80", "#e2b55b", "#a98be0", "#8d969c", "#f0a3d0", "#a4cf6a", "#4f6af0", "#f2e88c"],
};

export function palette(isDark: boolean): Palette {
  return isDark ? dark : light;
}

const places = new Map<string, number>();

/** The colour of a policy, the same in all charts until the pages are loaded again. */
export function policyColor(policy: string, isDark: boolean): string {
  const place = places.get(policy) ?? places.size;
  places.set(policy, place);
  const { series } = palette(isDark);
  return series[place % series.length]!;
}
