// Pages with the player in them: an example in the page of `reel report`, from disk and without a network, and a row of `reel leaderboard`,
// from a server of files.

import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { copyFileSync, mkdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

import { assert, launch, reel, reelEnds } from "./browser.mjs";

const { WORK } = process.env;
const player = ["--player", "web/dist/player.html"];
const at = (...path) => join(WORK, ...path);

reel("task", "generate", "--count", "2", "--seed", "7", "--out", at("tasks"));
for (const agent of ["oracle", "wrong-object"]) reel("bench", "--tasks", at("tasks"), "--agent", agent, "--no-images", "--out", at("bench", agent));
reel("ingest", at("bench"), "--store", at("store"));
reel("taxonomy", "--store", at("store"));
reel("report", "--store", at("store"), ...player, "--out", at("report.html"));

const report = await launch({ offline: true, viewport: { width: 1280, height: 1000 } });
await report.page.goto(pathToFileURL(at("report.html")).href);
const buttons = report.page.locator("button[data-episode]");
const examples = await buttons.count();
assert(examples > 0, "the report has no example to execute");
await buttons.first().click();
const frame = report.page.frameLocator("iframe");
const verdict = await frame.locator(".badge:not(.running)").textContent();
assert(verdict.startsWith("EXACT: "), `the example is ${verdict}`);
const article = await report.page.locator("article.open").textContent();
const step = /step ([0-9]+):/.exec(article)[1];
const shown = await frame.locator("input[type=range]").inputValue();
assert(shown === step, `the example is shown after ${shown} calls, and its decisive step is ${step}`);
if (process.env.SCREENSHOTS) await report.page.screenshot({ path: join(process.env.SCREENSHOTS, "report.png"), fullPage: true });
assert(report.said.length === 0, report.said.join("\n"));
await report.browser.close();
reel("report", "--store", at("store"), "--no-player", "--out", at("plain.html"));
assert(!readFileSync(at("plain.html"), "utf8").includes("<script"), "a report without the player has no script");

mkdirSync(at("submissions"));
for (const agent of ["oracle", "wrong-object"]) reel("bundle", at("bench", agent), "--tasks", at("tasks"), "--out", at("submissions", `${agent}.reel`));
copyFileSync(at("submissions", "oracle.reel"), at("submissions", "copy.reel"));
// A copy is listed with its reason, and is no second row.
const ranked = reelEnds(3, "leaderboard", at("submissions"), "--tasks", at("tasks"), ...player, "--out", at("site")).stdout;
assert(ranked.includes("2 of 3 bundles ranked"), ranked);

const server = createServer(async (request, response) => {
  const path = decodeURIComponent(new URL(request.url, "http://localhost").pathname);
  try {
    const content = await readFile(at("site", path === "/" ? "index.html" : path));
    response.writeHead(200, { "content-type": path.endsWith(".html") || path === "/" ? "text/html" : "application/octet-stream" }).end(content);
  } catch {
    response.writeHead(path === "/favicon.ico" ? 204 : 404).end();
  }
}).listen(0, "127.0.0.1");
await new Promise((resolve) => server.once("listening", resolve));
const origin = `http://127.0.0.1:${server.address().port}/`;
const site = await launch({ viewport: { width: 1280, height: 900 } }, origin);
await site.page.goto(origin);
const first = site.page.locator("a[href*='.reel']").first();
assert((await first.getAttribute("href")).includes("#"), "a row opens the player with the bundle");
if (process.env.SCREENSHOTS) await site.page.screenshot({ path: join(process.env.SCREENSHOTS, "leaderboard.png"), fullPage: true });
await first.click();
await site.page.waitForSelector(".badge.exact, .badge.refused");
const claim = await site.page.locator(".badge").first().textContent();
assert(claim.startsWith("HOLDS"), `the first row says ${claim}`);
await site.page.getByText("not signed", { exact: true }).waitFor();
await site.page.locator("button.link").first().click();
await site.page.waitForSelector("canvas");
await site.page.waitForSelector(".badge.exact");
if (process.env.SCREENSHOTS) await site.page.screenshot({ path: join(process.env.SCREENSHOTS, "row.png") });
assert(site.said.length === 0, site.said.join("\n"));
await site.browser.close();
server.close();
console.log(`report: 1 of ${examples} examples executed at its step ${step}; leaderboard: a row holds in the tab, and an episode of it is exact`);
