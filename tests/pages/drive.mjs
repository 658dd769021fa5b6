/** A person is the robot: drives by clicks and by keyboard, hands back, and leaves a trace with a name; markers are named wherever they are. */
import { assert, findings, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const json = async (path, options) => (await fetch(`${url}${path}`, options)).json();

/** A recorded step that picks something up by its marker, and the marker. */
async function picking() {
  const [row] = await sql(`SELECT e.trace, s.step, e.instruction FROM steps s JOIN episodes e ON e.episode_id = s.episode_id
    WHERE s.tool = 'pick' AND s.error_code IS NULL AND s.goal_object AND e.parent_trace IS NULL AND e.policy = 'oracle' ORDER BY 1, 2 LIMIT 1`);
  const trace = traceName(row.trace);
  const steps = await json(`/api/traces/${trace}/steps?limit=1000`);
  return { trace, step: row.step, instruction: row.instruction, marker: steps[row.step].input.call.arguments.marker_id, steps };
}

const begin = async (page, name) => {
  await page.getByLabel("Your name").fill(name);
  await page.keyboard.press("Enter");
  await page.getByText("What the agent sees now").waitFor();
};
const left = async (page) => Number((await page.locator(".facts").getByText(/decisions? left/).innerText()).split(" ")[0]);
const own = (page) => page.locator(".script li.you");
/** The trace that is recorded, as the page says it. */
const recorded = (page) => page.locator(".facts code").nth(1).innerText();

/** From a step of an episode: markers are clicked, a refusal is shown, a reload loses nothing, leaving is asked, the planner succeeds from there. */
export async function drive_by_clicking_and_hand_back(browser) {
  const { trace, step, marker, instruction } = await picking();
  await onPage(browser, async (page) => {
    const asked = [];
    let accept = false;
    page.on("dialog", (dialog) => {
      asked.push(dialog.type());
      void (accept || dialog.type() === "beforeunload" ? dialog.accept() : dialog.dismiss());
    });
    await visit(page, `/episodes/${trace}?step=${step}`);
    await page.getByRole("link", { name: "Be the robot" }).click();
    await page.getByRole("heading", { name: "Be the robot" }).waitFor();
    assert(new URL(page.url()).pathname === `/drive/${trace}` && parameter(page, "call") === String(step), page.url());
    await begin(page, "Änn O. Neil");
    const main = await page.locator("main").innerText();
    assert(main.includes(instruction) && main.includes("person-Ann-O.-Neil"), main.slice(0, 400));
    const decisions = await left(page);
    // A click on a number fills it in, for the tool that it is for while the hand is empty.
    await page.locator(`[data-marker="${marker}"].label`).click();
    assert((await page.getByLabel("marker_id").inputValue()) === String(marker), "the marker is not filled in");
    assert(await page.getByRole("radio", { name: /^pick/ }).isChecked(), "pick is not chosen");
    await page.getByLabel("Why").fill("It is what was asked for.");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
    await page.getByRole("button", { name: "Make the call" }).click();
    await own(page).first().waitFor();
    await page.getByText(`holds marker ${marker}`).waitFor();
    // The hand is full: once more is refused by the tool, which the page shows.
    await page.getByRole("radio", { name: /^pick/ }).check();
    await page.getByLabel("marker_id").selectOption(String(marker));
    await page.getByRole("button", { name: "Make the call" }).click();
    await own(page).nth(1).waitFor();
    await page.locator(".told .bad").waitFor();
    assert((await left(page)) === decisions - 2, `${await left(page)} of ${decisions}`);
    const name = await recorded(page);

    await page.reload();
    await own(page).nth(1).waitFor();
    assert((await left(page)) === decisions - 2 && (await page.locator("figure img").count()) === 1, "the reload lost something");
    assert(asked.join() === "beforeunload", asked.join());
    await page.getByRole("link", { name: "Overview" }).click();
    assert(asked.at(-1) === "confirm" && new URL(page.url()).pathname === `/drive/${trace}`, `${asked} ${page.url()}`);

    await page.getByRole("button", { name: "Hand back …" }).click();
    await page.getByRole("radio", { name: "planner goes on" }).check();
    await page.getByRole("button", { name: "Hand back and compare" }).click();
    await until(() => new URL(page.url()).pathname === `/episodes/${trace}`, "the comparison");
    assert(parameter(page, "step") === String(step) || parameter(page, "row") !== null, page.url());
    const branch = parameter(page, "beside");
    await page.locator(".view img").nth(1).waitFor();
    assert(asked.length === 2, `asked on the way to the comparison: ${asked}`);

    const [mine, after] = [await json(`/api/traces/${name}/episode`), await json(`/api/traces/${branch}/episode`)];
    const steps = await json(`/api/traces/${name}/steps?limit=1000`);
    assert(mine.header.policy.name === "person-Ann-O.-Neil" && mine.header.parent.call === step, JSON.stringify(mine.header));
    assert(mine.steps === step + 2 && steps[step].input.call.arguments.marker_id === marker, JSON.stringify(steps.at(-1)));
    assert(steps[step].input.policy.reasoning === "It is what was asked for.", JSON.stringify(steps[step].input));
    assert(steps[step + 1].outcome.error, JSON.stringify(steps[step + 1].outcome));
    assert(after.header.parent.call === step + 2 && after.end.metrics.success, JSON.stringify(after.end.metrics));
    for (const one of [name, branch]) {
      const verdict = await json(`/api/traces/${one}/replay`, { method: "POST" });
      assert(verdict.exact, `${one} does not replay: ${JSON.stringify(verdict)}`);
    }
  });
}

/** By keyboard alone, from the beginning, on a phone in the dark: a letter for the tool, its argument, Enter; the episode is a trial of the person. */
export async function drive_by_keyboard(browser) {
  const { trace, steps } = await picking();
  const there = steps.find(({ tool }) => tool === "nav_to").input.call.arguments.receptacle_name;
  const fits = async (page, what) => {
    const found = await findings(page);
    const wider = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert(!found.length && wider <= 0, `${what}: ${wider} pixels too wide; ${found.join("; ")}`);
  };
  await onPage(browser, async (page) => {
    await visit(page, `/drive/${trace}?call=0`);
    await page.getByLabel("Your name").waitFor();
    await fits(page, "before it begins");
    await page.getByLabel(/Count it as a trial/).focus();
    await page.keyboard.press("Space");
    await page.keyboard.press("Tab");
    await page.keyboard.type("bob");
    await page.keyboard.press("Enter");
    await page.getByText("What the agent sees now").waitFor();
    const name = await recorded(page);
    await page.keyboard.press("n");
    await page.keyboard.type(there);
    await page.keyboard.press("Enter");
    await page.getByText(`Arrived at ${there}.`).first().waitFor();
    await page.keyboard.press("h");
    await page.keyboard.press("Enter");
    await own(page).nth(1).waitFor();
    const marker = await page.getByRole("button", { name: /^Marker/ }).first().innerText();
    await page.keyboard.press("a");
    await page.keyboard.type(marker);
    assert((await page.getByLabel("marker_id").inputValue()) === marker, "the digit chose no marker");
    await fits(page, "while it runs");
    await page.keyboard.press("Enter");
    await own(page).nth(2).waitFor();
    await page.keyboard.press("f");
    await page.keyboard.press("Enter");
    await page.getByText("You ended the episode.").waitFor();
    await page.locator("main form").getByText("failure").waitFor();
    await fits(page, "at its end");
    // What is next has the focus.
    await page.keyboard.press("Enter");
    await until(() => parameter(page, "beside") === name, "the comparison");
    const episode = await json(`/api/traces/${name}/episode`);
    assert(episode.header.policy.name === "person-bob" && !episode.header.parent && episode.end.reason === "finished", JSON.stringify(episode.header));
  }, { dark: true, width: 390, height: 844 });
}

/** What the service refuses is said, and who leaves ends the episode. */
export async function drive_says_what_is_refused(browser) {
  const { trace, steps } = await picking();
  await onPage(browser, async (page) => {
    await visit(page, `/drive/${trace}?call=${steps.length + 5}`);
    await page.getByLabel("Your name").fill("cy");
    await page.keyboard.press("Enter");
    await page.getByRole("alert").filter({ hasText: "That did not work" }).waitFor();
  }, { expected: ["422"] });
  await onPage(browser, async (page) => {
    page.on("dialog", (dialog) => void dialog.accept());
    await visit(page, `/drive/${trace}?call=1`);
    await begin(page, "cy");
    const name = await recorded(page);
    await page.getByRole("link", { name: "Datasets" }).click();
    await page.getByRole("heading", { name: "Be the robot" }).waitFor({ state: "detached" });
    await until(async () => (await fetch(`${url}/api/traces/${name}/episode`)).ok, "the end of the trace");
    assert((await json(`/api/traces/${name}/episode`)).end.reason === "aborted", name);
    // The service ends an episode behind the page's back: its next call says so, and offers what is left.
    await visit(page, `/drive/${trace}?call=1`);
    await begin(page, "cy");
    for (const { session } of await json("/api/sessions")) {
      if (session.startsWith("openenv-")) await fetch(`${url}/api/sessions/${session}`, { method: "DELETE" });
    }
    await page.keyboard.press("w");
    await page.keyboard.press("Enter");
    await page.getByText("The service closed the episode").waitFor();
    await page.getByRole("button", { name: "Drive once more" }).click();
    await page.getByLabel("Your name").waitFor();
  }, { expected: ["404"] });
}

/** A question of the person waits for another one, who answers on Live; what is no call has no number; then the recorded calls go on. */
export async function drive_asks_and_lets_the_recorded_calls_go_on(browser) {
  const { trace, steps } = await picking();
  await onPage(browser, async (page) => {
    await visit(page, `/drive/${trace}?call=0`);
    await begin(page, "di");
    await page.keyboard.press("t");
    await page.keyboard.press("Enter");
    await own(page).first().waitFor();
    assert((await own(page).locator(".n").innerText()) === "–", "a list of tasks is a call");
    await page.keyboard.press("k");
    await page.keyboard.type("Which one?");
    await page.keyboard.press("Enter");
    await page.getByText("yours waits on Live").waitFor();
    await until(async () => (await json("/api/questions")).some(({ question }) => question === "Which one?"), "the question");
    const { session } = (await json("/api/questions")).find(({ question }) => question === "Which one?");
    await fetch(`${url}/api/sessions/${session}/answer`, {
      method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ answer: "The blue one." }),
    });
    await page.locator(".told").getByText("The blue one.").waitFor();
    assert((await own(page).last().locator(".n").innerText()) === "0", "the question is not the first call");
    await page.getByRole("button", { name: "Hand back …" }).click();
    await page.getByRole("radio", { name: "the recorded calls go on" }).check();
    await page.getByLabel("from").selectOption("2");
    await page.getByRole("button", { name: "Hand back and compare" }).click();
    await until(() => new URL(page.url()).pathname === `/episodes/${trace}`, "the comparison");
    await page.locator(".view img").nth(1).waitFor();
    const after = await json(`/api/traces/${parameter(page, "beside")}/steps?limit=1000`);
    const calls = (list) => JSON.stringify(list.map(({ input }) => input.call));
    assert(after[0].tool === "ask" && calls(after.slice(1)) === calls(steps.slice(2)), calls(after));
  });
}

