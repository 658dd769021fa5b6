/** What people do with the pages: each a way from a question to its answer, in a real browser. */
import {
  PATIENCE_MS, agent, assert, call, emptyUrl, findings, opened, sql, traceName, url, until, visit,
} from "./kit.mjs";

/** Runs something on a page of its own whose console stays silent but for what is expected there. */
async function onPage(browser, work, { expected = [], ...options } = {}) {
  const { page, context, complaints } = await opened(browser, options);
  try {
    await work(page);
    const others = complaints.filter((text) => !expected.some((one) => text.includes(one)));
    assert(!others.length, `the console complains: ${others.join(" | ")}`);
  } finally {
    await context.close();
  }
}
const parameter = (page, name) => new URL(page.url()).searchParams.get(name);
const moment = (page) => page.locator("output").first().innerText();

/** From a flow of the Sankey to the decisive step of an episode of it: two clicks. */
export async function sankey_to_decisive_step(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/failures");
    const canvas = page.locator("[role=img] canvas").first();
    await canvas.waitFor();
    const { width, height } = await canvas.boundingBox();
    // The sub-classes stand in the right-most column, from top to bottom; the label beside them is 150 wide.
    for (let y = 20; y < height && !parameter(page, "sub_class"); y += 12) {
      await canvas.click({ position: { x: width - 156, y } });
    }
    const sub = parameter(page, "sub_class");
    assert(sub, "no click on the Sankey chose a sub-class");
    const link = page.locator("[aria-busy=false] a.open").first();
    await link.click();
    await page.waitForURL(/\/episodes\/.*step=/);
    const step = Number(parameter(page, "step"));
    await page.locator(`button[aria-current=step]:has-text("decisive step")`).waitFor();
    assert((await moment(page)).startsWith(`step ${step}`), `the clock shows ${await moment(page)}, not step ${step}`);
    const [row] = await sql(`SELECT c.sub_class, b.step FROM episodes e JOIN classes c USING (episode_id) JOIN blame b USING (episode_id)
      WHERE e.trace LIKE '%/${new URL(page.url()).pathname.split("/").pop()}.mcap'`);
    assert(row.step === step && row.sub_class === sub, `the tables say step ${row.step}, ${row.sub_class}`);
  });
}

/** The keyboard moves one clock, and everything with it. */
export async function stepping(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    const asked = [];
    page.on("request", (request) => asked.push(request.url().slice(url.length)));
    await visit(page, `/episodes/${trace}`);
    const image = page.locator(".view img").first();
    await image.waitFor();
    // What was asked while the page came is not asked again.
    const ofTrace = asked.filter((path) => path.startsWith(`/api/traces/${trace}/`));
    assert(ofTrace.length >= 5 && new Set(ofTrace).size === ofTrace.length, ofTrace.join(" "));
    const shown = () => image.getAttribute("src");
    const first = await shown();
    assert((await moment(page)).startsWith("start"), await moment(page));
    await page.keyboard.press("ArrowRight");
    await page.keyboard.press("j");
    await until(async () => (await moment(page)).startsWith("step 1"), "two steps on is step 1");
    await until(async () => (await shown()) !== first, "another image");
    assert(parameter(page, "step") === "1", page.url());
    await page.keyboard.press("k");
    await until(async () => (await moment(page)).startsWith("step 0"), "one step back");
    await page.keyboard.press("d");
    await until(async () => (await moment(page)).startsWith(`step ${step} `) || (await moment(page)).startsWith(`step ${step}\u00a0`), "the decisive step");
    await page.keyboard.press("End");
    const steps = (await (await fetch(`${url}/api/traces/${trace}/episode`)).json()).steps;
    await until(async () => (await moment(page)).startsWith(`step ${steps - 1}`), "the last step");
    await page.keyboard.press("Home");
    await until(async () => (await moment(page)).startsWith("start"), "the start again");
    // Another camera draws another image of the same moment.
    const head = await shown();
    await page.keyboard.press("4");
    await until(async () => (await shown()) !== head, "the free camera's image");
    assert(parameter(page, "camera") === "free" && parameter(page, "eye"), page.url());
    const before = await shown();
    const box = await page.locator(".view").first().boundingBox();
    await page.mouse.move(box.x + 100, box.y + 100);
    await page.mouse.down();
    await page.mouse.move(box.x + 220, box.y + 120, { steps: 5 });
    await page.mouse.up();
    await until(async () => (await shown()) !== before, "an image from elsewhere");
  });
}

