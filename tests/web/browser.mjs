// Chromium and the binary, for the checks beside this file.

import { spawnSync } from "node:child_process";
import { createRequire } from "node:module";

const { REEL, CHROMIUM, PACKAGES } = process.env;
export const PATIENCE_MS = Number(process.env.PATIENCE_MS ?? 120_000);

export function assert(condition, message) {
  if (!condition) throw new Error(message);
}

/** Runs a command that has to succeed; gives what it printed and how long it took. */
export const reel = (...args) => reelEnds(0, ...args);

/** Runs a command that has to end with this exit code. */
export function reelEnds(code, ...args) {
  const start = performance.now();
  const ran = spawnSync(REEL, args, { encoding: "utf8" });
  assert(ran.status === code, `reel ${args.join(" ")}: exit code ${ran.status}\n${ran.stderr}`);
  return { stdout: ran.stdout, ms: performance.now() - start };
}

/** A page in Chromium. \`said\` has what it printed, its errors, and what it asked for beyond itself and \`origin\`. */
export async function launch(options, origin) {
  const { chromium } = createRequire(`${PACKAGES}/package.json`)("playwright-core");
  const browser = await chromium.launch({
    executablePath: CHROMIUM,
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"],
  });
  const context = await browser.newContext(options);
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const said = [];
  page.on("console", (message) => said.push(message.text()));
  page.on("pageerror", (error) => said.push(error.message));
  page.on("request", (request) => {
    const own = /^(file|blob|data|about):/.test(request.url()) || (origin && request.url().startsWith(origin));
    if (!own) said.push(`asked for ${request.url()}`);
  });
  return { browser, page, said };
}
