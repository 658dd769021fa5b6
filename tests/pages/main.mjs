/** The web pages in Chromium: `main.mjs [NAME...]`, `main.mjs --short` or `main.mjs --screenshots DIR`. See run.sh. */
import { mkdirSync } from "node:fs";
import { findings, launch, opened, sql, traceName, url, visit } from "./kit.mjs";
import * as beside from "./beside.mjs";
import * as claims from "./claims.mjs";
import * as drive from "./drive.mjs";
import * as episodes from "./episodes.mjs";
import * as failures from "./failures.mjs";
import * as foreign from "./foreign.mjs";
import * as live from "./live.mjs";
import * as orbit from "./orbit.mjs";
import * as remarks from "./remarks.mjs";
import * as review from "./review.mjs";
import * as sqlTests from "./sql.mjs";
import * as strip from "./strip.mjs";

/** The short form: every page once, and the shortest test of each thing that people do on them. */
const SHORT = [
  "a_person_answers_an_agent", "a_question_becomes_a_panel", "a_replay_leaves_its_verdict", "a_selection_is_exported", "an_empty_store_is_told",
  "attribution_from_job_to_branch", "claim_from_a_condition_to_its_episodes", "drive_by_clicking_and_hand_back", "foreign_episodes_are_told", "labels_persist", "odd_traces_are_told",
  "page_", "sankey_to_decisive_step", "stepping", "what_if_succeeds",
];

const index = await (await fetch(`${url}/`, { headers: { accept: "text/html" } })).text();
if (!index.includes('id="app"')) {
  console.log("skipped: npm: the web pages in a browser, because this build has none (make pages)");
  process.exit(0);
}

const [failed] = await sql("SELECT e.trace, b.step AS decisive_step FROM episodes e JOIN blame b USING (episode_id) WHERE b.step IS NOT NULL AND NOT e.success ORDER BY 1 LIMIT 1");
const trace = traceName(failed.trace);
const addresses = {
  overview: "/", episodes: "/episodes", episode: `/episodes/${trace}?step=${failed.decisive_step}`, failures: "/failures",
  scene: `/episodes/${trace}?step=${failed.decisive_step}&camera=3d`, comments: `/episodes/${trace}?step=${failed.decisive_step}&comments=1`,
  compare: "/compare?a=oracle&b=planner", confusions: "/failures?tab=confusions", panels: "/panels?page=behaviour", sql: "/sql?q=SELECT+family%2C+count(*)+AS+n+FROM+episodes+GROUP+BY+family",
  claims: "/claims", attribution: "/failures?tab=attribution", datasets: "/datasets", live: "/live",
};

const browser = await launch();
let bad = 0;
if (process.argv[2] === "--screenshots") {
  const folder = process.argv[3] ?? "screenshots";
  mkdirSync(folder, { recursive: true });
  for (const [name, address] of Object.entries(addresses)) {
    for (const dark of [false, true]) {
      for (const width of [1440, 1024, 390]) {
        const { page, context } = await opened(browser, { dark, width });
        await visit(page, address);
        await page.waitForTimeout(1500);
        await page.screenshot({ path: `${folder}/${name}-${dark ? "dark" : "light"}-${width}.png` });
        await context.close();
      }
    }
  }
} else {
  const short = process.argv[2] === "--short";
  const wanted = short ? SHORT : process.argv.slice(2);
  const all = { ...beside, ...episodes, ...failures, ...foreign, ...live, ...orbit, ...remarks, ...review, ...sqlTests, ...claims, ...drive, ...strip };
  for (const [name, address] of Object.entries(addresses)) {
    all[`page_${name}`] = async (browser) => {
      for (const dark of short ? [false] : [false, true]) {
        const { page, context, complaints, answers } = await opened(browser, { dark, width: dark ? 1024 : 1440 });
        await visit(page, address);
        const heading = await page.locator("main h1").first().innerText();
        const found = [...complaints, ...(complaints.length ? answers : []), ...(await findings(page))];
        const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        if (wider > 0) found.push(`the page is ${wider} pixels wider than the window`);
        await context.close();
        if (!heading.trim() || found.length) throw new Error(`${address}: "${heading}" ${found.join("\n  ")}`);
      }
    };
  }
  for (const name of wanted) {
    if (!Object.keys(all).some((other) => other.startsWith(name))) throw new Error(`no test begins with ${name}`);
  }
  for (const [name, test] of Object.entries(all)) {
    if (wanted.length && !wanted.some((begin) => name.startsWith(begin))) continue;
    const begun = performance.now();
    try {
      await test(browser, { trace, step: failed.decisive_step });
      console.log(`ok ${name} (${((performance.now() - begun) / 1000).toFixed(1)} s)`);
    } catch (error) {
      bad += 1;
      console.log(`FAILED ${name}: ${error.message.split("\n").slice(0, 8).join("\n  ")}`);
    }
  }
}
await browser.close();
process.exit(bad ? 1 : 0);
