/** What the browser tests share: Chromium, pages whose console must stay silent, axe, questions in SQL. */
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";

const require = createRequire(`${process.env.PACKAGES}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

/** The server with recorded episodes, one with nothing, and one with episodes of other worlds. */
export const url = process.env.URL;
export const emptyUrl = process.env.EMPTY_URL;
export const foreignUrl = process.env.FOREIGN_URL;
/** How long anything may take: the machine may be busy. */
export const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 120_000);

export function assert(condition, message) {
  if (!condition) throw new Error(message);
}

/** Waits until something holds. */
export async function until(holds, what) {
  const end = performance.now() + PATIENCE_MS;
  while (!(await holds())) {
    assert(performance.now() < end, `waited in vain for ${what}`);
    await new Promise((go) => setTimeout(go, 50));
  }
}

export async function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM,
    args: [
      // Software draws WebGL, for Rerun.
      "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync", "--force-color-profile=srgb",
    ],
  });
}

/** A page of its own profile; whatever its console complains of is in `complaints`, and the answers that refused something in `answers`. */
export async function opened(browser, { dark = false, width = 1440, height = 900 } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: dark ? "dark" : "light" });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  // The console does not say what the service answered.
  const answers = [];
  page.on("response", async (answer) => {
    if (answer.status() < 400) return;
    const text = await answer.text().catch(() => "");
    answers.push(`${answer.status()} ${answer.url()} ${(answer.request().postData() ?? "").slice(0, 300)}: ${text.slice(0, 300)}`);
  });
  return { page, context, complaints, answers };
}

/** Goes there, and waits until nothing is loaded any more. */
export async function visit(page, address) {
  await page.goto(url + address, { waitUntil: "networkidle" });
}

/** Runs something on a page of its own whose console stays silent but for what is expected there. */
export async function onPage(browser, work, { expected = [], ...options } = {}) {
  const { page, context, complaints, answers } = await opened(browser, options);
  try {
    await work(page);
    const others = complaints.filter((text) => !expected.some((one) => text.includes(one)));
    assert(!others.length, `the console complains: ${others.join(" | ")} ${answers.join(" | ")}`);
  } finally {
    await context.close();
  }
}

/** Serious findings of axe, in a line each. */
export async function findings(page) {
  // The page's own policy lets no foreign script in, and a test's is one.
  await page.evaluate(axe);
  const found = await page.evaluate(() => window.axe.run(document, { resultTypes: ["violations"] }));
  return found.violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map((node) => node.target.join(" ")).join(" | ")}`);
}

export async function sql(text) {
  const answer = await fetch(`${url}/api/sql`, {
    method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ sql: text }),
  });
  assert(answer.ok, `${text}: ${await answer.clone().text()}`);
  return answer.json();
}

/** A name of a trace, from the path that the tables tell. */
export const traceName = (path) => path.replace(/^.*\//, "").replace(/\.mcap$/, "");

/** An agent that plays: MCP over Streamable HTTP, in as few words as it takes. */
export async function agent() {
  const headers = { "content-type": "application/json", accept: "application/json, text/event-stream" };
  let id = 0;
  const send = async (method, params, notify = false) => {
    const body = { jsonrpc: "2.0", method, params, ...(notify ? {} : { id: (id += 1) }) };
    const answer = await fetch(`${url}/mcp`, { method: "POST", headers, body: JSON.stringify(body) });
    const text = await answer.text();
    assert(answer.ok, `${method}: ${answer.status} ${text}`);
    headers["mcp-session-id"] ??= answer.headers.get("mcp-session-id");
    if (notify) return null;
    const last = text.startsWith("{") ? text : text.split("\n").filter((line) => line.startsWith("data: {")).at(-1).slice(6);
    return JSON.parse(last).result;
  };
  await send("initialize", { protocolVersion: "2025-06-18", capabilities: {}, clientInfo: { name: "watched", version: "1" } });
  await send("notifications/initialized", {}, true);
  return { send, close: () => fetch(`${url}/mcp`, { method: "DELETE", headers }) };
}

export const call = (agent, name, given) => agent.send("tools/call", { name, arguments: given });

/** What the address chooses. */
export const parameter = (page, name) => new URL(page.url()).searchParams.get(name);

/** The moment that the clock of an episode's page shows. */
export const moment = (page) => page.locator("output").first().innerText();
