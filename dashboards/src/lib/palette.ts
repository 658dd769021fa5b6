/** Colours for charts, which cannot read those of the style sheet. */

export type Palette = { ink: string; soft: string; line: string; accent: string; good: string; bad: string; warn: string;
  series: string[] };

const light: Palette = {
  ink: "#1d2226", soft: "#565f66", line: "#dcd8ce", accent: "#1f6660", good: "#2c6e37", bad: "#a8352b", warn: "#b67a0c",
  series: ["#1f6660", "#7aa6d6", "#a8352b", "#c99a2e", "#7d6aa8", "#7d868c"],
};
const dark: Palette = {
  ink: "#e8e6e1", soft: "#a3abb2", line: "#333a41", accent: "#6fc3ba", good: "#7cc489", bad: "#ef8a80", warn: "#e2b55b",
  series: ["#6fc3ba", "#6f9fd6", "#ef8a80", "#e2b55b", "#a998d6", "#8d969c"],
};

export function palette(isDark: boolean): Palette {
  return isDark ? dark : light;
}
