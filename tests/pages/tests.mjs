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
    // The sub-classes stand in the right-most column, from top to bottom; the label beside them is 185 wide.
    for (let y = 20; y < height && !parameter(page, "sub_class"); y += 12) {
      await canvas.click({ position: { x: width - 191, y } });
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

/** A chosen family is counted apart wherever it shares a class with others. */
export async function sankey_counts_the_choice(browser) {
  await onPage(browser, async (page) => {
    const counts = await sql(`SELECT family, class, count(*) AS n, sum(count(*)) OVER (PARTITION BY class) AS all_n
      FROM episodes JOIN classes USING (trace_digest) WHERE NOT success GROUP BY family, class ORDER BY family, class`);
    const shared = counts.find(({ n, all_n }) => n < all_n);
    assert(shared, "no class is shared by two families");
    await visit(page, `/failures?family=${shared.family}`);
    const canvas = page.locator("[role=img] canvas").first();
    await canvas.waitFor();
    const { x, y, width, height } = await canvas.boundingBox();
    const told = new Set();
    for (let at = 6; at < height; at += 6) {
      await page.mouse.move(x + (width - 185) / 2, y + at);
      for (const text of await page.locator("[role=img] > div:not(:has(canvas))").allInnerTexts()) told.add(text.trim());
    }
    for (const { family, class: klass, n, all_n } of counts.filter((one) => one.family === shared.family)) {
      assert(told.has(`${klass}: ${n} of ${all_n}`), `the chart does not say that ${n} of ${all_n} ${klass} are of ${family}, only ${[...told].join(" | ")}`);
    }
  });
}

/** A filter of Failures holds on every tab and can be removed on each; confusions are those of the choice, and scroll. */
export async function failures_keep_their_filter(browser) {
  await onPage(browser, async (page) => {
    const wrong = await sql(`SELECT e.family, count(DISTINCT e.episode_id) AS n FROM steps s JOIN episodes e USING (episode_id)
      WHERE s.tool = 'pick' AND s.error_code IS NULL AND NOT s.goal_object GROUP BY e.family ORDER BY e.family`);
    const picked = async () => {
      const cells = await page.getByRole("region", { name: "Objects by category" }).getByRole("link").allInnerTexts();
      return cells.reduce((sum, text) => sum + Number(text), 0);
    };
    assert(wrong.length > 1, "too few families with wrong picks");
    await visit(page, "/failures?tab=confusions");
    const all = await picked();
    await visit(page, `/failures?tab=confusions&family=${wrong[0].family}`);
    assert((await picked()) === wrong[0].n && all > wrong[0].n, `${await picked()} of ${all} wrong picks for ${wrong[0].family}, which has ${wrong[0].n}`);
    await page.evaluate(() => localStorage.setItem("reel-author", "Nobody"));
    for (const tab of ["", "confusions", "label"]) {
      await visit(page, `/failures?tab=${tab}&family=${wrong[0].family}`);
      await page.getByRole("button", { name: `Remove family ${wrong[0].family}` }).click();
      await until(() => !parameter(page, "family"), "the address without the family");
    }
  });
  // Furniture with long names, more of it than fits.
  for (const width of [390, 1024, 1440]) {
    await onPage(browser, async (page) => {
      const names = [...Array(18).keys()].map((at) => `furniture with a long name ${at} in the second kitchen upstairs`);
      const confusions = names.flatMap((wanted) => names.map((taken) => ({ wanted, taken, alike: false, episodes: 1, example: "x" })));
      await page.route("**/api/sql", (asked) => asked.request().postData().includes("dest_distractors") ? asked.fulfill({ json: confusions }) : asked.continue());
      await visit(page, "/failures?tab=confusions");
      const region = page.getByRole("region", { name: "Furniture" }).last();
      await region.focus();
      const seen = await region.evaluate((box) => {
        box.scrollLeft = 1e6;
        const [corner, last, row] = ["thead th", "thead th:last-child span", "tbody th"].map((name) => box.querySelector(name).getBoundingClientRect());
        const whole = [...box.querySelectorAll("th span")].every((span) => span.scrollWidth <= span.clientWidth + 1 && span.scrollHeight <= span.clientHeight + 1);
        const { left, right } = box.getBoundingClientRect();
        return { whole, reached: last.right <= right + 1, kept: row.left >= left - 1 && corner.left >= left - 1, wider: document.documentElement.scrollWidth - innerWidth };
      });
      assert(seen.whole && seen.reached && seen.kept && seen.wider <= 0, `${width}: ${JSON.stringify(seen)}`);
      const found = await findings(page);
      assert(!found.length, found.join("\n"));
    }, { width });
  }
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

/** The decisive moment shows what the robot saw when it chose, not what came of it. */
export async function a_step_shows_what_was_seen(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    const asked = [];
    page.on("request", (request) => asked.push(request.url().slice(url.length)));
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
    await visit(page, `/episodes?where=${encodeURIComponent(`trace LIKE '%/${trace}.mcap'`)}`);
    await page.locator("a.open").first().waitFor();
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
    const branch = parameter(page, "branch");
    const verdict = await (await fetch(`${url}/api/traces/${branch}/replay`, { method: "POST" })).json();
    assert(verdict.exact, `the branch does not replay: ${JSON.stringify(verdict)}`);
    const episode = await (await fetch(`${url}/api/traces/${branch}/episode`)).json();
    assert(episode.end.metrics.success && episode.header.parent.call === step, JSON.stringify(episode.end.metrics));
    assert((await page.locator(".view img").count()) === 2, "two images side by side");
  });
}

