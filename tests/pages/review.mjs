/** Working through a list: search in what was said, the next episode of the list, and copies of what a page shows. */
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { assert, findings, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const open = (page) => page.locator("a.open");
const total = (page) => page.getByRole("navigation", { name: "Pages of the list" }).innerText();

async function search(page, text, episodes) {
  await page.getByLabel("Search episodes").fill(text);
  await page.keyboard.press("Enter");
  await until(async () => (await total(page)).endsWith(` of ${episodes}`) && !(await page.locator("[aria-busy=true]").count()), `${episodes} with '${text}'`);
}

/** A text is found wherever it was said, as it is and in any case, and leads to the step that says it. */
export async function search_finds_what_was_said(browser) {
  // Counted here, over all that is said.
  const episodes = await sql("SELECT episode_id, instruction FROM episodes WHERE parent_trace IS NULL");
  const steps = await sql("SELECT episode_id, step, concat(call_name, ' ', arguments) AS call, text, question, reply, reasoning, plan, history FROM steps");
  const having = (text) => {
    const says = (words) => words.some((word) => word?.toLowerCase().includes(text.toLowerCase()));
    const saying = new Set(steps.filter(({ episode_id, step, ...words }) => says(Object.values(words))).map((step) => step.episode_id));
    return episodes.filter((episode) => saying.has(episode.episode_id) || says([episode.instruction]));
  };
  const step = steps.find(({ step, text }) => step > 0 && text.length > 30 && !text.slice(0, 30).includes("\n"));
  await onPage(browser, async (page) => {
    await visit(page, "/episodes");
    // The same one in two cases is not asked one after the other: its count would stand there already.
    for (const text of [step.text.slice(5, 30).trim(), "0", step.text.slice(5, 30).trim().toUpperCase(), "NAV_TO"]) {
      const expected = having(text).length;
      assert(expected > 0, `nobody says '${text}'`);
      await search(page, text, expected);
      const [mark] = await page.locator("mark").allInnerTexts();
      assert(mark.toLowerCase() === text.toLowerCase(), `'${mark}' is marked, not '${text}'`);
    }
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    // A row leads to the step that says it.
    const told = await page.locator("tr.found").first().innerText();
    await open(page).first().click();
    await page.locator(".view img").first().waitFor();
    assert(parameter(page, "step") === told.match(/^step (\d+), call/)[1], `${page.url()}: ${told}`);
    // Signs of SQL and of patterns are letters like others.
    for (const text of ["%", "' OR '1'='1", "_av_to", "|", " | ", "42", "0.25", "-0", "1e9"]) {
      await visit(page, `/episodes?search=${encodeURIComponent(text)}`);
      if (having(text).length) await until(async () => (await total(page)).endsWith(` of ${having(text).length}`), `${having(text).length} with '${text}'`);
      else await page.getByText("No episode is like that").waitFor();
    }
    await page.getByRole("button", { name: "Clear filters" }).first().click();
    await open(page).first().waitFor();
    assert(parameter(page, "search") === null && (await page.getByLabel("Search episodes").inputValue()) === "", page.url());
  });
}

/** From an episode of a list to the next one and back, by link and key, in the order of the list. */
export async function a_list_is_worked_through(browser) {
  await onPage(browser, async (page) => {
    const address = "/episodes?outcome=failure&sort=length&order=up&columns=policy,length";
    await visit(page, address);
    // A branch hangs below its parent, and is no row of the list.
    const rows = page.locator("tbody tr:not(:has(.branch)) a.open");
    const traces = async () => (await rows.evaluateAll((links) => links.map((link) => link.pathname))).map((path) => decodeURIComponent(path));
    const listed = await traces();
    assert(listed.length > 2, `${listed.length} episodes`);
    await rows.nth(1).click();
    const nav = page.getByRole("navigation", { name: "Episodes of the list" });
    const shows = async (at) => {
      await nav.getByText(`${at + 1} of ${listed.length} in`).waitFor();
      const path = decodeURIComponent(new URL(page.url()).pathname);
      assert(path === listed[at], `${path} is not number ${at + 1}, ${listed[at]}`);
    };
    await shows(1);
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await nav.getByRole("link", { name: "Next" }).click();
    await shows(2);
    assert(await nav.evaluate((nav) => nav === document.activeElement), "the focus is lost");
    await page.keyboard.press("p");
    await shows(1);
    await page.keyboard.press("p");
    await shows(0);
    assert(!(await nav.getByRole("link", { name: "Previous" }).count()), "something stands before the first");
    await page.keyboard.press("n");
    await shows(1);
    // A panel that is open stays open.
    await page.getByRole("button", { name: "Label …" }).click();
    await nav.getByRole("link", { name: "Next" }).click();
    await shows(2);
    assert(parameter(page, "label") === "1", page.url());
    await nav.getByRole("link", { name: "outcome: failure" }).click();
    await open(page).first().waitFor();
    assert(JSON.stringify(await traces()) === JSON.stringify(listed), "the list is another one");
    assert(parameter(page, "columns") === "policy,length", "other columns");
    // In a search, the next one opens where it says so, as its row does.
    await visit(page, "/episodes?search=ask&sort=length");
    const steps = (await rows.evaluateAll((links) => links.map((link) => new URL(link.href).searchParams.get("step"))));
    if (steps.length > 1) {
      await rows.nth(0).click();
      await nav.getByRole("link", { name: "Next" }).click();
      await nav.getByText(/^2 of/).first().waitFor();
      assert(parameter(page, "step") === steps[1], `step ${parameter(page, "step")}, not ${steps[1]}`);
    }
    // So do the lists of failures.
    await visit(page, "/failures");
    await open(page).first().click();
    await nav.getByText(/^1 of \d+ in outcome: failure/).waitFor();
  });
}

/** What a menu copies runs as it is, and names a token without telling it. */
export async function what_a_page_shows_is_copied(browser, { trace, step }) {
  const folder = mkdtempSync(`${tmpdir()}/reel-copied-`);
  const run = (program, ...given) => execFileSync(program, given, { cwd: folder, encoding: "utf8" });
  try {
    await onPage(browser, async (page) => {
      await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
      const copied = async (name) => {
        // Space opens the menu, and plays nothing.
        await page.getByText("Copy …").press(" ");
        await page.getByRole("button", { name, exact: true }).click();
        await page.getByText(`Copied: ${name}`).waitFor();
        return page.evaluate(() => navigator.clipboard.readText());
      };
      await visit(page, `/episodes/${trace}?step=${step}`);
      assert((await copied("Link")) === page.url(), "another link");
      run("sh", "-c", await copied("curl"));
      assert(readFileSync(`${folder}/${trace}.mcap`).subarray(1, 5).toString() === "MCAP", "no trace");
      const python = await copied("Python");
      // The package is not here: a file of its name stands in for it.
      writeFileSync(`${folder}/reel.py`, "import types\ndef open(name):\n    return types.SimpleNamespace(steps=range(99), name=name)\n");
      rmSync(`${folder}/${trace}.mcap`);
      assert(run("python3", "-c", python).trim() === String(step), python);
      assert(readFileSync(`${folder}/${trace}.mcap`).subarray(1, 5).toString() === "MCAP", "no trace");
      assert(python.includes(`episode.steps[${step}]`), python);
      const markdown = await copied("Markdown");
      assert(markdown.includes(`](${page.url()})`) && markdown.includes(`Step ${step}: `), markdown);

      await visit(page, "/episodes?outcome=failure&search=nav_to&where=length+%3E+0");
      const count = Number((await total(page)).match(/of (\d+)/)[1]);
      const rows = JSON.parse(run("sh", "-c", await copied("curl")));
      assert(rows.length === count && rows.some((row) => traceName(row.trace) === trace), `${rows.length} rows, not ${count}`);
      const printed = run("python3", "-c", `${await copied("Python")}\nprint(len(rows))`);
      assert(Number(printed) === count, `${printed}, not ${count}`);
      await page.evaluate(() => localStorage.setItem("reel-token", "secret"));
      await page.reload();
      await open(page).first().waitFor();
      for (const [name, again] of [["curl", (text) => run("sh", "-c", text)], ["Python", (text) => run("python3", "-c", `${text}\nprint(len(rows))`)]]) {
        const text = await copied(name);
        assert(text.includes("REEL_TOKEN") && !text.includes("secret"), text);
        process.env.REEL_TOKEN = "secret";
        again(text);
      }
      await page.evaluate(() => localStorage.removeItem("reel-token"));
      assert((await copied("Markdown")).startsWith("[outcome: failure, “nav\\_to”, length \\> 0]("), "other words");
    });
  } finally {
    rmSync(folder, { recursive: true });
  }
}

/** A few letters lead to a page, to the episodes of a task, to an episode, or to a search, by keyboard alone. */
export async function find_leads_anywhere(browser, { trace }) {
  const [{ task_id: task }] = await sql(`SELECT task_id FROM episodes WHERE trace LIKE '%/${trace}.mcap'`);
  await onPage(browser, async (page) => {
    const dialog = page.getByRole("dialog", { name: "Find" });
    const find = async (text, hit) => {
      await page.keyboard.press("Control+k");
      await dialog.getByRole("combobox").fill(text);
      const at = dialog.getByRole("option", { name: hit });
      await at.first().waitFor();
      for (let left = 40; (await at.first().getAttribute("aria-selected")) !== "true"; left -= 1) {
        assert(left, `the arrow does not reach ${hit}`);
        await page.keyboard.press("ArrowDown");
      }
      await page.keyboard.press("Enter");
      await dialog.waitFor({ state: "hidden" });
    };
    await visit(page, "/");
    await find("comp", /^page Compare/);
    await page.waitForURL(/\/compare/);
    await find(task.slice(-6).toUpperCase(), new RegExp(`^task ${task}`));
    await page.waitForURL((address) => address.searchParams.get("task_id") === task);
    await find(trace, new RegExp(`^episode ${trace}\\s*$`));
    await page.waitForURL((address) => decodeURIComponent(address.pathname) === `/episodes/${trace}`);
    await find("nav_to", /^search “nav_to”/);
    await page.waitForURL(/\/episodes\?search=nav_to/);
    // Signs of SQL are letters, and nothing is found by them but a search.
    await page.keyboard.press("Control+k");
    const answered = page.waitForResponse((answer) => answer.url().endsWith("/api/sql") && answer.request().postData().includes("OR 1=1 --"));
    await dialog.getByRole("combobox").fill("' OR 1=1 --");
    assert((await answered).ok(), "the tables refuse an apostrophe");
    await page.waitForTimeout(100);
    assert((await dialog.getByRole("option").count()) === 1, "an apostrophe finds something");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await page.keyboard.press("Escape");
    await dialog.waitFor({ state: "hidden" });
    // Keys of the page that lies below are at rest while letters are typed.
    await page.getByRole("button", { name: "Find" }).click();
    await dialog.getByRole("combobox").pressSequentially("g e 42");
    assert((await dialog.isVisible()) && (await dialog.getByRole("combobox").inputValue()) === "g e 42", "letters lead away");
    // What comes later comes below: Enter searches, however fast it follows.
    await dialog.getByRole("combobox").fill(task);
    await page.keyboard.press("Enter");
    await page.waitForURL((address) => address.searchParams.get("search") === task);
  });
}

/** `?` lists the keys of the page that is open, as does a button; Escape gives the focus back. */
export async function keys_are_listed(browser, { trace }) {
  for (const { dark, width } of [{ dark: false, width: 1440 }, { dark: true, width: 390 }]) {
    await onPage(browser, async (page) => {
      const dialog = page.getByRole("dialog", { name: "Keys" });
      const ofPage = { "/": [], "/episodes": ["List", "Selection"], "/failures?tab=label": ["Labels"], [`/episodes/${trace}`]: ["Episode", "Image"], "/sql": ["Editor"] };
      for (const [address, groups] of Object.entries(ofPage)) {
        await visit(page, address);
        await page.locator("main h1").first().waitFor({ state: "attached" });
        await page.keyboard.press("?");
        await dialog.waitFor();
        const shown = await dialog.getByRole("heading", { level: 3 }).allInnerTexts();
        for (const group of [...groups, "Every page"]) assert(shown.includes(group), `${address} lists ${shown}`);
        // Nothing goes on beside the box.
        const box = dialog.getByRole("region", { name: "Keys of this page" });
        assert(await box.evaluate((one) => one.scrollWidth <= one.clientWidth), `keys of ${address} are cut off`);
        // Keys of the page are at rest.
        const before = page.url();
        await page.keyboard.press("j");
        assert(page.url() === before, "a key of the page is heard below the dialog");
        const found = await findings(page);
        assert(!found.length, `${address}: ${found.join("; ")}`);
        await page.keyboard.press("Escape");
        await dialog.waitFor({ state: "hidden" });
      }
      await visit(page, "/episodes");
      const search = page.getByRole("searchbox", { name: "Search episodes" });
      await search.press("?");
      assert((await search.inputValue()) === "?" && !(await dialog.isVisible()), "in a field it is a letter");
      const button = page.getByRole("button", { name: "Keys", exact: true });
      await button.click();
      await dialog.waitFor();
      await page.keyboard.press("Escape");
      await dialog.waitFor({ state: "hidden" });
      assert(await button.evaluate((one) => one === document.activeElement), "the focus is not back on the button");
    }, { dark, width });
  }
}

/** What is chosen is saved under a title, comes back from the menu and from Find, and can be replaced and deleted. */
export async function a_view_is_saved(browser) {
  const title = "Failures of two policies";
  const stored = async () => (await (await fetch(`${url}/api/definitions`)).json()).find(({ name }) => name === "failures-of-two-policies")?.definition;
  await onPage(browser, async (page) => {
    const views = page.locator("details", { hasText: "Views" });
    const save = async (button) => {
      await views.locator("summary").click();
      await views.getByLabel("Title of the view").fill(title);
      await views.getByRole("button", { name: button, exact: true }).click();
      await views.getByText(`Saved: ${title}`).waitFor();
    };
    await visit(page, "/episodes?policy=oracle&policy=injected&not_family=FDP&sort=length");
    await save("Save");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    const kept = await stored();
    assert(kept.title === title && kept.view === "/episodes?policy=oracle&policy=injected&not_family=FDP&sort=length", JSON.stringify(kept));
    await views.getByRole("link", { name: title }).waitFor();
    // A panel of that name is not replaced.
    const panel = (await (await fetch(`${url}/api/definitions`)).json()).find(({ definition }) => definition?.sql);
    await views.getByLabel("Title of the view").fill(panel.name);
    await views.getByRole("button", { name: "Save", exact: true }).click();
    await views.getByText(`${panel.name}.json is a panel or a page already`).waitFor();
    assert((await views.getByLabel("Title of the view").inputValue()) === panel.name, "the title is lost");
    // Another list under the same title replaces it.
    await visit(page, "/episodes?outcome=failure");
    await save("Replace");
    assert((await stored()).view.startsWith("/episodes?outcome=failure"), JSON.stringify(await stored()));
    // It is a view of Episodes, found from everywhere, and replaced from there alone.
    await visit(page, "/failures?policy=injected&policy=watched&tab=confusions&by=look");
    await views.locator("summary").click();
    await views.getByText("No view of this page is saved.").waitFor();
    await views.getByLabel("Title of the view").fill(title);
    await views.getByRole("button", { name: "Save", exact: true }).click();
    await views.getByText(`is the view “${title}” of /episodes already`).waitFor();
    await page.keyboard.press("Escape");
    // Tabs keep what is chosen.
    await page.getByRole("link", { name: "Reasons" }).click();
    assert(new URL(page.url()).searchParams.getAll("policy").join() === "injected,watched", page.url());
    await page.keyboard.press("Control+k");
    const dialog = page.getByRole("dialog", { name: "Find" });
    await dialog.getByRole("combobox").fill("two POL");
    await dialog.getByRole("option", { name: `view ${title}` }).click();
    await open(page).first().waitFor();
    assert(parameter(page, "outcome") === "failure" && new URL(page.url()).pathname === "/episodes", page.url());
    await views.locator("summary").click();
    await views.getByRole("button", { name: `Delete the view ${title}` }).click();
    await views.getByText("No view of this page is saved.").waitFor();
    assert(!(await stored()), "the view is there");
  });
}
