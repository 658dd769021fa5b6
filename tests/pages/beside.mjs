/** Two episodes side by side: from Compare, from a selection, of one task, of two tasks, and an episode beside its branch. */
import { assert, findings, moment, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const calls = (page) => page.getByRole("region", { name: "Calls of both episodes" });
const button = (page, name) => page.getByRole("button", { name, exact: true });
const stepsOf = async (trace) => (await fetch(`${url}/api/traces/${encodeURIComponent(trace)}/steps?limit=1000`)).json();
const callText = ({ input: { call } }) => !call.name && !Object.keys(call.arguments ?? {}).length ? "no call" :
  `${call.name}(${Object.entries(call.arguments ?? {}).map(([key, value]) => `${key}=${typeof value === "string" ? value : JSON.stringify(value)}`).join(", ")})`;
const shows = (page, at) => until(async () => (await moment(page)).startsWith(at < 0 ? "start" : `row ${at}`), `row ${at}`);
/** The steps that the two cards of the current call name; null before the first call. */
const cards = async (page) => (await page.locator(".now-a h2, .now-b h2").allInnerTexts()).map((text) => /Step (\d+)/.exec(text)?.[1] ?? null);
const quiet = async (page) => {
  await until(async () => !(await page.locator("[aria-busy=true]").count()), "nothing that loads");
  await page.waitForLoadState("networkidle");
};

/** The rows as the table shows them: the steps of both sides, from the calls in them, and how they compare. Every call names its step. */
async function rowsOf(page, a, b) {
  const shown = await calls(page).locator("tbody tr[data-row]").evaluateAll((rows) => rows.map((row) => ({
    match: row.dataset.match,
    cells: [...row.querySelectorAll("td")].map((cell) => cell.querySelector(".mono")?.textContent.replace(/^✕ /, "") ?? null),
    steps: [...row.querySelectorAll("td")].map((cell) => /^step (\d+)/.exec(cell.innerText)?.[1] ?? null),
  })));
  const next = [0, 0];
  return shown.map(({ match, cells, steps: named }, at) => {
    const sides = cells.length === 1 ? [cells[0], cells[0]] : cells;
    const steps = sides.map((text, side) => {
      if (text === null) return null;
      const step = next[side]++;
      assert(named.at(cells.length === 1 ? 0 : side) === String(step), `row ${at} names step ${named[side]} of side ${side}, not ${step}`);
      assert(callText([a, b][side][step]) === text, `row ${at} has ${text} of side ${side}, whose step ${step} is ${callText([a, b][side][step])}`);
      return step;
    });
    return { steps, match };
  });
}

/** Two policies on one task, of different length: every call stands in a row, and everything follows the row. */
export async function two_episodes_of_a_task_are_aligned(browser) {
  const [{ task_id }] = await sql(`SELECT a.task_id FROM episodes a JOIN episodes b ON a.task_digest = b.task_digest
    WHERE a.policy = 'oracle' AND b.policy = 'planner' AND a.length <> b.length ORDER BY abs(a.length - b.length) DESC, 1`);
  await onPage(browser, async (page) => {
    await visit(page, "/compare?a=oracle&b=planner");
    await page.getByRole("row", { name: task_id }).getByRole("link", { name: "Side by side" }).click();
    await calls(page).waitFor();
    const traces = [decodeURIComponent(new URL(page.url()).pathname.split("/").at(-1)), parameter(page, "beside")];
    const [a, b] = await Promise.all(traces.map(stepsOf));
    const rows = await rowsOf(page, a, b);
    assert(rows.filter(({ steps }) => steps[0] !== null).length === a.length && rows.filter(({ steps }) => steps[1] !== null).length === b.length, "a call is missing");
    for (const { steps, match } of rows) {
      const both = steps.every((step) => step !== null);
      const same = both && callText(a[steps[0]]) === callText(b[steps[1]]);
      assert(match === "one" ? !both : match === "call" ? both && !same : same, `${match}: ${steps}`);
    }
    const heads = await page.locator(".side h2").allInnerTexts();
    assert(heads.join() === "A oracle,B planner", heads.join());
    // Each side shows its last step at or before the row.
    const at = (side, row) => rows.slice(0, row + 1).map(({ steps }) => steps[side]).filter((step) => step !== null).at(-1) ?? null;
    await page.locator("body").press("Home");
    await shows(page, -1);
    for (let row = 0; row < rows.length; row += 1) {
      await page.keyboard.press("ArrowRight");
      await shows(page, row);
      const expected = [at(0, row), at(1, row)].map((step) => (step === null ? null : String(step)));
      await until(async () => JSON.stringify(await cards(page)) === JSON.stringify(expected), `steps ${expected} at row ${row}`);
      assert(parameter(page, "step") === expected[0] && parameter(page, "row") === String(row), page.url());
      // The clock names the step of each, and the images are what each robot saw when it chose the call; a side without a call stays where it was.
      const { steps } = rows[row];
      const clock = await moment(page);
      assert(steps.every((step, side) => clock.includes(`${"AB"[side]} ${step === null ? "no call" : `step ${step}`}`)), `${clock}, not ${steps}`);
      const images = expected.map((step, side) => `What the head camera shows ${step === null ? "before the first call" : `${steps[side] === null ? "after" : "before"} step ${step}`}`);
      await until(async () => (await page.locator(".view img").evaluateAll((all) => all.map(({ alt }) => alt))).join() === images.join(), images.join());
    }
    assert((await page.locator("figure svg").count()) === 2, "not two maps");
    // A line marks where they part.
    const first = rows.findIndex(({ match }) => match !== "same");
    const parting = calls(page).locator("tr.parting");
    assert((await parting.count()) === (first > 0 ? 1 : 0), "no line where they part");
    if (first > 0) assert((await parting.locator("+ tr").getAttribute("data-row")) === String(first), "they part elsewhere");
    // From difference to difference, to the last one.
    const different = rows.flatMap(({ match }, row) => (["call", "one", "outcome"].includes(match) ? [row] : []));
    assert(different.length > 0, "nothing differs");
    await page.keyboard.press("Home");
    for (const row of different) {
      await page.keyboard.press("x");
      await shows(page, row);
    }
    assert(await page.getByRole("button", { name: "Next difference" }).isDisabled(), "there is a difference after the last one");
    await quiet(page);
    for (const chart of ["Reward up to every row", "Cost to go of"]) {
      const label = await page.getByRole("img", { name: chart }).getAttribute("aria-label");
      assert(["A (oracle)", "B (planner)"].every((name) => label.includes(name)), label);
    }
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    // Exchanged, they have the same rows, and the clock stands where it stood.
    const clock = async () => (await moment(page)).split("\n")[0];
    const before = await clock();
    const exchange = page.getByRole("button", { name: "Exchange the sides" });
    await exchange.click();
    await until(async () => (await page.locator(".side h2").allInnerTexts()).join() === "A planner,B oracle", "the sides are exchanged");
    assert((await clock()) === before, `${before} is now ${await clock()}`);
    assert(await exchange.evaluate((button) => button === document.activeElement), "the focus is lost");
    const back = await rowsOf(page, b, a);
    assert(JSON.stringify(back.map(({ steps }) => steps.toReversed())) === JSON.stringify(rows.map(({ steps }) => steps)), "other rows");
    // Closed, the page stays at the step of its own episode.
    const step = parameter(page, "step");
    await page.getByRole("button", { name: "Close the comparison" }).click();
    await until(async () => (await moment(page)).startsWith(`step ${step}`), `step ${step}`);
    assert(parameter(page, "beside") === null && parameter(page, "row") === null, page.url());
  });
}

/** Episodes of different tasks stand call by call; the page says that they are not aligned, and what differs. */
export async function episodes_of_different_tasks_are_not_aligned(browser) {
  const [one, other] = await sql(`SELECT a.* FROM (SELECT task_id, trace, length, instruction, family, seed FROM episodes
    WHERE policy = 'oracle' AND parent_trace IS NULL ORDER BY task_id) a`);
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${traceName(one.trace)}?beside=${traceName(other.trace)}&step=2`);
    await page.getByRole("note").getByText("These episodes play different tasks").waitFor();
    const differs = (await page.getByRole("note").innerText()).split("What differs:")[1];
    for (const [name, unlike] of [["instruction", one.instruction !== other.instruction], ["family", one.family !== other.family], ["seed", one.seed !== other.seed]]) {
      assert(differs?.includes(name) === unlike, `${name}: ${differs}`);
    }
    const shown = await calls(page).locator("tbody tr[data-row]").count();
    assert(shown === Math.max(one.length, other.length), `${shown} rows of ${one.length} and ${other.length} calls`);
    await shows(page, 2);
    assert((await cards(page)).join() === "2,2", (await cards(page)).join());
    assert(!(await page.getByRole("button", { name: "Next difference" }).count()), "calls that are not compared have no difference");
    assert((await page.locator(".side").last().innerText()).includes(other.task_id), "the other task is not named");
  });
}

/** Runs are compared as policies are; a pair keeps A left and B right, and opens at the decisive step of the one that failed. */
export async function runs_are_compared(browser, { trace, step }) {
  const [failed] = await sql(`SELECT run_id, task_id FROM episodes WHERE trace LIKE '%/${trace}.mcap'`);
  const [{ run_id, n }] = await sql(`SELECT run_id, count(*) AS n FROM episodes WHERE policy = 'oracle' AND end_reason IS NOT NULL AND parent_trace IS NULL
    GROUP BY run_id HAVING bool_or(success AND task_id = '${failed.task_id}') ORDER BY run_id`);
  await onPage(browser, async (page) => {
    await visit(page, "/compare");
    await page.getByRole("button", { name: "Runs" }).click();
    await page.locator("table tbody tr").first().waitFor();
    assert((await page.locator("option").allInnerTexts()).includes(`${run_id} (${n} episodes)`), "the run is not offered");
    assert(!(await page.locator("option", { hasText: "branch" }).count()), "a branch is a run");
    // The run that solved the task is A, and stands left.
    await visit(page, `/compare?of=run&a=${encodeURIComponent(run_id)}&b=${encodeURIComponent(failed.run_id)}&pair=name`);
    const pairs = page.locator("table tbody tr");
    await pairs.first().waitFor();
    const [{ tasks }] = await sql(`SELECT count(*) AS tasks FROM (SELECT task_id FROM episodes WHERE run_id = '${run_id}' AND parent_trace IS NULL
      INTERSECT SELECT task_id FROM episodes WHERE run_id = '${failed.run_id}' AND parent_trace IS NULL)`);
    assert((await pairs.count()) === Number(tasks), `${await pairs.count()} pairs of ${tasks} tasks`);
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await page.getByRole("row", { name: failed.task_id }).getByRole("link", { name: "Side by side" }).click();
    await calls(page).waitFor();
    const second = parameter(page, "beside");
    const [{ success, decisive }] = await sql(`SELECT e.success, b.step AS decisive FROM episodes e LEFT JOIN blame b ON b.trace_digest = e.trace_digest
      WHERE e.trace LIKE '%/${second}.mcap'`);
    assert(!success && parameter(page, "beside_step") === String(decisive), `${page.url()}: success ${success}, decisive step ${decisive}`);
    assert((await page.locator(".side .tag").allInnerTexts()).map((text) => text[0]).join() === "✓,✕", "not A beside B");
    await until(async () => (await moment(page)).includes(`B step ${decisive}`), `step ${decisive} of B`);
    assert((await button(page, "Before the call").getAttribute("aria-pressed")) === "true", "not what the robot saw when it chose the call");
    assert(second !== trace || decisive === step, "the step of another episode");
    // From a row without a step of A, closing leads to where A stands.
    await page.keyboard.press("ArrowRight");
    await until(() => parameter(page, "beside_step") === null, "an address of the row");
    const stood = (await cards(page))[0];
    await page.getByRole("button", { name: "Close the comparison" }).click();
    await until(async () => (await moment(page)).startsWith(stood === null ? "start" : `step ${stood}`), `step ${stood} of A`);
    await visit(page, "/compare?of=checkpoint");
    await page.getByRole("heading", { name: /checkpoints yet to compare|Tasks solved/ }).waitFor();
  });
}

/** Two episodes of a list, and only two, can stand side by side. */
export async function two_selected_episodes_stand_side_by_side(browser) {
  await onPage(browser, async (page) => {
    await visit(page, "/episodes?policy=oracle");
    const boxes = page.locator("tbody input[type=checkbox]");
    const link = page.getByRole("link", { name: "Side by side" });
    await boxes.nth(0).check();
    await page.getByText("1 selected").waitFor();
    assert(!(await link.count()), "one episode beside nothing");
    await boxes.nth(1).check();
    await link.waitFor();
    await boxes.nth(2).check();
    await page.getByText("3 selected").waitFor();
    assert(!(await link.count()), "three episodes side by side");
    await boxes.nth(2).uncheck();
    // The one that was selected first is A.
    await boxes.nth(0).uncheck();
    await boxes.nth(0).check();
    const [second, first] = (await page.locator("a.open").evaluateAll((links) => links.slice(0, 2).map(({ pathname }) => pathname.split("/").at(-1)))).map(decodeURIComponent);
    await link.click();
    await calls(page).waitFor();
    assert(page.url().includes(`/episodes/${encodeURIComponent(first)}?`) && parameter(page, "beside") === second, page.url());
  });
}

/** A branch shares the calls before it; the address of an older link names it `branch`. */
export async function a_branch_stands_beside_its_parent(browser, { trace, step }) {
  const made = await fetch(`${url}/api/traces/${trace}/branches`, {
    method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ at: step, policy: "oracle", name: `beside-${Date.now()}` }),
  });
  assert(made.status === 201, await made.clone().text());
  const branch = (await made.json()).trace;
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?branch=${branch}`);
    await calls(page).waitFor();
    const rows = await rowsOf(page, await stepsOf(trace), await stepsOf(branch));
    assert((await page.getByRole("note").innerText()).includes(`B is a branch of A, from step ${step} on.`), "the page does not say that it is a branch");
    const parting = calls(page).locator("tr.parting");
    assert((await parting.count()) === (step > 0 ? 1 : 0), "no line where the branch begins");
    if (step > 0) {
      assert((await parting.innerText()).startsWith(`B branches from A before step ${step}`), await parting.innerText());
      assert((await parting.locator("+ tr").getAttribute("data-row")) === String(step), "the branch begins elsewhere");
    }
    assert(rows.slice(0, step).every(({ steps: [a, b], match }, at) => a === at && b === at && match === "same"), "the calls before the branch are not shared");
    await page.keyboard.press("d");
    await shows(page, rows.findIndex(({ steps }) => steps[0] === step));
    await page.getByRole("button", { name: "Close the comparison" }).click();
    await until(async () => (await moment(page)).startsWith(`step ${step}`), `step ${step}`);
    assert(parameter(page, "branch") === null, page.url());
  });
  // One that is not there is told, and can be closed.
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?beside=nothing&step=${step}`);
    await page.getByRole("alert").waitFor();
    await page.getByRole("button", { name: "Close the comparison" }).click();
    await until(async () => !(await page.getByRole("alert").count()), "no problem any more");
  }, { expected: ["404"] });
}

/** On a phone, in the dark. */
export async function side_by_side_fits_a_phone(browser) {
  const [{ a, b }] = await sql(`SELECT a.trace AS a, b.trace AS b FROM episodes a JOIN episodes b ON a.task_digest = b.task_digest
    WHERE a.policy = 'oracle' AND b.policy = 'planner' ORDER BY a.task_id`);
  await onPage(browser, async (page) => {
    for (const address of [`/episodes/${traceName(a)}?beside=${traceName(b)}&step=3`, "/compare?of=run"]) {
      await visit(page, address);
      await page.locator("table tbody tr").first().waitFor();
      await quiet(page);
      const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
      assert(wider <= 0, `${address} is ${wider} pixels wider than the window`);
      const found = await findings(page);
      assert(!found.length, `${address}: ${found.join("; ")}`);
    }
  }, { width: 390, dark: true });
}