/** Answers a deletion of a label as the service does, and remembers it. */
async function deletions(page) {
  const deleted = [];
  await page.route("**/api/labels?*", (asked) => {
    if (asked.request().method() !== "DELETE") return asked.continue();
    const asks = new URL(asked.request().url()).searchParams;
    deleted.push({ episode: asks.get("episode"), author: asks.get("author") });
    return asked.fulfill({ status: 204 });
  });
  return deleted;
}
const labelsBy = (author) => sql(`SELECT episode_id, class, sub_class, step, confidence, note FROM labels WHERE author = '${author}'`);

/** A label given by keys is in the tables, and there when the page comes back. */
export async function labels_persist(browser) {
  const author = `Ada ${Date.now()}`;
  await onPage(browser, async (page) => {
    await visit(page, "/failures?tab=label&blind=off");
    await page.getByLabel("Your name").fill(author);
    await page.getByRole("button", { name: "Begin" }).click();
    await page.getByRole("heading", { name: "Why did it fail?" }).waitFor();
    await page.keyboard.press("2");
    await page.keyboard.press("b");
    await page.keyboard.press("Enter");
    await until(async () => (await labelsBy(author)).length === 1, "the label in the tables");
    const [kept] = await labelsBy(author);
    await visit(page, `/failures?tab=label&episode=${kept.episode_id}`);
    await page.locator(".tag", { hasText: "labelled" }).waitFor();
    const chosen = await page.locator("button[aria-pressed=true]").allInnerTexts();
    assert(chosen.some((text) => text.includes(kept.class)), `${chosen} does not show ${kept.class}`);
    await page.getByText(author).first().waitFor();
  });
}

