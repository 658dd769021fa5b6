/** What the browser tests share: Chromium, pages whose console must stay silent, axe, questions in SQL. */
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";

const require = createRequire(`${process.env.PACKAGES}/package.json`);
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

export const url = process.env.URL;
/** How long anything may take: the machine may be busy. */
export const PATIENCE_MS = 30_000;

export function assert(condition, message) {
  if (!condition) throw new Error(message);
}

export async function launch() {
  return chromium.launch({
    executablePath: process.env.CHROMIUM,
    args: [
      "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync", "--force-color-profile=srgb",
    ],
  });
}

/** A page of its own profile; whatever its console complains of is in `complaints`. */
export async function opened(browser, { dark = false, width = 1440, height = 900 } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: dark ? "dark" : "light" });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const complaints = [];
  page.on("console", (message) => message.type() === "error" && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(String(error)));
  return { page, context, complaints };
}

/** Goes there, and waits until nothing is loaded any more. */
export async function visit(page, address) {
  await page.goto(url + address, { waitUntil: "networkidle" });
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
