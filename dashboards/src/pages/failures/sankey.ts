/** The flows of failures as a chart. */
import type { EChartsCoreOption } from "echarts/core";
import { words } from "../../lib/format";
import { palette } from "../../lib/palette";
import type { Flow } from "./questions";

export type Part = "family" | "class" | "sub_class";
export const PARTS: Part[] = ["family", "class", "sub_class"];

/** What a click on something of the chart chooses. */
export function chosenBy(data: unknown): Partial<Record<Part, string>> | null {
  return typeof data === "object" && data !== null && "parts" in data ? (data.parts as Partial<Record<Part, string>>) : null;
}

/** Nodes of two parts may have one name; the part before it tells them apart. */
const node = (part: Part, flow: Flow) => (part === "sub_class" ? `${part} ${flow.class} ${flow.sub_class}` : `${part} ${flow[part]}`);

export function sankey(flows: Flow[], chosen: Record<Part, string>, dark: boolean): EChartsCoreOption {
  const colors = palette(dark);
  const classes = ["Object Confusion", "Key Action Missing", "Lost Memory", "Other"];
  const color = (flow: Flow) => colors.series[(classes.indexOf(flow.class) + 1 || 6) % colors.series.length];
  const any = PARTS.some((part) => chosen[part]);
  const fits = (flow: Flow) => PARTS.every((part) => !chosen[part] || flow[part] === chosen[part]);
  const nodes = new Map<string, { name: string; depth: number; shown: string; episodes: number; parts: object; lit: boolean; color?: string }>();
  const links = new Map<string, { source: string; target: string; value: number; parts: object; lit: boolean; color?: string }>();
  for (const flow of flows) {
    PARTS.forEach((part, depth) => {
      const name = node(part, flow);
      const parts = part === "sub_class" ? { class: flow.class, sub_class: flow.sub_class } : { [part]: flow[part] };
      const known = nodes.get(name) ?? { name, depth, shown: words(flow[part]), episodes: 0, parts, lit: false, color: depth ? color(flow) : colors.soft };
      known.episodes += flow.episodes;
      known.lit ||= fits(flow);
      nodes.set(name, known);
    });
    for (const [from, to] of [["family", "class"], ["class", "sub_class"]] as const) {
      const [source, target] = [node(from, flow), node(to, flow)];
      const known = links.get(`${source}\n${target}`) ?? {
        source, target, value: 0, parts: { [from]: flow[from], [to]: flow[to] }, lit: false, color: color(flow),
      };
      known.value += flow.episodes;
      known.lit ||= fits(flow);
      links.set(`${source}\n${target}`, known);
    }
  }
  const strong = (lit: boolean, yes: number, no: number) => (!any || lit ? yes : no);
  return {
    tooltip: {
      formatter: ({ data }: { data: { shown?: string; episodes?: number; value?: number; parts: Record<string, string> } }) => {
        const box = document.createElement("div");
        const name = data.shown ?? Object.values(data.parts).map(words).join(" → ");
        box.textContent = `${name}: ${data.episodes ?? data.value}`;
        return box;
      },
    },
    series: [{
      type: "sankey", left: 0, right: 150, top: 4, bottom: 8, nodeWidth: 12, nodeGap: 9, draggable: false, layoutIterations: 48,
      emphasis: { disabled: true },
      label: {
        color: colors.ink, fontSize: 13, textBorderWidth: 0,
        formatter: ({ data }: { data: { shown: string; episodes: number } }) => `${data.shown}  ${data.episodes}`,
      },
      data: [...nodes.values()].map((one) => ({ ...one, itemStyle: { color: one.color, borderWidth: 0, opacity: strong(one.lit, 1, 0.25) } })),
      links: [...links.values()].map((one) => ({ ...one, lineStyle: { color: one.color, opacity: strong(one.lit, 0.35, 0.07), curveness: 0.5 } })),
    }],
  };
}
