/** What people do with work that goes on: jobs, training sets, live sessions and their questions. */
import { agent, assert, call, findings, onPage, sql, until, url, visit } from "./kit.mjs";

/** Rows of a training set as the model sees them, its card and what the linter says. */
export async function training_sets(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/datasets?set=first");
    await page.locator("article .turn").first().waitFor();
    await page.locator("article img").first().waitFor();
    await page.getByRole("link", { name: "Episode", exact: true }).first().click();
    await page.waitForURL(/\/episodes\/.*step=/);
    await page.goBack();
    await page.getByRole("button", { name: "Card" }).click();
    await page.locator("section.card h1, section.card h2, section.card h3").first().waitFor();
    await page.getByRole("button", { name: "Findings" }).click();
    await page.getByText(/Checking every row/).waitFor({ state: "detached" });
    assert(!(await page.locator("[role=alert]").count()), "the findings cannot be shown");
  });
}

/** Once the last job has ended, nothing is asked any more. */
export async function ended_jobs_are_not_asked_for(browser) {
  await onPage(browser, async (page) => {
    const job = (state) => ({ id: 1, state, created: 0, done: 0, total: 1, message: "", errors: [], report: [], work: { kind: "ingest", traces: [] } });
    let state = "running";
    let asked = 0;
    await page.route("**/api/jobs", (route) => {
      asked += 1;
      return route.fulfill({ json: [job(state)] });
    });
    await page.route("**/api/jobs/1", (route) => {
      state = "done";
      return route.fulfill({ json: job(state) });
    });
    await page.goto(`${url}/episodes`);
    await until(() => state === "done" && asked >= 2, "the end of the job");
    await page.waitForTimeout(2000);
    assert(asked === 2, `the list was asked for ${asked} times`);
  });
}

/** The next ingest of new traces takes the place of the last one in the list; a page that saw the last one can still ask how it ended. */
export async function a_superseded_job_can_be_asked_for(_browser, { trace, step }) {
  const jobs = async () => (await fetch(`${url}/api/jobs`)).json();
  const before = (await jobs()).map(({ id }) => id);
  const isNew = ({ id, work }) => work.kind === "ingest" && !before.includes(id);
  const ingested = async (not) => {
    const made = await fetch(`${url}/api/traces/${trace}/branches`, {
      method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ at: step, policy: "planner", name: `superseding-${Date.now()}` }),
    });
    assert(made.status === 201, await made.text());
    let job;
    await until(async () => (job = (await jobs()).find((job) => isNew(job) && job.id !== not && job.state === "done")), "the branch is ingested");
    return job.id;
  };
  const first = await ingested();
  await ingested(first);
  assert(!(await jobs()).some(({ id }) => id === first), "the last ingest is listed beside the next one");
  const answer = await fetch(`${url}/api/jobs/${first}`);
  assert(answer.status === 200 && (await answer.json()).state === "done", `${answer.status} for the last ingest`);
}

/** The drawer of jobs: from any page by mouse and key, with what runs and what ran, why it failed, and the same work again. */
export async function jobs_have_a_drawer(browser) {
  for (const dark of [false, true]) {
    await onPage(browser, async (page) => {
      const drawer = page.getByRole("dialog");
      const jobs = page.getByRole("button", { name: /^Jobs/ });
      await visit(page, "/episodes");
      await page.getByRole("checkbox", { name: /^Select/ }).nth(1).check();
      await page.getByRole("button", { name: "Verify" }).click();
      await page.getByRole("region", { name: /^Job \d+/ }).getByText("done", { exact: true }).waitFor();
      await visit(page, "/sql");
      await jobs.click();
      const first = drawer.getByRole("region").first();
      await first.getByText(/^\d+\. Replay of /).waitFor();
      const replays = drawer.getByText(/^\d+\. Replay of /);
      const before = await replays.count();
      await first.getByRole("button", { name: "Run again" }).click();
      await until(async () => (await replays.count()) > before, "the replay that runs again");
      await first.getByText("done", { exact: true }).waitFor();
      await first.getByText(/^Log: 1 report line/).click();
      await first.locator("pre", { hasText: "exact" }).waitFor();
      const found = await findings(page);
      assert(!found.length, found.join("; "));
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert(wider <= 0, `the page is ${wider} pixels wider than the window`);
      await page.keyboard.press("Escape");
      await drawer.waitFor({ state: "hidden" });
      assert(await jobs.evaluate((button) => button === document.activeElement), "the focus is not back on the button");
      await page.goto(`${url}/live`);
      await page.getByRole("heading", { name: "Live" }).waitFor();
      await page.keyboard.press("g");
      await page.keyboard.press("j");
      await drawer.waitFor();
    }, { dark, width: dark ? 390 : 1440 });
  }
}