/** On an episode's page, markers say what they stand for, and a click fills the call of a what-if; things on the map say their names. */
export async function markers_and_things_are_named(browser) {
  const { trace, step, marker, steps } = await picking();
  const { target } = steps.slice(0, step).findLast(({ markers }) => markers.length).markers.find(({ id }) => id === marker);
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${step - 1}&show=after`);
    const label = page.locator(`.view [data-marker="${marker}"].label`);
    await page.locator(".view img").first().hover();
    await label.hover();
    await page.locator(".view .name").getByText(`marker ${marker}: ${target.id.replace(/_at_.*/, "")}`).waitFor();
    await visit(page, `/episodes/${trace}?step=${step}&whatif=1`);
    const tool = page.getByLabel(/^\s*Call/);
    await tool.selectOption("walk_around");
    await label.click();
    assert((await tool.inputValue()) === "pick", `${await tool.inputValue()} is chosen`);
    assert((await page.getByLabel("marker_id").inputValue()) === String(marker), "the click filled nothing in");

    const thing = (id) => page.locator(`.map [data-thing="${id}"]`);
    const name = page.locator(".map .name");
    await thing(target.id).hover();
    await name.getByText(/target.*marker/).waitFor();
    await page.mouse.move(0, 0);
    await name.waitFor({ state: "detached" });
    await page.locator(".map [tabindex='0']").focus();
    const first = await name.innerText();
    await page.keyboard.press("ArrowDown");
    await until(async () => (await name.innerText()) !== first, "the next thing");
    assert((await page.locator(".map .shown").count()) === 1 && (await page.locator(".map [tabindex='0']").count()) === 1, "one thing is shown");
    assert(parameter(page, "step") === String(step), "the arrow moved the clock");
    const found = await findings(page);
    assert(!found.length, found.join("; "));
  });
}
