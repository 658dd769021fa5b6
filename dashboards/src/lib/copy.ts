/** Text for the clipboard, and the ways in which programs ask for what a page shows. */

/** Copies a text; false where the browser does not let this page do so. */
export async function copyText(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return copiedBySelecting(text);
  }
}

/** The older way: browsers give pages without TLS no clipboard. */
function copiedBySelecting(text: string): boolean {
  const focused = document.activeElement as HTMLElement | null;
  const area = Object.assign(document.createElement("textarea"), { value: text });
  area.style.cssText = "position: fixed; opacity: 0";
  document.body.append(area);
  area.select();
  const done = document.execCommand("copy");
  area.remove();
  focused?.focus();
  return done;
}

/** Something that can be copied: its name in the menu, and the text. */
export interface Way {
  name: string;
  text: () => string;
}

/** A word of a shell. */
const quoted = (text: string) => `'${text.replaceAll("'", "'\\''")}'`;

export function curlGet(path: string, more = ""): string {
  return `curl -fsS ${quoted(location.origin + path)}${more && ` ${more}`}`;
}

export function curlSql(sql: string, parameters: Record<string, string>): string {
  return `curl -fsS ${quoted(`${location.origin}/api/sql`)} -H 'content-type: application/json' \\
  -d ${quoted(JSON.stringify({ sql, parameters }))}`;
}

export function pythonSql(sql: string, parameters: Record<string, string>): string {
  return `import json, urllib.request
question = {"sql": ${pythonText(sql)}, "parameters": ${JSON.stringify(parameters)}}
request = urllib.request.Request(${pythonText(`${location.origin}/api/sql`)}, json.dumps(question).encode(), {"content-type": "application/json"})
rows = json.load(urllib.request.urlopen(request))`;
}

/** A text as a literal of Python. JSON's is one. */
export const pythonText = (text: string) => JSON.stringify(text);

/** A text in Markdown that is no markup. */
export const markdownText = (text: string) => text.replace(/[\\`*_[\]<>#|]/g, "\\$&");