/** While jobs wait, the header counts them on every page and the drawer stops them. */
export async function jobs_are_stopped(browser) {
  const started = [];
  for (let at = 0; at < 3; at += 1) {
    const answer = await fetch(`${url}/api/jobs`, {
      method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ kind: "replay" }),
    });
    started.push((await answer.json()).id);
  }
  await onPage(browser, async (page) => {
    await page.goto(`${url}/failures`);
    await page.getByRole("button", { name: /^Jobs [123] running/ }).click();
    const last = page.getByRole("dialog").getByRole("region", { name: `Job ${started[2]}` });
    await last.getByRole("button", { name: "Stop" }).click();
    await last.getByText("cancelled", { exact: true }).waitFor();
    await page.getByRole("button", { name: "Jobs", exact: true, includeHidden: true }).waitFor({ state: "attached" });
  });
}

/** An export that fails says why in one sentence and keeps its form, also for whoever comes by the drawer. */
export async function a_failed_export_keeps_its_form(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/datasets?new=1");
    const where = page.getByLabel(/^Only episodes where/);
    await page.getByLabel("Name").fill("kitchen_1");
    await where.fill("nosuch = 1");
    await page.getByRole("button", { name: "Start the export" }).click();
    const job = page.locator("main").getByRole("region", { name: /^Job \d+/ });
    await job.getByText("No field named nosuch.").waitFor();
    const said = await job.innerText();
    assert(!said.includes("Valid fields are") && !said.includes("exited with"), `a dump: ${said}`);
    assert((await where.inputValue()) === "nosuch = 1", "the form has lost the condition");
    await visit(page, "/");
    await page.getByRole("button", { name: /^Jobs/ }).click();
    await page.getByRole("dialog").getByRole("link", { name: "Change …" }).first().click();
    await page.getByRole("dialog").waitFor({ state: "hidden" });
    await page.waitForURL(/\/datasets\?new=1&from=\d+&job=\d+/);
    assert((await where.inputValue()) === "nosuch = 1", "the form does not begin from the job that failed");
    assert((await page.getByLabel("Name").inputValue()) === "kitchen_1", "the form has lost the name");
  });
}

/** Pairs of failed and repaired episodes are exported with the options that they have. */
export async function preferences_are_exported(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/datasets?new=1");
    await page.getByLabel("Name").fill("corrected");
    await page.locator("form").getByLabel(/^Of /).selectOption("preferences");
    await page.getByLabel(/^Only episodes where/).fill("family = 'SUL'");
    await until(async () => (await page.locator("form").getByLabel(/^Format/).count()) === 0, "a form without a format");
    await page.getByRole("button", { name: "Start the export" }).click();
    const job = page.locator("main").getByRole("region", { name: /^Job \d+/ });
    await job.getByText("done", { exact: true }).waitFor();
    const [{ failed }] = await sql("SELECT count(*) AS failed FROM episodes WHERE NOT success AND family = 'SUL'");
    const { report } = (await (await fetch(`${url}/api/jobs`)).json()).find(({ work }) => work.name === "corrected");
    assert(report.at(-1).failed === failed, `${JSON.stringify(report)} of ${failed} failed episodes of SUL`);
    // The new set shows its pairs, and can be checked.
    const rejected = page.locator("article").first().locator(".turn", { hasText: "rejected" });
    await rejected.waitFor();
    await page.getByText(/^2 rows · /).waitFor();
    await page.getByRole("button", { name: "Findings" }).click();
    await page.getByText(/Checking every row/).waitFor({ state: "detached" });
    assert(!(await page.locator("[role=alert]").count()), "the findings cannot be shown");
  });
}

/** A job that left something out is done, with a note; only the service's answer is made here. */
export async function a_job_tells_what_it_left_out(browser) {
  await onPage(browser, async (page) => {
    const errors = ["reel: t1 is not in the archive; it was left out", "reel: t2 is not in the archive; it was left out"];
    await page.route("**/api/jobs", (route) => route.fulfill({ json: [{
      id: 1, work: { kind: "replay", traces: ["t1", "t2", "t3"] }, state: "done", done: 1, total: 1, message: "replay",
      report: [{ verdict: "exact", trace: "traces/t3.mcap" }], errors, created: 1_700_000_000,
    }] }));
    await visit(page, "/datasets");
    await page.getByRole("button", { name: /^Jobs/ }).click();
    await page.getByRole("dialog").getByText("Done, with 2 notes: t1 is not in the archive; it was left out").waitFor();
  });
}