/** The same moment in Rerun's web viewer. */
export async function rerun_opens_at_the_moment(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${step}`);
    const [viewer] = await Promise.all([page.waitForEvent("popup"), page.getByRole("link", { name: "Open in Rerun" }).click()]);
    const shows = () => viewer.evaluate(() => Number(document.documentElement.dataset.step)).catch(() => null);
    await until(async () => (await shows()) === step, `step ${step} in Rerun`);
    assert((await viewer.title()).startsWith(trace), await viewer.title());
  });
}

/** The better call at the decisive step, then the planner: another future, side by side, and it succeeds. */
export async function what_if_succeeds(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${step}`);
    await page.getByRole("button", { name: "What if …" }).click();
    await page.getByRole("button", { name: /^Better:/ }).click();
    await page.getByRole("button", { name: "Play this future" }).click();
    await page.getByRole("heading", { name: "Branch" }).waitFor();
    await page.locator("text=✓ success").first().waitFor();
    const branch = parameter(page, "branch");
    const verdict = await (await fetch(`${url}/api/traces/${branch}/replay`, { method: "POST" })).json();
    assert(verdict.exact, `the branch does not replay: ${JSON.stringify(verdict)}`);
    const episode = await (await fetch(`${url}/api/traces/${branch}/episode`)).json();
    assert(episode.end.metrics.success && episode.header.parent.call === step, JSON.stringify(episode.end.metrics));
    assert((await page.locator(".view img").count()) === 2, "two images side by side");
  });
}

/** A label given by keys is in the tables, and there when the page comes back. */
export async function labels_persist(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/failures?tab=label");
    await page.getByLabel("Your name").fill("Ada");
    await page.getByRole("button", { name: "Begin" }).click();
    await page.getByRole("heading", { name: "Why did it fail?" }).waitFor();
    await page.keyboard.press("2");
    await page.keyboard.press("b");
    await page.keyboard.press("Enter");
    await until(async () => (await sql("SELECT class FROM labels WHERE author = 'Ada'")).length === 1, "the label in the tables");
    const [kept] = await sql("SELECT episode_id, class, sub_class FROM labels WHERE author = 'Ada'");
    await visit(page, `/failures?tab=label&episode=${kept.episode_id}`);
    await page.locator(".tag", { hasText: "labelled" }).waitFor();
    const chosen = await page.locator("button[aria-pressed=true]").allInnerTexts();
    assert(chosen.some((text) => text.includes(kept.class)), `${chosen} does not show ${kept.class}`);
    await page.getByText(/Ada/).first().waitFor();
  });
}

/** A question that cannot be asked is told where; one that can is drawn. */
export async function sql_errors_are_told(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/sql");
    const editor = page.locator("textarea");
    await editor.fill("SELECT policy, count(*) AS n\nFROM episodes\nGROUP BY polcy");
    await page.keyboard.press("Control+Enter");
    const alert = page.locator("[role=alert]");
    await alert.waitFor();
    assert(/polcy/.test(await alert.innerText()), await alert.innerText());
    await page.getByRole("button", { name: /Line 3, column 10/ }).click();
    const picked = await editor.evaluate((it) => it.value.slice(it.selectionStart, it.selectionEnd));
    assert(picked === "polcy", `'${picked}' is selected`);
    await page.keyboard.type("policy");
    await page.keyboard.press("Control+Enter");
    await page.locator("table tbody tr").first().waitFor();
    const count = (await sql("SELECT DISTINCT policy FROM episodes")).length;
    await until(async () => (await page.locator("table tbody tr").count()) === count, `${count} rows`);
    await page.getByRole("button", { name: "bar" }).click();
    await page.locator("[role=img] canvas").waitFor();
    await editor.fill("DROP TABLE episodes");
    await page.keyboard.press("Control+Enter");
    await until(async () => /only questions are allowed/.test((await alert.allInnerTexts()).join()), "that tables are only read");
  }, { expected: ["422"] });
}

