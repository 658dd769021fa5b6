/** What people do with episodes: each a way from a question to its answer, in a real browser. */
import {
  assert, call, emptyUrl, findings, moment, onPage, parameter, PATIENCE_MS, sql, traceName, until, url, visit,
} from "./kit.mjs";

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

/** The decisive moment shows what the robot saw when it chose, not what came of it. */
export async function a_step_shows_what_was_seen(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    const asked = [];
    page.on("request", (request) => asked.push(new URL(request.url()).pathname));
    const frame = (at) => `/api/traces/${trace}/frames/${at < 0 ? "start" : at}`;
    await visit(page, `/episodes/${trace}?step=${step}`);
    const image = page.locator(".view img").first();
    await image.waitFor();
    assert(asked.includes(frame(step - 1)) && !asked.includes(frame(step)), `asked for ${asked.filter((path) => path.includes("/frames/"))}`);
    assert((await image.getAttribute("alt")).endsWith(`before step ${step}`), await image.getAttribute("alt"));
    const before = await image.getAttribute("src");
    await page.keyboard.press("b");
    await until(async () => (await image.getAttribute("src")) !== before, "the image after the call");
    assert(asked.includes(frame(step)) && parameter(page, "show") === "after", page.url());
    await page.getByRole("button", { name: "Before the call" }).click();
    await until(async () => (await image.getAttribute("src")) === before, "the image before the call again");
    // So do the small images of lists.
    asked.length = 0;
    await visit(page, `/episodes?where=${encodeURIComponent(`trace LIKE '%/${trace}.mcap'`)}`);
    await page.locator("a.open img").first().waitFor();
    assert(asked.includes(frame(step - 1)) && !asked.includes(frame(step)), `asked for ${asked.filter((path) => path.includes("/frames/"))}`);
  });
}

/** A replay on the page is a verdict in the tables, and the overview counts it. */
export async function a_replay_leaves_its_verdict(browser, { trace }) {
  await onPage(browser, async (page) => {
    const of = `SELECT v.verdict FROM episodes e JOIN verdicts v ON v.trace_digest = e.trace_digest WHERE e.trace LIKE '%/${trace}.mcap'`;
    const job = await (await fetch(`${url}/api/jobs`, {
      method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ kind: "replay", traces: [trace, "gone"] }),
    })).json();
    let ended;
    await until(async () => {
      ended = await (await fetch(`${url}/api/jobs/${job.id}`)).json();
      return !["waiting", "running"].includes(ended.state);
    }, "the replay");
    assert(ended.state === "done" && ended.errors.some((text) => text.includes("gone")), JSON.stringify(ended));
    const rows = await sql(of);
    assert(rows.length >= 1 && rows.every(({ verdict }) => verdict === "exact"), JSON.stringify(rows));
    // Once more by the trace's own route: nothing is counted twice.
    assert((await (await fetch(`${url}/api/traces/${trace}/replay`, { method: "POST" })).json()).exact, "it does not replay");
    assert((await sql(of)).length === rows.length, "a verdict is there twice");
    const [{ n }] = await sql(`SELECT count(DISTINCT e.episode_id) AS n FROM episodes e JOIN verdicts v ON v.trace_digest = e.trace_digest
      WHERE v.verdict = 'exact' AND e.parent_trace IS NULL`);
    await visit(page, "/");
    const shown = await page.locator("li", { hasText: "Verified exact" }).first().innerText();
    assert(shown.includes(String(n)), `${n} exact: ${shown}`);
  });
}