/** An agent plays; its image is seen, and its question answered by the person who watches. */
export async function a_person_answers_an_agent(browser) {
  const session = await agent();
  try {
    await call(session, "finish", {});
    await onPage(browser, async (page) => {
      await visit(page, "/live").catch(() => {});
      await page.locator("article img").first().waitFor();
      await call(session, "nav_to", { receptacle_name: "nowhere" });
      const asking = call(session, "ask", { question: "Which one do you mean?" });
      await page.getByText("Which one do you mean?").waitFor();
      await page.getByText("The robot does not know.").waitFor();
      await page.getByText("nav_to(nowhere)").first().waitFor();
      await page.getByAltText(/What the robot of/).waitFor();
      await page.getByPlaceholder("In plain words").fill("The red one.");
      await page.getByRole("button", { name: "Answer" }).click();
      const said = JSON.stringify(await asking);
      assert(said.includes("The red one."), said.slice(0, 300));
      await page.getByText("Which one do you mean?").waitFor({ state: "detached" });
    });
  } finally {
    await session.close();
  }
}

/** A question is counted on every page and in the title, sounds where that was turned on, and shows what led to it. */
export async function a_waiting_question_is_seen_everywhere(browser) {
  const session = await agent();
  const thought = { "reel/policy": { reasoning: "Two cups fit the words." } };
  try {
    await call(session, "finish", {});
    await onPage(browser, async (page) => {
      await page.addInitScript(() => {
        window.tones = 0;
        const start = OscillatorNode.prototype.start;
        OscillatorNode.prototype.start = function (...given) {
          window.tones += 1;
          start.apply(this, given);
        };
      });
      await page.goto(`${url}/live`);
      const sound = page.getByLabel("Sound when a question waits");
      assert(!(await sound.isChecked()), "the sound is on before anybody wanted it");
      await sound.check();
      await page.goto(`${url}/sql`);
      await page.getByRole("heading", { name: "SQL" }).waitFor();
      assert(!(await page.title()).startsWith("("), "a question is counted before there is one");
      await session.send("tools/call", { name: "nav_to", arguments: { receptacle_name: "nowhere" }, _meta: thought });
      const asking = call(session, "ask", { question: "The left cup or the right cup?" });
      asking.catch(() => {});
      const nav = page.getByRole("link", { name: /^Live 1 question waits/ });
      await nav.waitFor();
      await until(async () => /^\(1\) SQL/.test(await page.title()), "the number in the title");
      assert((await page.evaluate(() => window.tones)) === 1, "no tone, or more than one");
      await nav.click();
      await page.getByText("Its latest reasoning: Two cups fit the words.").waitFor();
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert(wider <= 0, `the page is ${wider} pixels wider than the window`);
      const card = page.locator("article.card").filter({ hasText: "waits for an answer" });
      await card.getByText("nav_to(nowhere)").waitFor();
      const task = await page.locator("dd").first().innerText();
      await card.getByText(task).waitFor();
      await card.getByRole("link").first().click();
      await page.waitForURL(/\/live\/./);
      const followed = page.url();
      await page.getByPlaceholder("In plain words").fill("The left one.");
      await page.getByRole("button", { name: "Answer" }).click();
      await asking;
      await until(async () => !(await page.title()).startsWith("("), "a title without a number");
      await page.goto(followed);
      await page.getByAltText(/What the agent of .* after 2 steps/).waitFor();
      // What it called is there while it plays on, and its next call comes by itself.
      const calls = page.getByRole("region", { name: "Calls", exact: true });
      await calls.getByText("nav_to(nowhere)").waitFor();
      await calls.getByText("The left one.").waitFor();
      await call(session, "nav_to", { receptacle_name: "elsewhere" });
      await calls.getByText("nav_to(elsewhere)").waitFor();
      const found = await findings(page);
      assert(!found.length, found.join("; "));
      await call(session, "finish", {});
      await page.getByText(/in episode 2/).waitFor();
      await page.getByRole("region", { name: "Finished episodes" }).getByRole("link").first().click();
      await page.waitForURL(/\/episodes\/./);
      await page.getByText("nav_to(receptacle_name=nowhere)").first().waitFor();
      await page.goBack();
      await page.getByAltText(/What the agent of/).waitFor();
      await session.close();
      await page.getByText("The session is closed.").waitFor();
    }, { dark: true, width: 390 });
  } finally {
    await session.close();
  }
}