/** A question becomes a panel on a page of the dashboards, which a reload still shows. */
export async function a_question_becomes_a_panel(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/sql?q=SELECT+family%2C+count(*)+AS+n+FROM+episodes+GROUP+BY+family&as=bar");
    await page.getByRole("button", { name: "Save as a panel…" }).click();
    await page.getByLabel("Title").fill("Episodes by family");
    await page.getByLabel("on page").selectOption("tasks");
    await page.getByRole("button", { name: /Save episodes-by-family/ }).click();
    await page.getByRole("link", { name: "look at it" }).click();
    await page.getByRole("region", { name: "Episodes by family" }).waitFor();
    await visit(page, "/panels?panel=episodes-by-family");
    await page.getByRole("region", { name: "Episodes by family" }).locator("canvas").waitFor();
    await page.getByRole("button", { name: "Delete this panel" }).click();
    await until(async () => !(await (await fetch(`${url}/api/definitions`)).text()).includes("episodes-by-family\",\"builtin\""), "that it is gone");
    // The page says what it misses, and its copy goes, too.
    await visit(page, "/panels?page=tasks");
    await page.getByText("there is none").waitFor();
    await page.getByRole("button", { name: "Delete this page" }).click();
    await page.getByText("there is none").waitFor({ state: "detached" });
  });
}

/** Filters, order and selection of columns come back with the link. */
export async function a_shared_link_restores_the_view(browser, { trace, step }) {
  let address;
  let rows;
  const shown = (page) => page.locator("table tbody tr").allInnerTexts();
  await onPage(browser, async (page) => {
    await visit(page, "/episodes");
    await page.locator("table tbody tr").first().waitFor();
    await page.getByLabel("WHERE").fill("length > 3");
    await page.keyboard.press("Enter");
    await page.locator("button.sort", { hasText: /steps|length/i }).first().click();
    await page.waitForLoadState("networkidle");
    await page.getByText("failure", { exact: true }).first().click();
    await page.waitForLoadState("networkidle");
    await until(async () => !(await page.locator("[aria-busy=true]").count()), "the rows");
    address = new URL(page.url()).pathname + new URL(page.url()).search;
    rows = await shown(page);
    assert(rows.length && /where=/.test(address) && /sort=/.test(address), address);
  });
  await onPage(browser, async (page) => {
    await visit(page, address);
    await page.locator("table tbody tr").first().waitFor();
    const again = await shown(page);
    assert(JSON.stringify(again) === JSON.stringify(rows), `${again.length} rows, not the ${rows.length} of before`);
    assert((await page.getByLabel("WHERE").inputValue()) === "length > 3", "the clause is not in its field");
    await visit(page, `/episodes/${trace}?step=${step}&camera=top-down`);
    assert((await moment(page)).startsWith(`step ${step}`), await moment(page));
    await page.locator("button[aria-pressed=true]", { hasText: "Top" }).waitFor();
  });
}

/** Two policies on the same tasks: how many flips, and an episode of each side by side. */
export async function comparing_policies(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/compare?a=planner&b=oracle");
    await page.locator("table tbody tr").first().waitFor();
    const pairs = await page.locator("table tbody tr").count();
    const [{ n }] = await sql(`SELECT count(DISTINCT a.task_digest) AS n FROM episodes a JOIN episodes b ON a.task_digest = b.task_digest
      WHERE a.policy = 'planner' AND b.policy = 'oracle'`);
    assert(pairs === Number(n), `${pairs} pairs, the tables have ${n}`);
    await page.locator("a.episode").first().click();
    await page.waitForURL(/\/episodes\//);
  });
}

