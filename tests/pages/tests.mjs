/** What people do with the pages: each a way from a question to its answer, in a real browser. */
import {
  PATIENCE_MS, agent, assert, call, emptyUrl, findings, onPage, sql, traceName, url, until, visit,
} from "./kit.mjs";

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
      await page.getByText("nav_to(nowhere)").waitFor();
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
