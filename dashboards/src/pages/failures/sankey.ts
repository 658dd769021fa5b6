/** The flows of failures as a chart. Where parts are chosen, every node and flow shows how much of it is chosen. */
import type { EChartsCoreOption } from "echarts/core";
import { words } from "../../lib/format";
import { palette } from "../../lib/palette";
import { termTitle } from "../../lib/terms";
import type { Flow } from "./questions";

export type Part = "family" | "class" | "sub_class";
/** One value of each part, as a piece of the chart has. */
type Parts = Partial<Record<Part, string>>;
type Chosen = Partial<Record<Part, string[]>>;
const PARTS: Part[] = ["family", "class", "sub_class"];
const CLASSES = ["Object Confusion", "Key Action Missing", "Lost Memory", "Other"];

/** Whether a flow has the chosen parts, one of them left out. */
export function fits(flow: Flow, chosen: Chosen, but?: Part): boolean {
  return PARTS.every((part) => part === but || chosen[part]?.includes(flow[part]) !== false);
}

/** What a click on something of the chart chooses. */
export function chosenBy(data: unknown): Parts | null {
  return typeof data === "object" && data !== null && "parts" in data ? (data.parts as Parts) : null;
}

/** A node or a flow between two, with its chosen episodes and all of them. */
interface Piece {
  parts: Parts;
  shown: string;
  color: string;
  chosen: number;
  all: number;
}

/** Nodes of two parts may have one name; the part before it tells them apart. */
const node = (part: Part, flow: Flow) => (part === "sub_class" ? `${part} ${flow.class} ${flow.sub_class}` : `${part} ${flow[part]}`);

/** Adds a flow to a piece of the chart, which begins with the first flow. */
function add<P extends Piece>(pieces: Map<string, P>, key: string, flow: Flow, chosen: Chosen, first: Omit<P, "chosen" | "all">) {
  const piece = pieces.get(key) ?? ({ ...first, chosen: 0, all: 0 } as P);
  piece.all += flow.episodes;
  if (fits(flow, chosen)) piece.chosen += flow.episodes;
  pieces.set(key, piece);
}

export function sankey(flows: Flow[], chosen: Chosen, dark: boolean): EChartsCoreOption {
  const colors = palette(dark);
  const color = (flow: Flow) => colors.series[CLASSES.indexOf(flow.class) + 1]!;
  const any = PARTS.some((part) => chosen[part]);
  const nodes = new Map<string, Piece & { name: string; depth: number }>();
  const links = new Map<string, Piece & { source: string; target: string }>();
  for (const flow of flows) {
    PARTS.forEach((part, depth) => {
      const name = node(part, flow);
      const parts = part === "sub_class" ? { class: flow.class, sub_class: flow.sub_class } : { [part]: flow[part] };
      add(nodes, name, flow, chosen, { name, depth, parts, shown: words(flow[part]), color: depth ? color(flow) : colors.soft });
    });
    for (const [from, to] of [["family", "class"], ["class", "sub_class"]] as const) {
      const [source, target] = [node(from, flow), node(to, flow)];
      const shown = `${words(flow[from])} → ${words(flow[to])}`;
      add(links, `${source}\n${target}`, flow, chosen, { source, target, shown, parts: { [from]: flow[from], [to]: flow[to] }, color: color(flow) });
    }
  }
  const counted = (piece: Piece) => (any ? `${piece.chosen} of ${piece.all}` : `${piece.all}`);
  /** The chosen part of a node stands at its top in full colour. */
  const filled = ({ color, chosen, all }: Piece) => ({
    type: "linear", x: 0, y: 0, x2: 0, y2: 1,
    colorStops: [[0, color], [chosen / all, color], [chosen / all, `${color}40`], [1, `${color}40`]].map(([offset, color]) => ({ offset, color })),
  });
  return {
    tooltip: {
      formatter: ({ data }: { data: Piece }) => {
        const box = document.createElement("div");
        box.textContent = `${data.shown}: ${counted(data)}`;
        const meaning = termTitle(data.parts.sub_class ?? data.parts.class ?? data.parts.family);
        if (meaning) {
          const told = document.createElement("div");
          told.textContent = meaning;
          told.style.cssText = "max-width: 320px; white-space: normal; font-size: 12px; opacity: 0.8";
          box.append(told);
        }
        return box;
      },
    },
    series: [{
      type: "sankey", left: 0, right: 185, top: 4, bottom: 8, nodeWidth: 12, nodeGap: 9, draggable: false, layoutIterations: 48,
      emphasis: { disabled: true },
      label: {
        color: colors.ink, fontSize: 13, textBorderWidth: 0,
        formatter: ({ data }: { data: Piece }) => `${data.shown}  ${counted(data)}`,
      },
      data: [...nodes.values()].map((one) => ({
        ...one,
        itemStyle: { color: any ? filled(one) : one.color, borderWidth: 0 },
        label: any && !one.chosen ? { color: colors.soft } : undefined,
      })),
      // The chosen part of a flow and the rest are two bands side by side.
      links: [...links.values()].flatMap((one) => {
        const band = (value: number, opacity: number) => ({ ...one, value, lineStyle: { color: one.color, opacity, curveness: 0.5 } });
        if (!any) return [band(one.all, 0.35)];
        return [band(one.chosen, 0.55), band(one.all - one.chosen, 0.09)].filter(({ value }) => value);
      }),
    }],
  };
}