/** Rows of a training set as the model sees them, its card and what the linter says. */
export async function training_sets(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/datasets");
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
      await first.getByRole("button", { name: "Run again" }).click();
      await until(async () => (await drawer.getByText(/^\d+\. Replay of /).count()) >= 2, "the replay that runs again");
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

/** Where nothing is recorded every page says so, and what to do. */
export async function an_empty_store_is_told(browser) {
  for (const address of ["/", "/episodes", "/failures", "/compare", "/sql?q=SELECT+1", "/panels", "/datasets", "/live"]) {
    await onPage(browser, async (page) => {
      await page.goto(emptyUrl + address, { waitUntil: address === "/live" ? "load" : "networkidle" });
      await until(async () => (await page.locator("main").innerText()).trim().split("\n").length > 1, `something on ${address}`);
      const found = await findings(page);
      assert(!found.length, `${address}: ${found.join("; ")}`);
    }, { expected: ["404"] });
  }
}

/** Traces that are not as they should be: each is shown as far as it can be, with a word on what is wrong. */
export async function odd_traces_are_told(browser) {
  if (!process.env.ODD) {
    console.log("no pages of odd traces: `cargo test` makes such traces");
    return;
  }
  const expected = ["404", "409", "422"];
  await onPage(browser, async (page) => {
    await visit(page, "/episodes/diverged?step=1");
    await page.getByRole("button", { name: "Replay now" }).click();
    await page.locator(".tag.bad", { hasText: "✕" }).last().waitFor();
    await page.getByText(/robot/).first().waitFor();
  }, { expected });
  await onPage(browser, async (page) => {
    await visit(page, "/episodes/robot?step=1");
    await page.locator("button[aria-current=step]").waitFor();
    assert(!(await page.getByRole("button", { name: "What if …" }).count()), "a robot's past cannot be played on from");
    await page.getByText("recorded on a robot: nothing to execute again").waitFor();
    await page.waitForLoadState("networkidle");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
  }, { expected });
  await onPage(browser, async (page) => {
    await visit(page, "/episodes/torn");
    await page.locator("[role=alert], .tag.warn").first().waitFor();
  }, { expected });
  await onPage(browser, async (page) => {
    await visit(page, "/episodes/there-is-none");
    await page.locator("[role=alert]").first().waitFor();
  }, { expected });
  await onPage(browser, async (page) => {
    // It holds no images, and nothing can draw them: words stand in their place.
    await visit(page, "/episodes/robot?step=0");
    await until(async () => /image|drawn|execute/i.test(await page.locator(".view").first().innerText()), "a word about the image");
    assert(!(await page.locator(".view img").count()), "there is an image of what was never seen");
  }, { expected });
}

/** Addresses that are written wrongly, or by what the tables know, lead somewhere; nothing found is no dead end. */
export async function every_address_leads_on(browser, { trace }) {
  const expected = ["400", "404"];
  for (const address of ["/episodes/%zz", "/episodes/there-is-none"]) {
    await onPage(browser, async (page) => {
      await visit(page, address);
      await page.getByRole("link", { name: "All episodes" }).click();
      await page.getByRole("heading", { name: "Episodes", exact: true }).waitFor();
    }, { expected });
  }
  await onPage(browser, async (page) => {
    const [row] = await sql(`SELECT episode_id FROM episodes WHERE trace LIKE '%/${trace}.mcap'`);
    await visit(page, `/episodes/${row.episode_id}?step=1`);
    await page.locator("button[aria-current=step]").waitFor();
    const { pathname } = new URL(page.url());
    assert(pathname === `/episodes/${trace}` && parameter(page, "step") === "1", page.url());
  }, { expected });
  await onPage(browser, async (page) => {
    await visit(page, "/episodes");
    const order = page.getByRole("button", { name: "Ordered by Recorded" });
    assert((await order.innerText()).trim() === "↓", "the order of the list is not shown");
    await visit(page, "/episodes?where=length+%3C+0");
    await page.getByRole("heading", { name: "No episode is like that" }).waitFor();
    const filters = page.getByRole("complementary", { name: "Filters" });
    await until(async () => (await filters.getByRole("heading").count()) > 2, "the filters stay");
    // Long names leave room for the count.
    const counts = await filters.locator("button").evaluateAll((buttons) => buttons.filter((button) => button.scrollWidth > button.clientWidth).length);
    assert(!counts, `${counts} counts of filters are cut`);
  });
}

/** Traces are named by the table as files, and by pages as names. */
export async function every_decisive_moment_has_a_page(browser) {
  const failed = await sql("SELECT e.trace, b.step FROM episodes e JOIN blame b USING (episode_id) WHERE NOT e.success AND b.step IS NOT NULL");
  assert(failed.length >= 6, `only ${failed.length} failures have a decisive step`);
  await onPage(browser, async (page) => {
    for (const { trace, step } of failed.slice(0, 6)) {
      await visit(page, `/episodes/${traceName(trace)}?step=${step}`);
      await page.locator(`button[aria-current=step]:has-text("decisive step")`).waitFor({ timeout: PATIENCE_MS });
    }
  });
}
