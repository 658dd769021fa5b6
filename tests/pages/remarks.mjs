/** Stars, tags and comments: on the page of an episode, in the list, and on a selection. */
import { assert, findings, moment, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const [FIRST, ...OTHERS] = await sql(
  `SELECT episode_id, trace FROM episodes WHERE parent_trace IS NULL AND length > 4 AND end_reason IS NOT NULL
  ORDER BY trace LIMIT 4`,
);
const pageOf = ({ trace }, query = "") => `/episodes/${traceName(trace)}${query}`;
const remarks = async (episode = "") => (await fetch(`${url}/api/remarks${episode && `?episode=${episode}`}`)).json();
const by = async (author) => (await remarks()).filter((remark) => remark.author === author);

async function put(remark) {
  const headers = { "content-type": "application/json" };
  const body = JSON.stringify({ text: "", ...remark });
  const answer = await fetch(`${url}/api/remarks`, { method: "POST", headers, body });
  assert(answer.status === 201, await answer.text());
}
/** Other tests count what is said in episodes. */
async function forget(...authors) {
  for (const { episode_id, author, kind, text, step } of await remarks()) {
    if (!authors.includes(author)) continue;
    const key = new URLSearchParams({ author, kind, text, ...(step === null ? {} : { step }) });
    const answer = await fetch(`${url}/api/remarks/${episode_id}?${key}`, { method: "DELETE" });
    assert(answer.status === 204, await answer.text());
  }
}
const button = (page, name) => page.getByRole("button", { name, exact: true });
/** The page shows a change at once; here it is in the tables, too. */
const stored = (page) => until(async () => !(await page.getByText("Storing …").count()), "the change stored");
async function said(page, text) {
  await page.getByRole("status").getByText(text).first().waitFor();
  await stored(page);
}
async function undo(page) {
  await button(page, "Undo").click();
  await until(async () => !(await button(page, "Undo").count()), "the change taken back");
  await stored(page);
}
async function clean(page) {
  // What is not there yet is dimmed.
  await until(async () => !(await page.locator('[aria-busy="true"]').count()), "a page at rest");
  const found = await findings(page);
  const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  assert(!found.length && wider <= 0, `${wider} pixels wider; ${found.join("; ")}`);
}

/** A star by key, under a name that is asked for once, and tags; each is taken back, and there when the page comes again. */
export async function an_episode_is_starred_and_tagged(browser) {
  const [author, other] = [`star ${Date.now()}`, `other ${Date.now()}`];
  await put({ episode: FIRST.episode_id, kind: "tag", text: "of another", author: other });
  try {
    await onPage(browser, async (page) => {
      await visit(page, pageOf(FIRST, "?step=1"));
      const star = page.locator("button[aria-pressed]", { hasText: "Star" });
      await star.waitFor();
      await page.keyboard.press("s");
      await page.getByLabel("Your name").fill(author);
      await page.keyboard.press("Enter");
      await said(page, "Starred.");
      await until(async () => (await star.getAttribute("aria-pressed")) === "true", "the star");
      await undo(page);
      await until(async () => (await by(author)).length === 0, "no star, because it was undone");
      await until(async () => (await star.getAttribute("aria-pressed")) === "false", "the page without the star");
      await page.locator("h1").click();
      await page.keyboard.press("s");
      await said(page, "Starred.");
      await until(async () => (await star.getAttribute("aria-pressed")) === "true", "the star once more");
      await page.locator("h1").click();
      await page.keyboard.press("s");
      await said(page, "Star removed.");
      await until(async () => (await by(author)).length === 0, "no star in the tables");
      await undo(page);
      await until(async () => (await by(author)).length === 1, "the star again");
      assert((await by(author))[0].kind === "star", JSON.stringify(await by(author)));

      await page.getByRole("button", { name: "Add a tag" }).click();
      const field = page.getByLabel("New tag");
      await field.fill("one, two");
      await page.getByText("A tag has no comma").waitFor();
      await field.fill("look at this");
      await page.keyboard.press("Enter");
      await said(page, "Tagged “look at this”.");
      await page.locator("datalist option[value='of another']").waitFor({ state: "attached" });
      await page.keyboard.press("Escape");
      const tags = page.getByRole("list", { name: "Tags" });
      await tags.getByRole("link", { name: "look at this" }).waitFor();
      assert(!(await button(page, "Remove tag of another").count()), "a tag of another can be removed");
      await button(page, "Remove tag look at this").click();
      await said(page, "Tag “look at this” removed.");
      await undo(page);
      await page.reload();
      await button(page, "Remove tag look at this").waitFor();
      assert((await star.getAttribute("aria-pressed")) === "true", "the star is gone");
      for (const colorScheme of ["light", "dark"]) {
        await page.emulateMedia({ colorScheme });
        await clean(page);
      }
      // `g s` leads to SQL, and stars nothing.
      await page.locator("h1").click();
      await page.keyboard.press("g");
      await page.keyboard.press("s");
      await page.waitForURL(/\/sql/);
      assert((await by(author)).some(({ kind }) => kind === "star"), "`g s` took the star");
    });
  } finally {
    await forget(author, other);
  }
}

/** Nothing that is done while the tables are written gets lost: it shows at once and is stored in its order. */
export async function remarks_wait_for_nobody(browser) {
  const author = `fast ${Date.now()}`;
  try {
    await onPage(browser, async (page) => {
      await visit(page, pageOf(FIRST, "?step=1"));
      const star = page.locator("button[aria-pressed]", { hasText: "Star" });
      await star.waitFor();
      const pressed = async () => (await star.getAttribute("aria-pressed")) === "true";
      // The star waits for the name, and so does the tag.
      await page.keyboard.press("s");
      await page.getByLabel("Your name").waitFor();
      await page.getByRole("button", { name: "Add a tag" }).click();
      await page.getByLabel("New tag").fill("at once");
      await page.keyboard.press("Enter");
      await page.getByLabel("Your name").fill(author);
      await page.keyboard.press("Enter");
      await page.getByText("Storing …").first().waitFor();
      assert(await pressed(), "the star waits for the tables");
      await button(page, "Remove tag at once").click();
      await button(page, "Undo").click();
      await page.getByLabel("New tag").fill("another");
      await page.keyboard.press("Enter");
      assert(await page.getByText("Storing …").count(), "it was stored before the test could be faster");
      await page.locator("h1").click();
      for (const on of [false, true, false]) {
        await page.keyboard.press("s");
        await until(async () => (await pressed()) === on, `star ${on} at once`);
      }
      await stored(page);
      const texts = (await by(author)).map(({ text }) => text).sort();
      assert(texts.join() === "another,at once", texts.join());
      const tags = page.getByRole("list", { name: "Tags" });
      for (const text of texts) await tags.getByRole("link", { name: text }).waitFor();
      assert(!(await pressed()), "the star is back");
    });
    // What the service refuses is taken back on the page, and kept to be tried again.
    await onPage(browser, async (page) => {
      await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
      await page.route("**/api/remarks", (route) => (route.request().method() === "POST" ?
        route.fulfill({ status: 507, json: { error: { code: "disk", message: "the disk is full" } } }) : route.continue()));
      await visit(page, pageOf(FIRST, "?step=1&comments=1"));
      const field = page.getByLabel("New comment");
      await field.fill("Lost?");
      await button(page, "Comment").click();
      await page.getByRole("alert").getByText("the disk is full").waitFor();
      await until(async () => (await field.inputValue()) === "Lost?", "the comment in its field");
      assert(!(await page.getByRole("article", { name: `Comment of ${author}` }).count()), "what was refused shows");
    }, { expected: ["507"] });
  } finally {
    await forget(author);
  }
}

/** A comment on a step shows in the transcript and leads there; its author changes and deletes it, nobody else. */
export async function an_episode_is_commented(browser) {
  const [author, other] = [`comment ${Date.now()}`, `other ${Date.now()}`];
  await put({ episode: FIRST.episode_id, kind: "comment", text: "I see\nno cup *there*", step: 3, author: other });
  await put({ episode: FIRST.episode_id, kind: "tag", text: "odd", author: other });
  try {
    for (const options of [{ width: 390, height: 844 }, { dark: true }]) {
      await onPage(browser, async (page) => {
        await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
        await visit(page, pageOf(FIRST, "?step=1"));
        await page.getByText("✎ 1 comment").waitFor();
        await page.getByRole("button", { name: /^Comments/ }).click();
        const comment = (name) => page.getByRole("article", { name: `Comment of ${name}` });
        await comment(other).getByRole("button", { name: "step 3" }).click();
        await until(async () => (await moment(page)).startsWith("step 3"), "the step of the comment");
        const changes = comment(other).getByRole("button", { name: /Edit|Delete/ });
        assert(!(await changes.count()), "another's comment can be changed");
        const field = page.getByLabel("New comment");
        await field.fill("The kettle hides it");
        await button(page, "Transcript").click();
        await page.getByRole("button", { name: /^Comments/ }).click();
        assert((await field.inputValue()) === "The kettle hides it", "the draft is gone");
        await field.press("Control+Enter");
        await said(page, "Comment stored.");
        await until(async () => (await field.inputValue()) === "", "an empty field");
        assert((await by(author))[0].step === 3, JSON.stringify(await by(author)));
        await comment(author).getByRole("button", { name: "Edit" }).click();
        await page.getByLabel("Text of the comment").fill("The pan hides it");
        await button(page, "Save").click();
        await said(page, "Comment changed.");
        await comment(author).getByText("The pan hides it").waitFor();
        assert((await by(author)).length === 1, JSON.stringify(await by(author)));
        await undo(page);
        await comment(author).getByText("The kettle hides it").waitFor();
        await page.getByLabel("about step 3 only").uncheck();
        await field.fill("Worth a look");
        await button(page, "Comment").click();
        await page.getByText("whole episode", { exact: true }).waitFor();
        await stored(page);
        await clean(page);
        await page.reload();
        await comment(author).nth(1).waitFor();
        assert(parameter(page, "comments") === "1", page.url());
        await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
        await page.getByText("Copy …").click();
        await button(page, "Markdown").click();
        await page.getByText("Copied: Markdown").waitFor();
        const copied = await page.evaluate(() => navigator.clipboard.readText());
        for (const line of ["- Tags: odd", `- ${other}, step 3: I see no cup \\*there\\*`, `- ${author}: Worth a look`]) {
          assert(copied.split("\n").includes(line), `no '${line}' in ${copied}`);
        }
        await comment(author).last().getByRole("button", { name: "Delete" }).click();
        await said(page, "Comment deleted.");
        await button(page, "Transcript").click();
        await page.getByText("✎ 2 comments").waitFor();
      }, options);
      await forget(author);
    }
  } finally {
    await forget(author, other);
  }
}

/** Columns and facets of the list, what is left out, and what is found by its words. */
export async function a_list_shows_stars_tags_and_comments(browser) {
  const [author, tag] = [`list ${Date.now()}`, `tag ${Date.now()}`];
  const of = { episode: FIRST.episode_id, author };
  const words = `Unlikely words ${Date.now()}`;
  await put({ ...of, kind: "star" });
  await put({ ...of, kind: "tag", text: tag });
  await put({ ...of, kind: "tag", text: `${tag} more` });
  await put({ ...of, kind: "comment", text: `${words} of mine`, step: 2 });
  await put({ ...of, episode: OTHERS[0].episode_id, kind: "tag", text: tag });
  const [{ n }] = await sql("SELECT count(*) AS n FROM episodes WHERE parent_trace IS NULL");
  try {
    await onPage(browser, async (page) => {
      await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
      await visit(page, "/episodes?columns=task_id,starred_by,tags,comments&sort=tags");
      const row = page.getByRole("row", { name: new RegExp(`${tag}, ${tag} more`) });
      await row.getByRole("cell", { name: author, exact: true }).waitFor();
      const filters = page.getByRole("complementary", { name: "Filters" });
      const pages = page.getByRole("navigation", { name: "Pages of the list" });
      const total = (expected, what) =>
        until(async () => (await pages.innerText()).endsWith(` of ${expected}`), `${expected} ${what}`);
      const value = (name) => filters.locator(".value", { hasText: new RegExp(`^${name}\\s*\\d+$`) });
      await value(`${author} \\(you\\)`).click();
      await total(1, "starred by me");
      await clean(page);
      await button(page, "Clear filters").click();
      await total(n, "without a filter");
      await value("anyone").click();
      await row.waitFor();
      await button(page, "Clear filters").click();
      await total(n, "without a filter");
      await until(async () => (await value(tag).innerText()).endsWith("2"), "two episodes with the tag");
      await value(tag).click();
      await total(2, "tagged");
      await value(`${tag} more`).hover();
      await filters.getByRole("button", { name: `Not ${tag} more` }).click();
      await total(1, "tagged with one only");
      assert(parameter(page, "not_tags") === `${tag} more`, page.url());
      await visit(page, `/episodes?not_tags=${encodeURIComponent(tag)}`);
      await total(n - 2, "not tagged");
      await visit(page, "/episodes?columns=comments");
      await value("some").click();
      await until(() => parameter(page, "commented") === "some", "the facet in the address");
      // The words of a comment lead to its step.
      await visit(page, `/episodes?search=${encodeURIComponent(words.toLowerCase())}`);
      await total(1, "with the words");
      const told = await page.locator("tr.found").innerText();
      assert(told.startsWith(`step 2, comment: ${words}`), told);
      assert((await page.locator("a.open").first().getAttribute("href")).includes("step=2"), "another step");
      // So does the search of all pages.
      await page.keyboard.press("Control+k");
      await page.getByRole("dialog").getByRole("combobox").fill(words);
      await page.getByRole("option", { name: /^comment/ }).click();
      await page.getByRole("article", { name: `Comment of ${author}` }).waitFor();
      await page.keyboard.press("Control+k");
      await page.getByRole("dialog").getByRole("combobox").fill(tag);
      await page.getByRole("option", { name: new RegExp(`^tag ${tag} 2 episodes`) }).click();
      await total(2, "tagged");
    });
  } finally {
    await forget(author);
  }
}

/** A selection is starred and tagged at once; what fails is told in a sentence, and the others go on. */
export async function a_selection_is_tagged(browser) {
  const author = `many ${Date.now()}`;
  const tag = `bulk ${Date.now()}`;
  try {
    await onPage(browser, async (page) => {
      await page.addInitScript((author) => localStorage.setItem("reel-author", author), author);
      const ids = OTHERS.map(({ episode_id }) => `'${episode_id}'`).join(",");
      await visit(page, `/episodes?columns=task_id,starred_by,tags&where=${encodeURIComponent(`episode_id IN (${ids})`)}`);
      await page.getByLabel("Select this page").check();
      const bulk = page.getByRole("region", { name: "Selected episodes" });
      // The episodes of the list, and not the branches below them.
      const count = Number((await bulk.locator("strong").innerText()).split(" ")[0]);
      await bulk.getByRole("button", { name: "Star, tag…" }).click();
      await bulk.getByRole("button", { name: `★ Star ${count}` }).click();
      await bulk.getByText(`Starred ${count} episodes.`).waitFor();
      await page.route("**/api/remarks", async (route) => {
        const refused = route.request().postDataJSON()?.episode === OTHERS[0].episode_id;
        const body = JSON.stringify({ error: { code: "bad_remark", message: "this one is refused" } });
        await (refused ? route.fulfill({ status: 422, contentType: "application/json", body }) : route.continue());
      });
      await bulk.getByRole("textbox", { name: "Tag" }).or(bulk.getByRole("combobox", { name: "Tag" })).fill(tag);
      await bulk.getByRole("button", { name: `Tag ${count}` }).click();
      await bulk.getByText(`Tagged “${tag}”: ${count - 1} of ${count} episodes.`).waitFor();
      await bulk.getByText("1 episode failed: this one is refused").waitFor();
      const cells = page.getByRole("cell", { name: tag, exact: true });
      await until(async () => (await cells.count()) === count - 1, "the tags in the list");
      const stored = await by(author);
      const stars = stored.filter(({ kind }) => kind === "star").length;
      const tags = stored.filter(({ text }) => text === tag).length;
      assert(stars === count && tags === count - 1, JSON.stringify(stored));
      await until(async () => !(await page.locator("[aria-busy=true]").count()), "the rows");
      await clean(page);
    }, { expected: ["422"] });
  } finally {
    await forget(author);
  }
}

/** Whoever stars and goes on at once is told on the next page, by the episode's name, whether the star was stored. */
export async function the_next_page_tells_what_became_of_a_change(browser) {
  const list = "policy=injected";
  const named = await sql("SELECT episode_id, trace FROM episodes WHERE policy = 'injected'");
  const author = `next ${Date.now()}`;
  const starred = async () => (await (await fetch(`${url}/api/remarks`)).json()).filter((remark) => remark.author === author);
  await onPage(browser, async (page) => {
    let refuse = false;
    let release = null;
    await page.route("**/api/remarks", async (route) => {
      if (route.request().method() !== "POST") return route.continue();
      await new Promise((go) => (release = go));
      if (!refuse) return route.continue();
      return route.fulfill({ status: 500, contentType: "application/json", body: JSON.stringify({ error: { code: "internal", message: "The disk is full." } }) });
    });
    const next = page.getByRole("link", { name: "Next →" });
    const previous = page.getByRole("link", { name: "← Previous" });
    await visit(page, `/episodes/${traceName(named[0].trace)}?list=${encodeURIComponent(list)}`);
    await next.or(previous).first().waitFor();
    const key = (await next.count()) ? "n" : "p";
    const back = key === "n" ? "p" : "n";
    for (const [direction, refused] of [[key, false], [back, true]]) {
      refuse = refused;
      const here = decodeURIComponent(new URL(page.url()).pathname.split("/").at(-1));
      await page.locator("button[aria-pressed]", { hasText: "Star" }).waitFor();
      await (direction === "n" ? next : previous).waitFor();
      await page.locator("body").press("s");
      if (!refused) {
        await page.getByLabel("Your name").fill(author);
        await page.keyboard.press("Enter");
        await page.getByText("Storing …").waitFor();
      }
      await page.locator("body").press(direction);
      await until(() => !page.url().includes(`/${encodeURIComponent(here)}`), "the next page");
      await page.getByRole("status").getByText(`Starred. Being stored for ${here}.`).waitFor();
      await until(() => release, "the request");
      release();
      release = null;
      if (refused) {
        const alert = page.getByRole("alert").filter({ hasText: `Not stored for ${here}` });
        await alert.getByText("The disk is full.").waitFor();
        const found = await findings(page);
        assert(!found.length, found.join("; "));
        await alert.getByRole("button", { name: "Dismiss" }).click();
        await alert.waitFor({ state: "hidden" });
      } else {
        await page.getByRole("status").getByText(`Starred. Stored for ${here}.`).waitFor();
        const { episode_id } = named.find(({ trace }) => traceName(trace) === here);
        const all = await starred();
        assert(all.length === 1 && all[0].episode_id === episode_id, JSON.stringify(all));
      }
    }
  }, { expected: ["500"] });
  for (const { episode_id } of await starred()) {
    await fetch(`${url}/api/remarks/${episode_id}?${new URLSearchParams({ author, kind: "star", text: "" })}`, { method: "DELETE" });
  }
}