/** A branch is read in by itself, hangs below its parent, and is no policy of the benchmark. */
export async function branches_come_and_hang_below_their_parent(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    // What the page counts as new is what comes after its first look; another branch of the same calls would be no new episode.
    const looked = page.waitForResponse((response) => response.url().includes("/api/waiting") && response.ok());
    await visit(page, `/episodes?where=${encodeURIComponent(`trace LIKE '%/${trace}.mcap'`)}`);
    await page.locator("a.open").first().waitFor();
    await looked;
    const name = `hanging-${Date.now()}`;
    const made = await fetch(`${url}/api/traces/${trace}/branches`, {
      method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ at: step, policy: "planner", name }),
    });
    assert(made.status === 201, await made.text());
    await page.getByText("The tables have new episodes.").waitFor();
    await page.getByRole("button", { name: "Show them" }).click();
    await page.getByText(`↳ branch at step ${step}`).first().waitFor();
    const [{ n }] = await sql(`SELECT count(*) AS n FROM episodes WHERE trace LIKE '%/${name}.mcap' AND parent_trace IS NOT NULL`);
    assert(n === 1, `${n} rows of the branch`);
    await visit(page, "/");
    await page.getByRole("heading", { name: /Success/ }).first().waitFor();
    const policies = await sql("SELECT DISTINCT policy FROM main_results");
    assert(!policies.some(({ policy }) => policy === "branch"), JSON.stringify(policies));
    assert((await page.getByRole("row", { name: /^branch/ }).count()) === 0, "a branch is a policy of the overview");
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
    await viewer.getByRole("link", { name: "The episode in Reel" }).click();
    await viewer.waitForURL(`${url}/episodes/${trace}?step=${step}`);
    // Its tens of megabytes come compressed, and once.
    const wasm = await fetch(`${url}/rerun/re_viewer_bg.wasm`, { method: "HEAD", headers: { "accept-encoding": "gzip" } });
    assert(wasm.headers.get("content-encoding") === "gzip", "the viewer is not compressed");
    const again = await fetch(`${url}/rerun/re_viewer_bg.wasm`, { headers: { "accept-encoding": "gzip", "if-none-match": wasm.headers.get("etag") } });
    assert(again.status === 304, `${again.status} for what is known`);
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
    const branch = parameter(page, "beside");
    const verdict = await (await fetch(`${url}/api/traces/${branch}/replay`, { method: "POST" })).json();
    assert(verdict.exact, `the branch does not replay: ${JSON.stringify(verdict)}`);
    const episode = await (await fetch(`${url}/api/traces/${branch}/episode`)).json();
    assert(episode.end.metrics.success && episode.header.parent.call === step, JSON.stringify(episode.end.metrics));
    assert((await page.locator(".view img").count()) === 2, "two images side by side");
  });
}

/** Filters, order and selection of columns come back with the link. */
export async function a_shared_link_restores_the_view(browser, { trace, step }) {
  let address;
  let rows;
  // Small images come when they are drawn, or say then that there are none.
  const shown = (page) => page.locator("table tbody td:not(.seen)").allInnerTexts();
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
    assert(JSON.stringify(again) === JSON.stringify(rows), `${again}, not ${rows} as before`);
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
    await visit(page, "/live/there-is-none");
    await page.getByRole("heading", { name: "There is no session there-is-none" }).waitFor();
    await page.getByRole("link", { name: "All sessions" }).click();
    await until(() => new URL(page.url()).pathname === "/live", "the list of sessions");
  }, { expected });
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