/** Who labels sees what the rule says after answering only; another answer is undone into the one before, a first one into none. */
export async function labels_are_given_blind(browser) {
  const author = `blind ${Date.now()}`;
  await onPage(browser, async (page) => {
    const deleted = await deletions(page);
    await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
    await visit(page, "/failures?tab=label");
    await page.getByRole("heading", { name: "Why did it fail?" }).waitFor();
    const rule = page.getByRole("region", { name: "What the rule says" });
    const told = async () => (await rule.count()) + (await page.locator(".tag", { hasText: "decisive" }).count()) + (await page.locator(".list .seen").count()) +
      (await page.getByRole("button", { name: "Agree with the rule" }).count());
    await page.locator(".list button").first().waitFor();
    assert((await told()) === 0, "blind, and the rule's answer shows");
    await page.keyboard.press("j");
    for (const key of ["2", "b", "Enter"]) await page.keyboard.press(key);
    await rule.waitFor();
    assert((await rule.innerText()).includes("You say Key Action Missing"), await rule.innerText());
    const undo = page.getByRole("button", { name: "Undo", exact: true });
    await undo.waitFor();
    const [first] = await labelsBy(author);
    assert(first.sub_class === "missing_open" && first.step === 1, JSON.stringify(first));
    for (const dark of [false, true]) {
      await page.emulateMedia({ colorScheme: dark ? "dark" : "light" });
      const found = await findings(page);
      assert(!found.length, found.join("\n"));
    }
    for (const key of ["3", "a", "Enter"]) await page.keyboard.press(key);
    await until(async () => (await labelsBy(author))[0].sub_class === "oscillation", "the other answer");
    await undo.waitFor();
    await page.keyboard.press("u");
    await until(async () => (await labelsBy(author))[0].sub_class === "missing_open", "the answer before");
    assert(!deleted.length, "an answer that is restored is not deleted");
    await page.keyboard.press("n");
    await until(() => parameter(page, "episode") !== first.episode_id, "the next episode");
    const next = parameter(page, "episode");
    for (const key of ["1", "Enter"]) await page.keyboard.press(key);
    await undo.click();
    await until(() => deleted.length === 1, "the deletion");
    assert(deleted[0].episode === next && deleted[0].author === author, JSON.stringify(deleted));
    await until(async () => (await told()) === 0, "the rule hidden again");
    await page.getByLabel("Blind").uncheck();
    await rule.waitFor();
    assert(parameter(page, "blind") === "off", page.url());
  });
}

/** An episode is labelled on its own page, a success too; the list then shows, counts and chooses labels. */
export async function an_episode_is_labelled_on_its_page(browser) {
  const author = `page ${Date.now()}`;
  const [success] = await sql("SELECT episode_id, trace FROM episodes WHERE success AND length > 3 ORDER BY trace LIMIT 1");
  for (const options of [{ width: 390, height: 844 }, { dark: true }]) {
    await onPage(browser, async (page) => {
      const deleted = await deletions(page);
      await visit(page, `/episodes/${traceName(success.trace)}?step=2`);
      await page.getByRole("button", { name: "Label …" }).click();
      const panel = page.getByRole("region", { name: "Label this episode" });
      await panel.getByRole("combobox", { name: "Class", exact: true }).selectOption("Lost Memory");
      await panel.getByRole("combobox", { name: "Sub-class" }).selectOption("oscillation");
      await panel.getByLabel("Confidence").fill("0.75");
      await panel.getByLabel("Note").fill("back and forth, and yet");
      await panel.getByLabel("Your name").fill(author);
      await panel.getByRole("button", { name: "Store the label" }).click();
      await panel.getByRole("row", { name: new RegExp(author) }).waitFor();
      const [kept] = await labelsBy(author);
      assert(kept.episode_id === success.episode_id && kept.sub_class === "oscillation" && kept.step === 2 && kept.confidence === 0.75 && kept.note.startsWith("back"), JSON.stringify(kept));
      const found = await findings(page);
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert(!found.length && wider <= 0, `${wider} pixels wider; ${found.join("\n")}`);
      await panel.getByRole("button", { name: `Delete the label of ${author}` }).click();
      await until(() => deleted.length === 1, "the deletion");
      assert(deleted[0].author === author && deleted[0].episode === success.episode_id, JSON.stringify(deleted));
    }, options);
  }
  await onPage(browser, async (page) => {
    await visit(page, "/episodes?columns=task_id,label,labelled_by");
    const filters = page.getByRole("complementary", { name: "Filters" });
    await filters.getByRole("heading", { name: "labelled by" }).waitFor();
    await filters.getByRole("button", { name: author }).click();
    await until(() => parameter(page, "labelled_by")?.includes(author), "the facet in the address");
    const row = page.getByRole("row", { name: /oscillation/ });
    await row.getByText(author).waitFor();
    await until(async () => (await page.getByRole("row").count()) === 2, "the one episode that is labelled so");
    const [facet, count] = [filters, filters.locator(".count").first()];
    assert((await count.boundingBox()).x < (await facet.boundingBox()).x + 204, "counts stand within the filters");
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
