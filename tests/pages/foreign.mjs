/** Agents of other worlds: a coding agent's trajectory and a log of Inspect. No goal, no home, no images; pages say what there is. */
import { assert, findings, foreignUrl, onPage, until } from "./kit.mjs";

const PAGES = [
  "/", "/episodes", "/failures", "/failures?tab=confusions", "/failures?tab=attribution", "/compare?a=coder&b=some%2Fmodel", "/panels?page=behaviour", "/claims", "/datasets",
  "/sql?q=SELECT+task_id%2C+success%2C+class+FROM+episodes+LEFT+JOIN+classes+USING+(episode_id)",
];
const episodes = async () => {
  const answer = await fetch(`${foreignUrl}/api/sql`, {
    method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify({ sql: "SELECT task_id, trace, instruction, success FROM episodes ORDER BY task_id" }),
  });
  return answer.json();
};

/** What somebody reads who has no idea of fields: no value that is none. */
async function is_told(page, address) {
  await page.goto(foreignUrl + address, { waitUntil: "networkidle" });
  await until(async () => (await page.locator("main").innerText()).trim().split("\n").length > 1, `something on ${address}`);
  const text = await page.locator("main").innerText();
  const odd = text.match(/.*\b(NaN|undefined|Infinity|\[object Object\])\b.*/);
  assert(!odd, `${address}: ${odd?.[0]}`);
  const found = await findings(page);
  assert(!found.length, `${address}: ${found.join("; ")}`);
  return text;
}

export async function foreign_episodes_are_told(browser) {
  const all = await episodes();
  assert(all.length === 5, `${all.length} episodes`);
  for (const address of PAGES) await onPage(browser, (page) => is_told(page, address));
  await onPage(browser, async (page) => assert((await is_told(page, "/")).includes("1 episode is not counted"), "the coder's episode is left out in silence"));
  for (const { task_id, trace, instruction } of all) {
    const address = `/episodes/${trace.replace(/^.*\//, "").replace(/\.mcap$/, "")}`;
    await onPage(browser, async (page) => {
      const text = await is_told(page, address);
      assert(text.includes(instruction) && text.includes("read_file"), `${task_id}: its instruction and calls are not on ${address}`);
      // Nothing is measured, drawn or executed that there is not.
      for (const wrong of ["The target is", "decisive step", "Decisive step", "Cost to go", "Reward", "No image", "Holds nothing", "Changes of the world"]) {
        assert(!text.includes(wrong), `${task_id}: "${wrong}" on ${address}`);
      }
      for (const name of ["What if …", "Be the robot", "Replay now"]) assert(!(await page.getByRole("button", { name }).count()), `${task_id}: "${name}" on ${address}`);
      await page.keyboard.press("End");
      await until(async () => (await page.locator("output").first().innerText()).startsWith("step "), "the last step");
      await page.keyboard.press("Space");
      await until(async () => (await page.locator("output").first().innerText()).startsWith("start"), "it plays from the start");
    // The image of the start is asked for before anybody knows that there is none.
    }, { expected: ["422"] });
  }
}
