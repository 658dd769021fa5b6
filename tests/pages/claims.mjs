/** Claims, from the form to their episodes; and what would help: the job, its rows, and rescued episodes beside their branches. */
import { assert, findings, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const TITLE = "Failures of the tests are confusions";
const FILE = "failures-of-the-tests-are-confusions";
const OF = "NOT success";
const HOLDS = "class = 'Object Confusion'";
const JUDGED = `SELECT e.episode_id, e.trace, e.run_id, coalesce(${HOLDS}, false) AS holds FROM episodes e LEFT JOIN classes c ON c.trace_digest = e.trace_digest
  WHERE e.end_reason <> 'aborted' AND e.parent_trace IS NULL AND (${OF})`;
const VERDICTS = { holds: "holds", open: "cannot tell yet", fails: "fails" };
/** The console tells of every answer that refuses something. */
const REFUSED = { expected: ["status of 422"] };

const forget = (file) => fetch(`${url}/api/definitions/${file}`, { method: "DELETE" });
async function keep(file, definition) {
  const headers = { "content-type": "application/json" };
  const answer = await fetch(`${url}/api/definitions/${file}`, { method: "PUT", headers, body: JSON.stringify(definition) });
  assert(answer.ok, await answer.text());
}
const card = (page) => page.getByRole("region", { name: TITLE, exact: true });
const ready = (page) => until(async () => !(await page.locator("[aria-busy=true]").count()), "everything to be there");
const button = (page, name) => page.getByRole("button", { name, exact: true });

async function clean(page) {
  await ready(page);
  const found = await findings(page);
  const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  if (wider > 0) found.push(`the page is ${wider} pixels wider than the window`);
  assert(!found.length, found.join("; "));
}

/** What is wrong stands at its field, whether the page or the service says so. */
export async function claim_errors_stand_at_their_field(browser) {
  await forget(FILE);
  await keep(FILE, { title: TITLE, claim: { holds: "success" } });
  await onPage(browser, async (page) => {
    await visit(page, "/claims?new=1");
    const field = (label) => page.getByRole("textbox", { name: label });
    const wrong = async (label, part, press = "Try") => {
      await button(page, press).click();
      await until(async () => (await field(label).getAttribute("aria-invalid")) === "true", `${label} to be wrong`);
      const told = await page.locator(`#${await field(label).getAttribute("aria-describedby")}`).innerText();
      assert(told.includes(part), `${label}: '${told}' does not say '${part}'`);
      const others = await page.locator("form [aria-invalid=true]").count();
      assert(others === 1, `${others} fields are wrong, not ${label} alone`);
    };
    await wrong("Condition of the claim", "Write a condition");
    await field("Condition of the claim").fill("succes");
    await wrong("Condition of the claim", "succes");
    // The condition is wrong still, and is not what stands at the counted episodes.
    await field("Condition of the claim").fill("success");
    await field("Counted episodes").fill("familie = 'SUL'");
    await wrong("Counted episodes", "familie");
    await field("Counted episodes").fill("");
    await field("at least").fill("150");
    await wrong("at least", "150");
    await field("at least").fill("50");
    await field("at most").fill("40");
    await wrong("at most", "less than");
    await field("at most").fill("");
    await wrong("Sentence", "Write the sentence", "Keep claim");
    await field("Sentence").fill(TITLE);
    await wrong("Sentence", `${FILE}.json`, "Keep claim");
    await page.getByLabel("calls match a pattern").check();
    await field("Pattern of the claim").fill("pick(");
    await wrong("Pattern of the claim", "pick");
    await clean(page);
  }, REFUSED);
  const [kept] = (await (await fetch(`${url}/api/definitions`)).json()).filter(({ name }) => name === FILE);
  assert(kept.definition.claim.holds === "success", "a claim was replaced unasked");
  await forget(FILE);
}

/** A condition of Episodes becomes a claim: tried, kept, found by its title, changed, and deleted once somebody has said so twice. */
export async function claim_from_a_condition_to_its_episodes(browser) {
  await forget(FILE);
  const judged = await sql(JUDGED);
  const holding = judged.filter(({ holds }) => holds);
  assert(holding.length > 0 && holding.length < judged.length, `${holding.length} of ${judged.length} episodes hold`);
  const counts = `${holding.length} of ${judged.length} (${Math.round((100 * holding.length) / judged.length)}%, 95% interval `;
  await onPage(browser, async (page) => {
    await visit(page, `/episodes?where=${encodeURIComponent(HOLDS)}`);
    await page.locator("summary", { hasText: "Views" }).click();
    await page.getByRole("link", { name: "Claim that" }).click();
    assert((await page.getByLabel("Condition of the claim").inputValue()) === HOLDS, "the condition did not come along");
    await page.getByLabel("Counted episodes").fill(OF);
    await page.getByRole("textbox", { name: "at least" }).fill("99.5");
    await button(page, "Try").click();
    const preview = page.getByRole("region", { name: "What the episodes say" });
    await preview.getByText(`fails: ${counts}`).waitFor();
    assert(!(await card(page).count()), "a claim that was only tried is kept");
    await page.getByLabel("Sentence").fill(TITLE);
    await button(page, "Keep claim").click();
    await card(page).getByText(`fails: ${counts}`).waitFor();
    assert(!page.url().includes("?"), `the form stays in the address: ${page.url()}`);
    const [kept] = (await (await fetch(`${url}/api/definitions`)).json()).filter(({ name }) => name === FILE);
    assert(JSON.stringify(kept.definition.claim) === JSON.stringify({ of: OF, holds: HOLDS, at_least: 0.995 }), JSON.stringify(kept));
    await clean(page);

    // Its episodes are what it says, of different tasks, and open at the step that matters.
    for (const [name, holds] of [["Examples", true], ["Counter-examples", false]]) {
      const links = card(page).getByRole("list", { name, exact: true }).getByRole("link");
      const shown = await links.evaluateAll((all) => all.map((one) => decodeURIComponent(one.pathname.split("/").pop())));
      assert(shown.length > 0 && shown.length <= 3, `${shown.length} ${name}`);
      const right = judged.filter((one) => one.holds === holds).map(({ trace }) => traceName(trace));
      assert(shown.every((trace) => right.includes(trace)), `${shown} are no ${name}: ${right}`);
      // All of them stand in Episodes.
      await card(page).getByRole("region", { name, exact: true }).getByRole("link", { name: "in Episodes" }).click();
      await page.getByRole("navigation", { name: "Pages of the list" }).getByText(` of ${right.length}`).waitFor();
      await page.goBack();
      await links.first().click();
      await page.locator(".view img").first().waitFor();
      assert(page.url().includes(encodeURIComponent(shown[0])), `${page.url()} is not ${shown[0]}`);
      const [{ step }] = await sql(`SELECT coalesce(b.step, c.step) AS step FROM episodes e LEFT JOIN blame b USING (trace_digest) LEFT JOIN classes c USING (trace_digest)
        WHERE e.trace LIKE '%/${shown[0]}.mcap'`);
      assert(parameter(page, "step") === (step === null ? null : String(step)), `${page.url()} is not at step ${step}`);
      await page.goBack();
      await card(page).getByText(`fails: ${counts}`).waitFor();
    }

    await page.keyboard.press("Control+k");
    await page.getByRole("combobox").fill("tests are conf");
    await page.getByRole("option", { name: TITLE }).click();
    await page.waitForURL(`**/claims?claim=${FILE}`);
    await card(page).getByRole("link", { name: "Edit" }).click();
    await page.getByRole("textbox", { name: "at least" }).fill("");
    await page.getByRole("textbox", { name: "at most" }).fill("99.5");
    await button(page, "Keep changes").click();
    await card(page).getByText(`holds: ${counts}`).waitFor();
    await card(page).getByText("promised at most 99.5%").waitFor();

    await card(page).getByRole("button", { name: "Delete …" }).click();
    await button(page, "Keep it").click();
    await card(page).getByRole("button", { name: "Delete …" }).click();
    await button(page, "Delete it").click();
    await page.getByText(`Deleted: ${TITLE}`).waitFor();
    await until(async () => !(await card(page).count()), "the deleted claim to go");
  });
  const left = (await (await fetch(`${url}/api/definitions`)).json()).filter(({ name }) => name === FILE);
  assert(!left.length, "a deleted claim is kept");
}

/** Shares by run, the newest right, and since when the verdict is what it is; on a phone, in the dark. */
export async function claim_goes_over_the_runs(browser) {
  await keep(FILE, { title: TITLE, text: "Which policies succeed.", claim: { holds: "success", at_least: 0.2 } });
  const report = await (await fetch(`${url}/api/claims/${FILE}`)).json();
  assert(report.runs.length > 2, `${report.runs.length} runs`);
  try {
    await onPage(browser, async (page) => {
      await visit(page, `/claims?claim=${FILE}`);
      await card(page).getByRole("img", { name: `Shares of the ${report.runs.length} runs` }).waitFor();
      await card(page).getByText("as a table").click();
      const rows = await card(page).locator("tbody tr").evaluateAll((all) => all.map((row) => [...row.cells].map((cell) => cell.innerText.trim())));
      const wanted = report.runs.toReversed().map(({ run_id, holding, episodes, verdict }) => [run_id ?? "none", `${holding} of ${episodes}`, VERDICTS[verdict]]);
      wanted.forEach(([run, counts, verdict], at) => {
        const [name, , share, told] = rows[at];
        assert(name === run && share.startsWith(counts) && told === verdict, `row ${at} says ${rows[at]}, not ${run}, ${counts}, ${verdict}`);
      });
      if (report.changed) await card(page).getByText(`since run ${report.changed.run_id}; before: ${VERDICTS[report.changed.before]}.`).waitFor();
      await page.getByLabel("Command that checks the claims").getByText("reel claims check").waitFor();
      await clean(page);
      await page.getByRole("link", { name: "All claims" }).click();
      await button(page, "New claim").click();
      await page.getByLabel("Condition of the claim").fill("success");
      await button(page, "Try").click();
      await page.getByRole("region", { name: "What the episodes say" }).getByText("nothing is promised").waitFor();
      await clean(page);
    }, { width: 390, height: 844, dark: true });
  } finally {
    await forget(FILE);
  }
}

const group = (page, name) => page.getByRole("region", { name: `What would help: ${name}`, exact: true });
const points = (share) => (100 * share).toFixed(0);

/** The job attributes failed episodes; each capability says what it cost, and a rescued episode opens beside the branch that succeeds. */
export async function attribution_from_job_to_branch(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/failures?tab=attribution&policy=injected");
    await page.getByRole("button", { name: /^Attribute (again|all failed episodes)$/ }).click();
    await page.getByRole("status").getByText("Attribution of all failed episodes").waitFor();
    await until(async () => (await page.locator(".job .tag").first().innerText()) === "done", "the end of the job");
    await group(page, "injected").waitFor();
    await ready(page);
    const { estimates } = await (await fetch(`${url}/api/attribution`)).json();
    const own = estimates.filter((one) => one.group === "injected");
    assert(own.length === 4, `${own.length} estimates of the policy`);
    const rescued = await sql(`SELECT a.capability, e.trace, a.first_step FROM attribution a JOIN episodes e ON e.trace_digest = a.trace_digest
      WHERE a.success AND e.policy = 'injected' AND e.parent_trace IS NULL ORDER BY e.task_id, e.trace`);
    assert(rescued.length > 0, "no episode was rescued");
    for (const { capability, observed, perfect, difference } of own) {
      const row = group(page, "injected").getByRole("region", { name: capability, exact: true });
      const told = await row.innerText();
      const numbers = `${points(observed)}% → ${points(perfect.value)}% (+${points(difference.value)} points, 95% interval ${points(difference.low)} to ${points(difference.high)})`;
      assert(told.includes(numbers), `${capability}: '${told}' does not say '${numbers}'`);
      const wanted = rescued.filter((one) => one.capability === capability).map(({ trace, first_step }) => `${traceName(trace)} ${first_step}`);
      const shown = await row.getByRole("link").evaluateAll((all) => all.map((one) => `${decodeURIComponent(one.pathname.split("/").pop())} ${new URL(one.href).searchParams.get("step")}`));
      assert(shown.join() === wanted.slice(0, 8).join(), `${capability} rescues ${shown}, not ${wanted}`);
    }
    // The one that would help most comes first.
    const titles = await group(page, "injected").locator("h3").allInnerTexts();
    const gain = (title) => own.find(({ capability }) => capability === title.toLowerCase()).difference.value;
    assert(titles.every((title, at) => at === 0 || gain(titles[at - 1]) >= gain(title)), `in the order ${titles}`);
    await clean(page);
    const [{ trace, capability, first_step }] = rescued;
    await group(page, "injected").getByRole("list", { name: `Rescued by perfect ${capability}` }).getByRole("link").first().click();
    await page.waitForURL(/beside=/);
    assert(parameter(page, "step") === String(first_step) && parameter(page, "beside") === `${traceName(trace)}--perfect-${capability}`, page.url());
    await until(async () => (await page.locator(".view img").count()) > 1, "the images of both");
  });
}

/** Only the policy chooses there; what failed after the job is counted; and nothing overflows on a phone. */
export async function attribution_says_what_it_leaves_out(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/failures?tab=attribution&policy=oracle&family=SUL");
    await page.getByText("of the filters only the policy applies").waitFor();
    await group(page, "oracle").getByText("None of them failed").waitFor();
    let missing = 2;
    await page.route("**/api/sql", (asked) => asked.request().postData().includes("AS missing") ? asked.fulfill({ json: [{ all: 14, missing }] }) : asked.continue());
    await visit(page, "/failures?tab=attribution");
    await page.getByText("2 of 14 failed episodes are not attributed yet").waitFor();
    await group(page, "all episodes").waitFor();
    await clean(page);
    missing = 14;
    await visit(page, "/failures?tab=attribution");
    await page.getByText("Nothing is attributed yet. 14 failed episodes wait for it.").waitFor();
    assert(await button(page, "Attribute all failed episodes").count(), "the job is not offered");
  }, { width: 390, height: 844, dark: true });
}