/** Values of a facet are added to each other and left out; counts, address, copied question and the failures page say the same. */
export async function values_are_added_and_left_out(browser) {
  const count = async (condition) => (await sql(`SELECT count(*) AS n FROM episodes WHERE parent_trace IS NULL AND ${condition}`))[0].n;
  const [one, other] = (await sql("SELECT policy FROM episodes WHERE parent_trace IS NULL GROUP BY policy HAVING count(*) > 1 ORDER BY policy LIMIT 2")).map(({ policy }) => policy);
  const family = (await sql("SELECT family FROM episodes GROUP BY family ORDER BY count(*) DESC LIMIT 1"))[0].family;
  await onPage(browser, async (page) => {
    await visit(page, "/episodes");
    const filters = page.getByRole("complementary", { name: "Filters" });
    const shows = async (condition) => {
      const expected = await count(condition);
      assert(expected > 0, `no episode with ${condition}`);
      await until(
        async () => (await page.getByRole("navigation", { name: "Pages of the list" }).innerText()).endsWith(` of ${expected}`), `${expected} with ${condition}`,
      );
    };
    const way = async (name) => {
      const button = filters.getByRole("button", { name, exact: true });
      await button.focus();
      await button.press("Enter");
    };
    const value = (name) => filters.locator(".value").filter({ hasText: new RegExp(`^${name}\\s*\\d`) });
    assert(!(await filters.getByRole("button", { name: `Also ${other}`, exact: true }).count()), "nothing is chosen that something could be added to");
    await value(one).click();
    await shows(`policy = '${one}'`);
    await way(`Also ${other}`);
    await shows(`policy IN ('${one}', '${other}')`);
    await way(`Not ${family}`);
    const both = `policy IN ('${one}', '${other}') AND family <> '${family}'`;
    await shows(both);
    await until(async () => !(await page.locator("[aria-busy=true]").count()), "the list is there");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    // The address says it all.
    const address = new URL(page.url());
    assert(address.searchParams.getAll("policy").join() === `${one},${other}` && address.searchParams.get("not_family") === family, page.url());
    await page.reload();
    await shows(both);
    // What was left out can be seen and taken back; one value alone replaces two.
    await page.getByRole("button", { name: `Remove not family ${family}` }).click();
    await shows(`policy IN ('${one}', '${other}')`);
    await value(one).click();
    await shows(`policy = '${other}'`);
    await way(`Not ${one}`);
    await shows(`policy = '${other}'`);
    await value(other).click();
    await shows(`policy <> '${one}'`);
    // Failures ask the same.
    await visit(page, `/failures${address.search}`);
    const failed = await count(`${both} AND NOT success AND end_reason IS NOT NULL`);
    await page.getByRole("button", { name: `Remove policy ${one} or ${other}` }).waitFor();
    if (failed) await until(async () => (await page.getByRole("navigation", { name: "Pages of the list" }).innerText()).endsWith(` of ${failed}`), `${failed} failures`);
  });
}

/** On a phone the list stands first; filters open above it, and what opens stays on the screen. */
export async function a_phone_shows_the_list_first(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/episodes");
    const first = page.locator("a.open").first();
    await first.waitFor();
    assert((await first.boundingBox()).y < 844, "the list begins below the screen");
    for (const title of ["Views", "Copy …", "Columns"]) {
      await page.locator("summary", { hasText: title }).click();
      const box = await page.locator("details[open] > .card").boundingBox();
      assert(box.x >= 0 && box.x + box.width <= 390, `${title} leaves the screen: ${box.x} to ${box.x + box.width}`);
      await page.keyboard.press("Escape");
    }
    const fold = page.locator("summary", { hasText: "Filters" });
    const filters = page.getByRole("complementary", { name: "Filters" });
    assert(!(await filters.getByLabel("WHERE").isVisible()), "the filters are open");
    await fold.click();
    await filters.locator(".value").first().click();
    await page.getByRole("button", { name: "Clear filters" }).first().waitFor();
    await filters.getByLabel("WHERE").fill("length > 3");
    await filters.getByRole("button", { name: "Filter", exact: true }).click();
    await until(async () => (await fold.innerText()).startsWith("Filters (2)"), "the number of the filters");
    await until(async () => !(await page.locator("[aria-busy=true]").count()), "the list is there");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    // A clause that is refused is seen with its error, without a tap.
    await visit(page, "/episodes?where=nosuch+%3D+1");
    await filters.getByLabel("WHERE").waitFor();
    await filters.getByText("nosuch").first().waitFor();
  }, { width: 390, height: 844, expected: ["422"] });
}

