/** What people do with failures: from a flow of the chart to the episodes behind it, and labels. */
import { assert, findings, moment, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

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
      // What the class means stands below.
      for (const text of await page.locator("[role=img] > div:not(:has(canvas))").allInnerTexts()) told.add(text.trim().split("\n")[0]);
    }
    for (const { family, class: klass, n, all_n } of counts.filter((one) => one.family === shared.family)) {
      assert(told.has(`${klass}: ${n} of ${all_n}`), `the chart does not say that ${n} of ${all_n} ${klass} are of ${family}, only ${[...told].join(" | ")}`);
    }
  });
}

/** Classes, sub-classes and causes are explained where they stand, and in a list of all of them. */
export async function terms_are_explained(browser) {
  await onPage(browser, async (page) => {
    const rows = await sql(`SELECT DISTINCT c.class, c.sub_class, b.cause FROM episodes e JOIN classes c USING (trace_digest)
      LEFT JOIN blame b USING (trace_digest) WHERE NOT e.success AND e.parent_trace IS NULL`);
    const explained = async (locator, what) => {
      const title = await locator.first().getAttribute("title");
      assert(title?.endsWith("."), `${what} is explained by ${title}`);
    };
    await visit(page, "/");
    for (const row of await page.getByRole("region", { name: "Why episodes fail" }).locator("li a").all()) await explained(row, await row.innerText());
    await visit(page, "/failures");
    await page.locator("summary", { hasText: "What the classes mean" }).click();
    const list = page.getByRole("region", { name: "What the classes mean" });
    const terms = await list.locator("dt").allInnerTexts();
    const meanings = await list.locator("dd").allInnerTexts();
    assert(meanings.length === terms.length && meanings.every((meaning) => meaning.trim().endsWith(".")), meanings.join("; "));
    for (const { sub_class, cause } of rows) {
      for (const term of [sub_class, cause]) assert(term === null || terms.includes(term.replaceAll("_", " ")), `${term} is not in the list`);
    }
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await page.keyboard.press("Escape");
    await list.waitFor({ state: "hidden" });
    const table = page.getByRole("region", { name: "Failed episodes" });
    for (const { class: klass, sub_class, cause } of rows) {
      for (const term of [klass, sub_class, cause].filter(Boolean)) await explained(table.getByRole("cell", { name: term.replaceAll("_", " "), exact: true }), term);
    }
    await explained(table.getByRole("button", { name: "Cause" }), "the column");
    await visit(page, "/episodes");
    const filter = page.getByRole("complementary", { name: "Filters" }).getByRole("region", { name: "sub-class" });
    await filter.locator(".value").first().waitFor();
    // Only the most frequent values are shown at first.
    const more = filter.getByRole("button", { name: / more$/ });
    if (await more.count()) await more.click();
    for (const { sub_class } of rows) {
      if (sub_class) await explained(filter.locator(".value", { hasText: sub_class.replaceAll("_", " ") }), sub_class);
    }
    // Panels explain the columns of the named query that they ask.
    await visit(page, "/panels?panel=questions");
    await explainedColumn(page, "asked", "share of the episodes with a question");
  });
}

async function explainedColumn(page, column, meaning) {
  const button = page.getByRole("columnheader", { name: column, exact: true }).getByRole("button");
  await until(async () => (await button.getAttribute("title")) === meaning, `the meaning of ${column}`);
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

const labelsBy = (author) => sql(`SELECT episode_id, class, sub_class, step, confidence, note, blind FROM labels WHERE author = '${author}'`);

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
    assert(kept.blind === false, "the rule was seen");
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
    await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
    await visit(page, "/failures");
    // The keys are the panel's, though the link of the tab was pressed last.
    await page.getByRole("navigation", { name: "Parts of this page" }).getByRole("link", { name: "Label" }).click();
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
    assert(first.sub_class === "missing_open" && first.step === 1 && first.blind === true, JSON.stringify(first));
    for (const dark of [false, true]) {
      await page.emulateMedia({ colorScheme: dark ? "dark" : "light" });
      const found = await findings(page);
      assert(!found.length, found.join("\n"));
    }
    for (const key of ["3", "a", "Enter"]) await page.keyboard.press(key);
    await until(async () => (await labelsBy(author))[0].sub_class === "oscillation", "the other answer");
    assert((await labelsBy(author))[0].blind === false, "who has seen the rule's answer is not blind any more");
    await undo.waitFor();
    await page.keyboard.press("u");
    await until(async () => (await labelsBy(author))[0].sub_class === "missing_open", "the answer before");
    assert((await labelsBy(author))[0].blind === true, "the answer before was blind");
    await page.keyboard.press("n");
    await until(() => parameter(page, "episode") !== first.episode_id, "the next episode");
    const next = parameter(page, "episode");
    // Taken back before it is in the tables.
    for (const key of ["1", "Enter", "u"]) await page.keyboard.press(key);
    await until(async () => (await page.getByText("Storing …").count()) > 0, "that the label is on its way");
    await until(async () => !(await page.getByText("Storing …").count()), "that it is there and gone");
    await until(async () => (await labelsBy(author)).every(({ episode_id }) => episode_id !== next), "the deletion");
    assert((await labelsBy(author)).length === 1, "a label of another episode is gone");
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
      await until(async () => (await labelsBy(author)).length === 0, "the deletion");
    }, options);
  }
  const body = JSON.stringify({ episode: success.episode_id, class: "Lost Memory", sub_class: "oscillation", author });
  const stored = await fetch(`${url}/api/labels`, { method: "POST", headers: { "content-type": "application/json" }, body });
  assert(stored.status === 201, await stored.text());
  await onPage(browser, async (page) => {
    await visit(page, "/episodes?columns=task_id,label,labelled_by");
    const filters = page.getByRole("complementary", { name: "Filters" });
    await filters.getByRole("heading", { name: "labelled by" }).waitFor();
    await filters.locator(".value", { hasText: author }).click();
    await until(() => parameter(page, "labelled_by")?.includes(author), "the facet in the address");
    const row = page.getByRole("row", { name: /oscillation/ });
    await row.getByText(author).waitFor();
    await until(async () => (await page.getByRole("row").count()) === 2, "the one episode that is labelled so");
    const [facet, count] = [filters, filters.locator(".count").first()];
    assert((await count.boundingBox()).x < (await facet.boundingBox()).x + 204, "counts stand within the filters");
  });
}
