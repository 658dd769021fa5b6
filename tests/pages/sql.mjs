/** What people do on the page of SQL and with panels, in a real browser. */
import { readFileSync } from "node:fs";
import { assert, findings, onPage, sql, until, url, visit } from "./kit.mjs";

/** The editor, once it is more than a plain field. */
async function editorOf(page) {
  const editor = page.locator(".cm-content");
  await editor.waitFor();
  return editor;
}
/** Replaces the question. */
async function write(page, text) {
  await (await editorOf(page)).focus();
  await page.keyboard.press("Control+A");
  await page.keyboard.insertText(text);
}
const written = async (page) => (await (await editorOf(page)).locator(".cm-line").allInnerTexts()).join("\n").trim();
const about = (question, chosen = {}) => `/sql?${new URLSearchParams({ q: question, ...chosen })}`;
const asked = (page) => new URL(page.url()).searchParams.get("q");

/** A question that cannot be asked is told where; one that can is drawn. */
export async function sql_errors_are_told(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/sql");
    await write(page, "SELECT policy, count(*) AS n\nFROM episodes\nGROUP BY polcy");
    await page.keyboard.press("Control+Enter");
    const alert = page.locator("[role=alert]");
    await alert.waitFor();
    assert(/polcy/.test(await alert.innerText()), await alert.innerText());
    await page.getByRole("button", { name: /Line 3, column 10/ }).click();
    const marked = await page.locator(".cm-lintRange-error").innerText();
    assert(marked === "polcy", `'${marked}' is marked`);
    const picked = await page.evaluate(() => String(getSelection()));
    assert(picked === "polcy", `'${picked}' is selected`);
    await page.keyboard.type("policy");
    await page.keyboard.press("Control+Enter");
    await page.locator("table tbody tr").first().waitFor();
    const count = (await sql("SELECT DISTINCT policy FROM episodes")).length;
    await until(async () => (await page.locator("table tbody tr").count()) === count, `${count} rows`);
    await page.getByRole("button", { name: "bar" }).click();
    await page.locator("[role=img] canvas").waitFor();
    await write(page, "DROP TABLE episodes");
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

/** A panel under the title of another one replaces it only when that is confirmed. */
export async function a_panel_is_not_replaced_unasked(browser) {
  const name = "kept-as-it-is";
  const saved = async () => (await (await fetch(`${url}/api/definitions`)).json()).find((one) => one.name === name)?.definition.sql;
  await onPage(browser, async (page) => {
    const save = async (question) => {
      await visit(page, about(question));
      await page.getByRole("button", { name: "Save as a panel…" }).click();
      await page.getByLabel("Title").fill("Kept as it is");
      await page.keyboard.press("Enter");
    };
    try {
      await save("SELECT 1");
      await page.getByRole("link", { name: "look at it" }).waitFor();
      await save("SELECT 2");
      const asks = page.getByRole("dialog", { name: /Replace “Kept as it is”/ });
      await asks.waitFor();
      const found = await findings(page);
      assert(!found.length, found.join("; "));
      await page.keyboard.press("Escape");
      assert((await saved()) === "SELECT 1", await saved());
      await page.getByRole("button", { name: /Save kept-as-it-is/ }).click();
      await asks.getByRole("button", { name: "Replace it" }).click();
      await page.getByRole("link", { name: "look at it" }).waitFor();
      assert((await saved()) === "SELECT 2", await saved());
    } finally {
      await fetch(`${url}/api/definitions/${name}`, { method: "DELETE" });
    }
  });
}

/** The editor highlights, completes by keyboard, undoes, and lets those out who use no mouse. */
export async function the_editor_helps_and_lets_go(browser) {
  for (const dark of [false, true]) {
    await onPage(browser, async (page) => {
      await visit(page, "/sql?q=SELECT+family+FROM+episodes+WHERE+policy+%3D+%27oracle%27");
      const editor = await editorOf(page);
      const color = (text) => editor.locator("span", { hasText: text }).first().evaluate((it) => getComputedStyle(it).color);
      assert((await color("SELECT")) !== (await color("oracle")), "keywords and texts have one colour");
      await page.getByRole("button", { name: "episodes", exact: true }).or(page.locator("summary", { hasText: /^episodes$/ })).first().waitFor();
      await write(page, "SELECT shortest_p");
      await page.keyboard.press("Tab");
      assert((await written(page)) === "SELECT shortest_path_m", await written(page));
      await page.keyboard.insertText(" FROM episodes WHERE pol");
      await page.keyboard.press("Control+Space");
      const menu = page.getByRole("listbox");
      await menu.getByRole("option", { name: "policy episodes" }).waitFor();
      const found = await findings(page);
      assert(!found.length, found.join("; "));
      await page.keyboard.press("Enter");
      assert((await written(page)).endsWith("WHERE policy"), await written(page));
      await page.keyboard.press("Control+Z");
      assert((await written(page)).endsWith("WHERE pol"), await written(page));
      // Behind a word Tab completes it; Escape before it lets go.
      await page.keyboard.press("Escape");
      await page.keyboard.press("Tab");
      assert(!(await editor.evaluate((it) => it.contains(document.activeElement))), "Tab is kept after Escape");
      assert((await written(page)).endsWith("WHERE pol"), await written(page));
    }, { dark });
  }
}

/** Bars of an answer with two grouping columns get a colour for each value of the second; rows that no column separates are not hidden. */
export async function bars_hide_no_row(browser) {
  await onPage(browser, async (page) => {
    await visit(page, about("SELECT family, policy, count(*) AS n FROM episodes GROUP BY 1, 2 ORDER BY 1, 2", { as: "bar" }));
    await page.getByRole("img", { name: /^n by family for each policy/ }).waitFor();
    const group = page.getByLabel("one colour for each");
    assert((await group.inputValue()) === "policy", await group.inputValue());
    await group.selectOption("family");
    const hint = page.getByRole("region", { name: "Chart" }).getByRole("alert");
    await hint.waitFor();
    assert(/Choose policy as group/.test(await hint.innerText()), await hint.innerText());
    assert(!(await page.getByRole("img", { name: /by family/ }).count()), "bars are drawn over each other");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await group.selectOption("policy");
    await page.getByRole("img", { name: /for each policy/ }).waitFor();
    await visit(page, about("SELECT family, total_reward FROM episodes", { as: "bar" }));
    await hint.waitFor();
    assert(/GROUP BY family/.test(await hint.innerText()), await hint.innerText());
    await visit(page, about("SELECT family, count(*) AS n FROM episodes GROUP BY 1", { as: "bar" }));
    await page.getByRole("img", { name: /^n by family, / }).waitFor();
  });
}

/** A question that runs until it is stopped. */
const ENDLESS = "SELECT count(*) AS n FROM generate_series(1, 1000000) a, generate_series(1, 100000) b WHERE a.value + b.value = 7";

/** A question that takes long shows for how long, and can be cancelled by keyboard; the next one is answered. */
export async function a_question_can_be_cancelled(browser) {
  await onPage(browser, async (page) => {
    let stopped = 0;
    page.on("requestfailed", (request) => (stopped += request.url().endsWith("/api/sql") ? 1 : 0));
    await visit(page, "/sql");
    const cancel = page.getByRole("button", { name: "Cancel", exact: true });
    assert(await cancel.isDisabled(), "there is something to cancel before a question");
    await write(page, ENDLESS);
    await page.keyboard.press("Control+Enter");
    const clock = page.getByRole("timer");
    await until(async () => Number.parseFloat(await clock.innerText()) >= 0.5, "half a second");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await cancel.press("Enter");
    await page.getByText("The question is cancelled").waitFor();
    await until(() => stopped === 1, "the end of the request");
    await write(page, "SELECT 41 + 1 AS n");
    await page.keyboard.press("Control+Enter");
    await page.getByRole("cell", { name: "42" }).waitFor();
  });
}

/** Errors advise what can be done on a page, not options of a command line. */
export async function advice_fits_the_page(browser) {
  await onPage(browser, async (page) => {
    // The limit on time takes a minute to reach; these are the words in which the service tells it.
    const words = "stopped after 60 s, the limit on time; narrow the question down, or raise --timeout (limits.sql_timeout_s)";
    await page.route("**/api/sql", (route) => {
      if (!route.request().postData().includes("'slow'")) return route.continue();
      return route.fulfill({ status: 422, json: { error: { code: "over_limit", message: words } } });
    });
    await visit(page, about("SELECT 'slow'"));
    const alert = await page.getByRole("alert").innerText();
    assert(/Stopped after 60 s/.test(alert) && /WHERE/.test(alert) && !/--/.test(alert), alert);
  }, { expected: ["422"] });
}

/** A download has every row, where the page shows the first ones; one that breaks off is no file. */
export async function the_whole_answer_is_downloaded(browser) {
  await onPage(browser, async (page) => {
    await visit(page, about("SELECT value AS n FROM generate_series(1, 2500)"));
    await page.getByText("The first 1,000 rows; there are more").waitFor();
    const files = page.getByRole("group", { name: "Download the whole answer" });
    const saved = async (format) => {
      const [download] = await Promise.all([page.waitForEvent("download"), files.getByRole("button", { name: format }).press("Enter")]);
      return { name: download.suggestedFilename(), bytes: readFileSync(await download.path()) };
    };
    const csv = await saved("CSV");
    const lines = csv.bytes.toString().trim().split(/\r?\n/);
    assert(csv.name === "answer.csv" && lines.length === 2501 && lines.at(-1) === "2500", `${csv.name}: ${lines.length} lines`);
    const arrow = await saved("Arrow");
    assert(arrow.name === "answer.arrows" && arrow.bytes.readUInt32LE(0) === 0xffffffff && arrow.bytes.length > 2500 * 8, `${arrow.name}: ${arrow.bytes.length} bytes`);
    const parquet = await saved("Parquet");
    const ends = [parquet.bytes.subarray(0, 4), parquet.bytes.subarray(-4)].map(String);
    assert(parquet.name === "answer.parquet" && ends.every((end) => end === "PAR1"), `${parquet.name}: ${ends}`);
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    // More rows than an answer may have.
    await visit(page, about("SELECT value AS n FROM generate_series(1, 1500000)"));
    await files.getByRole("button", { name: "CSV" }).click();
    const alert = page.getByRole("alert");
    await alert.waitFor();
    assert(/broke off/.test(await alert.innerText()), await alert.innerText());
  }, { expected: ["ERR_INCOMPLETE_CHUNKED_ENCODING", "ERR_HTTP2", "Failed to load"] });
}

/** A question too long for a link is kept in the browser, under a short address that says so. */
export async function a_long_question_is_kept(browser) {
  const long = `SELECT 'kept' AS n -- ${"why ".repeat(600)}`;
  let address;
  await onPage(browser, async (page) => {
    await visit(page, "/sql");
    await write(page, long);
    await page.keyboard.press("Control+Enter");
    await page.getByRole("cell", { name: "kept" }).waitFor();
    address = new URL(page.url());
    assert(address.searchParams.has("kept") && !address.searchParams.has("q") && address.href.length < 200, address.href);
    await page.getByText("works in this browser only").waitFor();
    await page.reload({ waitUntil: "networkidle" });
    await page.getByRole("cell", { name: "kept" }).waitFor();
    assert((await written(page)).length === long.trim().length, "the editor has another question");
    await write(page, "SELECT 'short' AS n");
    await page.keyboard.press("Control+Enter");
    await page.getByRole("cell", { name: "short" }).waitFor();
    assert(asked(page) && !page.url().includes("kept="), page.url());
    await page.goBack();
    await page.getByRole("cell", { name: "kept" }).waitFor();
    // A long link, as from a panel, becomes a short one.
    await visit(page, about(long));
    assert(page.url() === address.href, page.url());
  });
  await onPage(browser, async (page) => {
    await visit(page, address.pathname + address.search);
    await page.getByText("Another browser keeps the question").waitFor();
  });
}

/** Everything of the page fits a phone. */
export async function sql_fits_a_phone(browser) {
  for (const dark of [false, true]) {
    await onPage(browser, async (page) => {
      await visit(page, about("SELECT family, policy, count(*) AS n, avg(total_reward) AS mean_of_the_total_reward FROM episodes GROUP BY 1, 2", { as: "bar" }));
      await page.locator("[role=img] canvas").waitFor();
      await page.getByRole("button", { name: "Save as a panel…" }).click();
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      const found = await findings(page);
      assert(wider <= 0 && !found.length, `${wider} pixels wider; ${found.join("; ")}`);
    }, { dark, width: 390 });
  }
}