/** Selected episodes are exported by the form of the page Datasets, into the folder that it names. */
export async function a_selection_is_exported(browser) {
  await onPage(browser, async (page) => {
    const form = page.locator("form", { hasText: "New training set" });
    const fields = async () => Promise.all([/^Of /, /^Format/, "Share for validation"].map((label) => form.getByLabel(label).inputValue()));
    await visit(page, "/datasets?new=1");
    const usual = await fields();
    await visit(page, "/episodes?outcome=success");
    await page.getByRole("checkbox", { name: /^Select/ }).nth(1).check();
    await page.getByRole("button", { name: "Export…" }).click();
    await page.getByRole("heading", { name: "New training set of 1 selected episode" }).waitFor();
    assert(String(await fields()) === String(usual), `${await fields()}, not ${usual} as on Datasets`);
    const name = `selected-${Date.now()}`;
    await form.getByLabel("Name").fill(name);
    await page.getByText(`exports/${name}`).waitFor();
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await page.getByRole("button", { name: "Start the export" }).click();
    await page.locator("main").getByRole("region", { name: /^Job \d+/ }).getByText("done", { exact: true }).waitFor();
    const sets = await (await fetch(`${url}/api/exports`)).json();
    assert(sets.find((set) => set.name === name)?.manifest.format === usual[1], JSON.stringify(sets.map((set) => [set.name, set.manifest.format])));
  });
}

/** The overview counts tasks, and says where several have one name. */
export async function tasks_are_counted_by_what_they_are(browser) {
  await onPage(browser, async (page) => {
    const [{ tasks, names }] = await sql("SELECT count(DISTINCT task_digest) AS tasks, count(DISTINCT task_id) AS names FROM episodes WHERE parent_trace IS NULL");
    await visit(page, "/");
    const told = (await page.locator(".figures").innerText()).replace(/\s+/g, " ");
    assert(told.includes(tasks > names ? `${tasks} tasks of ${names} names` : `${tasks} tasks`), told);
  });
}

/** Playing has a speed, which the address keeps, and the image fills the screen while the keys go on. */
export async function playing_has_a_speed_and_fills_the_screen(browser, { trace }) {
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?speed=0.5`);
    const speed = page.getByLabel("Speed");
    await page.locator(".view img").first().waitFor();
    assert((await speed.inputValue()) === "0.5", "the speed of the address");
    const at = () => parameter(page, "step");
    /** Milliseconds between two steps while it plays. */
    const gap = async () => {
      await page.getByRole("button", { name: "Play", exact: true }).click();
      const first = at();
      await until(() => at() !== first, "it plays");
      const [second, begun] = [at(), performance.now()];
      await until(() => at() !== second, "it plays on");
      const took = performance.now() - begun;
      await page.getByRole("button", { name: "Pause" }).click();
      return took;
    };
    const slow = await gap();
    assert(slow > 1300, `at half the speed a step takes ${slow} ms`);
    await speed.selectOption("4×");
    assert(parameter(page, "speed") === "4", page.url());
    // Back to the start: its images are there already.
    await page.keyboard.press("Home");
    const quick = await gap();
    assert(quick < slow / 2, `${quick} ms a step at four times the speed, ${slow} at half of it`);

    const full = () => page.evaluate(() => Boolean(document.fullscreenElement));
    await page.locator("h1").click();
    await page.keyboard.press("Home");
    await page.keyboard.press("f");
    await until(full, "the image fills the screen");
    const [box, screen] = [await page.locator(".view .image").boundingBox(), page.viewportSize()];
    assert(box.width === screen.width && box.height === screen.height, `${box.width} x ${box.height}`);
    await page.keyboard.press("j");
    await page.getByText("What the head camera shows before step 0").waitFor();
    await page.keyboard.press("f");
    await until(async () => !(await full()), "the page comes back");
    await page.getByRole("button", { name: "Fill the screen" }).click();
    await until(full, "the button does the same");
    await page.keyboard.press("f");
    // Where the image can be dragged, too.
    await page.keyboard.press("4");
    await page.getByText("Drag to go around").waitFor();
    await page.getByRole("button", { name: "Fill the screen" }).click();
    await until(full, "the button works beside the free camera");
    await page.keyboard.press("f");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
  });
}
