/** What the two curves of an episode have in common: one axis of moments, the current one and the decisive one marked. */
import type { Palette } from "../../lib/palette";
import { START } from "../../lib/trace";
import type { Side } from "./alignment";

export function moments(last: number): string[] {
  return ["start", ...Array.from({ length: last + 1 }, (_, step) => String(step))];
}

export function place(moment: number): number {
  return moment - START;
}

/** Charts write numbers as the rest of the page does. */
const withMinus = (value: unknown) => (value === "-" || value === undefined ? "–" : String(value).replace("-", "−"));

export function axes(last: number, colours: Palette, unit: string) {
  const label = { color: colours.soft, fontSize: 11 };
  return {
    grid: { left: 44, right: 14, top: 30, bottom: 26 },
    legend: { top: 0, right: 0, itemWidth: 12, itemHeight: 8, textStyle: label },
    tooltip: { trigger: "axis", confine: true, axisPointer: { type: "shadow" }, valueFormatter: withMinus },
    xAxis: {
      type: "category", data: moments(last), axisLabel: { ...label, hideOverlap: true }, axisTick: { show: false },
      axisLine: { lineStyle: { color: colours.line } },
    },
    yAxis: {
      type: "value", name: unit, nameTextStyle: { ...label, align: "left" }, nameGap: 10, axisLabel: { ...label, formatter: withMinus },
      splitLine: { lineStyle: { color: colours.line } },
    },
  };
}

/** Lines at the current and at the decisive step, and where two episodes part, to hang on a series. */
export function marks(moment: number, decisive: number | null, colours: Palette, parting: number | null = null) {
  const line = (at: number, colour: string, text: string, dashed: boolean) => ({
    xAxis: place(at), lineStyle: { color: colour, width: dashed ? 1 : 2, type: dashed ? "dashed" : "solid" },
    label: { formatter: text, color: colour, fontSize: 11, position: "end", distance: 2 },
  });
  const data = [line(moment, colours.ink, "", false)];
  if (decisive !== null) data.push(line(decisive, colours.bad, "◆", true));
  if (parting !== null) data.push(line(parting, colours.accent, parting === decisive ? "" : "part", true));
  return { symbol: "none", silent: true, data };
}

/** The line of one of two episodes: the page's solid, the other's dashed, in the colours of their heads. */
export function sideLine(side: Side, name: string, colours: Palette) {
  const color = side === "a" ? colours.accent : colours.warn;
  return {
    name, type: "line", color, symbol: side === "a" ? "circle" : "emptyCircle", symbolSize: 5,
    lineStyle: { color, width: 2, type: side === "a" ? "solid" : "dashed" },
  };
}
