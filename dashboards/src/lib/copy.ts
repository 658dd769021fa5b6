/** Text for the clipboard, and how programs ask for what a page shows. A token is named by `REEL_TOKEN`, never copied. */
import { token } from "./api";

/** Copies a text, and says what became of it. */
export async function copyNotice(text: string, done: string): Promise<string> {
  return (await copyText(text)) ? done : "The browser does not let this page copy.";
}

/** Copies a text; false where the browser does not let this page do so. */
async function copyText(text: string): Promise<boolean> {
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
export interface CopyFormat {
  name: string;
  text: () => string;
}

/** A word of a shell. */
export const quoted = (text: string) => `'${text.replaceAll("'", "'\\''")}'`;

export function curlGet(path: string, more = ""): string {
  return `curl -fsS${curlToken()} ${quoted(location.origin + path)}${more && ` ${more}`}`;
}

export function curlSql(sql: string, parameters: Record<string, string>): string {
  return `curl -fsS${curlToken()} ${quoted(`${location.origin}/api/sql`)} -H 'content-type: application/json' \\
  -d ${quoted(JSON.stringify({ sql, parameters }))}`;
}

const curlToken = () => (token.get() ? ' -H "authorization: Bearer $REEL_TOKEN"' : "");

/** A dictionary of headers in Python, and the modules that it needs. */
function pythonHeaders(headers: Record<string, string>): { modules: string; dictionary: string } {
  const parts = Object.entries(headers).map(([name, value]) => `${pythonText(name)}: ${pythonText(value)}`);
  const demanded = Boolean(token.get());
  if (demanded) parts.push(`"authorization": "Bearer " + os.environ["REEL_TOKEN"]`);
  return { modules: demanded ? "os, " : "", dictionary: `{${parts.join(", ")}}` };
}

/** Fetches a file of the service and writes it. */
export function pythonGet(path: string, file: string): string {
  const { modules, dictionary } = pythonHeaders({});
  return `import ${modules}urllib.request
request = urllib.request.Request(${pythonText(location.origin + path)}, headers=${dictionary})
with urllib.request.urlopen(request) as answer, open(${pythonText(file)}, "wb") as file:
    file.write(answer.read())`;
}

export function pythonSql(sql: string, parameters: Record<string, string>): string {
  const { modules, dictionary } = pythonHeaders({ "content-type": "application/json" });
  return `import json, ${modules}urllib.request
question = {"sql": ${pythonText(sql)}, "parameters": ${JSON.stringify(parameters)}}
request = urllib.request.Request(${pythonText(`${location.origin}/api/sql`)}, json.dumps(question).encode(), ${dictionary})
rows = json.load(urllib.request.urlopen(request))`;
}

/** A text as a literal of Python. JSON's is one. */
export const pythonText = (text: string) => JSON.stringify(text);

/** A text in Markdown that is no markup. */
export const markdownText = (text: string) => text.replace(/[\\`*_[\]<>#|]/g, "\\$&");
