// A page of `reel share` in Chromium, from disk and without a network: its verdict, its camera, another future, a changed file dropped on it;
// and how long the verdict takes beside the native build in the same run.

import { spawnSync } from "node:child_process";
import { readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

import { assert, launch, PATIENCE_MS, reel } from "./browser.mjs";

const { REEL, TRACES, WORK, FORM } = process.env;
const short = FORM === "--short";

const golden = readdirSync(TRACES).filter((name) => name.endsWith(".mcap")).sort().map((name) => join(TRACES, name));
const largest = golden.reduce((one, other) => (statSync(one).size > statSync(other).size ? one : other));
const shared = join(WORK, "episode.html");
reel("share", largest, "--player", "web/dist/player.html", "--out", shared);
const megabytes = statSync(shared).size / 1e6;
assert(megabytes < 4, `the page has ${megabytes} MB`);

const { browser, page, said } = await launch({ offline: true, viewport: { width: 1280, height: 900 } });

// How long the longest gap between two frames of the page was while it verified.
await page.addInitScript(() => {
  globalThis.gaps = [];
  let last = performance.now();
  const frame = (now) => {
    globalThis.gaps.push(now - last);
    last = now;
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
});
const badge = () => page.locator(".badge").textContent();
const done = () => page.waitForSelector(".badge:not(.running)");
const start = performance.now();
await page.goto(pathToFileURL(shared).href);
await page.waitForSelector(".badge");
const loaded = performance.now() - start;
await page.waitForFunction(() => document.querySelectorAll(".calls li.equal").length > 1 || document.querySelector(".badge:not(.running)"));
const first = performance.now() - start - loaded;
await done();
const whole = performance.now() - start - loaded;
assert((await badge()).startsWith("EXACT: "), await badge());
const gaps = await page.evaluate(() => globalThis.gaps.toSorted((a, b) => a - b));
const at = (share) => gaps[Math.floor(share * (gaps.length - 1))];

// What is drawn changes with the camera and with the call.
const drawn = () => page.locator("canvas").evaluate((canvas) => canvas.toDataURL());
const changes = async (what, act) => {
  const before = await drawn();
  await act();
  const end = performance.now() + PATIENCE_MS;
  while ((await drawn()) === before) {
    assert(performance.now() < end, `${what} draws nothing new`);
    await page.waitForTimeout(30);
  }
};
await changes("the camera from above", () => page.selectOption("select[aria-label=Camera]", "top-down"));
await changes("the free camera", () => page.selectOption("select[aria-label=Camera]", "free"));
await changes("an arrow key", () => page.locator("canvas").press("ArrowLeft"));
await changes("another call", () => page.locator(".calls li").nth(1).click());

// Another future: what the simulator says there is what `reel branch` plays.
const place = await page.locator("#places option").first().getAttribute("value");
await page.selectOption("select[aria-label=Tool]", "nav_to");
await page.fill("input[aria-label=Argument]", place);
await page.click("button[type=submit]");
await page.waitForSelector(".said li");
const outcome = await page.locator(".said li").first().textContent();
const call = JSON.stringify({ name: "nav_to", arguments: { receptacle_name: place } });
const branched = join(WORK, "branch.mcap");
reel("branch", largest, "--at", "1", "--call", call, "--out", branched);
const { steps } = JSON.parse(reel("show", "--json", branched).stdout);
assert(outcome.includes(steps[1].outcome.text), `the page says ${outcome}, and reel branch ${steps[1].outcome.text}`);
if (process.env.SCREENSHOT) await page.screenshot({ path: process.env.SCREENSHOT });

// A file with a changed byte, dropped on the page.
const bytes = readFileSync(largest);
bytes[bytes.length >> 1] ^= 4;
const changed = join(WORK, "changed.mcap");
writeFileSync(changed, bytes);
const native = JSON.parse(spawnSync(REEL, ["replay", "--json", changed], { encoding: "utf8" }).stdout);
assert(native.verdict === "refused", `natively it is ${native.verdict}`);
await page.setInputFiles(".drop input", changed);
await page.waitForSelector(".problem");
const problem = await page.locator(".problem").textContent();
assert(problem.replaceAll("changed.mcap", "") === native.reason.replaceAll(changed, "").replaceAll("changed.mcap", ""), `the page says ${problem}, and natively it is ${native.reason}`);

// Every trace through the page, beside the native build one at a time.
const some = short ? golden.filter((_, index) => index % 12 === 0) : golden;
let [inPage, natively] = [0, 0];
for (const path of some) {
  await page.setInputFiles(".drop input", path);
  await page.waitForSelector(".badge.running");
  await done();
  const text = await badge();
  assert(text.startsWith("EXACT: "), `${path}: ${text}`);
  inPage += Number(/executed again in ([0-9.]+) s/.exec(text)[1]);
  natively += reel("replay", "--jobs", "1", path).ms / 1000;
}

// On a phone the verdict is what one sees first, though the last call is shown.
await page.setViewportSize({ width: 390, height: 844 });
await page.goto(pathToFileURL(shared).href);
await page.reload();
await page.waitForSelector(".badge:not(.running)");
await page.waitForSelector(".calls li.current:last-child");
const view = await page.evaluate(() => [window.scrollY, document.documentElement.scrollWidth, document.querySelector(".calls").scrollTop > 0]);
assert(view[0] === 0 && view[1] <= 390 && view[2], `on a phone the page is scrolled by ${view[0]}, ${view[1]} wide, its list at the last call: ${view[2]}`);
assert(said.length === 0, said.join("\n"));
await browser.close();
console.log(
  `Chromium, offline, ${megabytes.toFixed(2)} MB: loaded in ${loaded.toFixed(0)} ms, first call compared ${first.toFixed(0)} ms later, verdict ${whole.toFixed(0)} ms later; ` +
    `frames of the page meanwhile: median ${at(0.5).toFixed(0)} ms, 95 % ${at(0.95).toFixed(0)} ms; ${some.length} traces exact in ${inPage.toFixed(1)} s, natively in ${natively.toFixed(1)} s: ${(inPage / natively).toFixed(2)} times`,
);
