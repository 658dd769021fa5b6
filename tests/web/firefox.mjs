// The player in Firefox, from disk: a shared page, and every trace through the page without an episode.

import { createRequire } from "node:module";
import { readdirSync } from "node:fs";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

import { assert, PATIENCE_MS, reel } from "./browser.mjs";

const { TRACES, WORK, FORM, FIREFOX, PUPPETEER } = process.env;
const puppeteer = createRequire(`${PUPPETEER}/package.json`)("puppeteer-core");
const traces = readdirSync(TRACES).filter((name) => name.endsWith(".mcap")).sort().map((name) => resolve(TRACES, name));
const shared = join(WORK, "episode.html");
reel("share", traces[0], "--player", "web/dist/player.html", "--out", shared);

const browser = await puppeteer.launch({ browser: "firefox", executablePath: FIREFOX, headless: true });
const page = await browser.newPage();
page.setDefaultTimeout(PATIENCE_MS);
const said = [];
page.on("console", (message) => said.push(message.text()));
page.on("pageerror", (error) => said.push(error.message));
/** The verdict that comes next: the badge is marked once it was read. */
const verdict = async () => {
  await page.waitForSelector(".badge:not(.running):not(.read)");
  return page.$eval(".badge", (badge) => {
    badge.classList.add("read");
    return badge.textContent;
  });
};
const start = performance.now();
await page.goto(pathToFileURL(shared).href);
const first = await verdict();
assert(first.startsWith("EXACT: "), `the shared page says ${first}`);
const whole = performance.now() - start;

const some = FORM === "--short" ? traces.filter((_, index) => index % 12 === 0) : traces;
const input = await page.$(".drop input");
for (const path of some) {
  await input.uploadFile(path);
  const text = await verdict();
  assert(text.startsWith("EXACT: "), `${path}: ${text}`);
}
const version = await browser.version();
await browser.close();
assert(said.length === 0, said.join("\n"));
console.log(`${version}: the shared page's verdict ${whole.toFixed(0)} ms after its address was entered; ${some.length} traces exact`);
