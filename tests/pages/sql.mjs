/** What people do on the page of SQL and with panels, in a real browser. */
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
      await visit(page, `/sql?${new URLSearchParams({ q: question })}`);
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

const drawnAs = (select) => `/sql?${new URLSearchParams({ q: `SELECT ${select}`, as: "bar" })}`;

/** Bars of an answer with two grouping columns get a colour for each value of the second; rows that no column separates are not hidden. */
export async function bars_hide_no_row(browser) {
  await onPage(browser, async (page) => {
    await visit(page, drawnAs("family, policy, count(*) AS n FROM episodes GROUP BY 1, 2 ORDER BY 1, 2"));
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
    await visit(page, drawnAs("family, total_reward FROM episodes"));
    await hint.waitFor();
    assert(/GROUP BY family/.test(await hint.innerText()), await hint.innerText());
    await visit(page, drawnAs("family, count(*) AS n FROM episodes GROUP BY 1"));
    await page.getByRole("img", { name: /^n by family, / }).waitFor();
  });
}
