/** The plain part of Markdown as data: a card is shown by elements of ours, never as HTML of somebody else. */

export type Span = { kind: "text" | "code" | "strong"; text: string };
export type Block =
  | { kind: "heading"; level: number; spans: Span[] }
  | { kind: "paragraph"; spans: Span[] }
  | { kind: "list"; items: Span[][] }
  | { kind: "code"; text: string }
  | { kind: "table"; head: Span[][]; rows: Span[][][]; right: boolean[] };

/** Links are shown as their text: a card names files beside it, which are not here. */
export function spans(text: string): Span[] {
  const plain = text.replace(/\[([^\]]+)\]\([^)]*\)/g, "$1");
  return plain.split(/(`[^`]+`|\*\*[^*]+\*\*)/).filter(Boolean).map((part) => {
    if (part.startsWith("`") && part.length > 2) return { kind: "code", text: part.slice(1, -1) };
    if (part.startsWith("**") && part.length > 4) return { kind: "strong", text: part.slice(2, -2) };
    return { kind: "text", text: part };
  });
}

function cells(line: string): string[] {
  return line.replace(/^\||\|$/g, "").split("|").map((cell) => cell.trim());
}

export function blocks(markdown: string): Block[] {
  // What stands before the text is for the site that hosts the data.
  const lines = markdown.replace(/^---\n[\s\S]*?\n---\n/, "").split("\n");
  const found: Block[] = [];
  for (let at = 0; at < lines.length; ) {
    const line = lines[at]!;
    const heading = /^(#{1,6})\s+(.*)$/.exec(line);
    const taken: string[] = [];
    const take = (while_: (line: string) => boolean) => {
      while (at < lines.length && while_(lines[at]!)) taken.push(lines[at++]!);
    };
    if (line.startsWith("```")) {
      at += 1;
      take((next) => !next.startsWith("```"));
      at += 1;
      found.push({ kind: "code", text: taken.join("\n") });
    } else if (heading) {
      at += 1;
      found.push({ kind: "heading", level: heading[1]!.length, spans: spans(heading[2]!) });
    } else if (line.startsWith("|")) {
      take((next) => next.startsWith("|"));
      const [head = "", rule = "", ...rows] = taken;
      const row = (text: string) => cells(text).map(spans);
      found.push({ kind: "table", head: row(head), rows: rows.map(row), right: cells(rule).map((cell) => cell.endsWith(":")) });
    } else if (/^[-*] /.test(line)) {
      take((next) => /^([-*] |\s{2,}\S)/.test(next));
      const items = taken.join("\n").split(/\n(?=[-*] )/).map((item) => spans(item.slice(2).replace(/\n\s*/g, " ")));
      found.push({ kind: "list", items });
    } else if (line.trim() === "") {
      at += 1;
    } else {
      taken.push(lines[at++]!);
      take((next) => next.trim() !== "" && !/^(#{1,6}\s|```|\||[-*] )/.test(next));
      found.push({ kind: "paragraph", spans: spans(taken.join(" ")) });
    }
  }
  return found;
}
