/** The scene in 3D on the page of an episode, and images enlarged. */
import { inflateSync } from "node:zlib";
import { assert, findings, moment, onPage, parameter, sql, traceName, until, url, visit } from "./kit.mjs";

const canvas = (page) => page.getByRole("application");
const stepsOf = async (trace) => (await fetch(`${url}/api/traces/${encodeURIComponent(trace)}/steps?limit=1000`)).json();
/** Waits until the scene is drawn and stands still, and is that of a moment. */
async function drawn(page) {
  await canvas(page).first().waitFor();
  await until(async () => !(await page.locator("[aria-busy=true]").count()), "nothing that loads");
  let before = null;
  await until(async () => {
    await page.waitForTimeout(350);
    const now = (await canvas(page).first().screenshot()).toString("base64");
    const still = now === before;
    before = now;
    return still;
  }, "a scene that stands still");
}

/** The pixels of a PNG as Chromium writes it: 8 bits for each channel, not interlaced. */
function pixelsOf(png) {
  const [width, height, channels] = [png.readUInt32BE(16), png.readUInt32BE(20), { 2: 3, 6: 4 }[png[25]]];
  const parts = [];
  for (let at = 8; at < png.length; at += 12 + png.readUInt32BE(at)) {
    if (png.toString("latin1", at + 4, at + 8) === "IDAT") parts.push(png.subarray(at + 8, at + 8 + png.readUInt32BE(at)));
  }
  const [raw, row] = [inflateSync(Buffer.concat(parts)), width * channels];
  const out = Buffer.alloc(row * height);
  for (let y = 0; y < height; y += 1) {
    const filter = raw[y * (row + 1)];
    for (let x = 0; x < row; x += 1) {
      const left = x < channels ? 0 : out[y * row + x - channels];
      const above = y ? out[(y - 1) * row + x] : 0;
      const corner = y && x >= channels ? out[(y - 1) * row + x - channels] : 0;
      const near = [left, above, corner].map((value) => Math.abs(left + above - corner - value));
      const paeth = near[0] <= near[1] && near[0] <= near[2] ? left : near[1] <= near[2] ? above : corner;
      out[y * row + x] = raw[y * (row + 1) + 1 + x] + [0, left, above, (left + above) >> 1, paeth][filter];
    }
  }
  return { width, height, at: (x, y) => [...out.subarray(y * row + x * channels, y * row + x * channels + 3)] };
}

/** How many colours a screenshot has, to five bits a channel. */
function colours(png) {
  const { width, height, at } = pixelsOf(png);
  const seen = new Set();
  for (let y = 0; y < height; y += 2) for (let x = 0; x < width; x += 2) seen.add(at(x, y).map((value) => value >> 3).join());
  return seen.size;
}

/** Points below the labels and then over the canvas, row by row, until one has a name that is wanted. */
async function pointAt(page, wanted) {
  const { x, y, width, height } = await canvas(page).first().boundingBox();
  const points = [];
  for (const label of await page.locator(".scene .label:not(.name)").all()) {
    const box = await label.boundingBox();
    for (const below of [6, 12, 20]) points.push([box.x + box.width / 2, box.y + box.height + below]);
  }
  for (let v = 0.08; v < 0.86; v += 0.045) for (let u = 0.04; u < 0.98; u += 0.04) points.push([x + u * width, y + v * height]);
  const names = new Set();
  for (const at of points) {
    await page.mouse.move(...at);
    // A name stands there a frame later.
    await page.evaluate(() => new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go))));
    const [name] = await page.locator(".scene .name").allInnerTexts();
    if (name === undefined) continue;
    names.add(name);
    if (wanted(name)) return { name, at };
  }
  throw new Error(`nothing wanted among ${[...names].join(" | ")}`);
}

/** The scene is drawn, follows the clock and the camera, and its address restores it. */
export async function orbit_shows_the_scene(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${step}`);
    await page.getByRole("button", { name: "3D", exact: true }).click();
    await drawn(page);
    assert(parameter(page, "camera") === "3d", page.url());
    const shoulder = await canvas(page).screenshot();
    assert(colours(shoulder) > 20, `the scene has ${colours(shoulder)} colours`);
    // Another place of the robot is another image.
    const steps = await stepsOf(trace);
    const moves = steps.findIndex(({ robot }, at) => at > 0 && robot.base.join() !== steps[0].robot.base.join());
    const seen = [];
    for (const at of [0, moves + 1]) {
      await page.goto(`${url}/episodes/${trace}?camera=3d&eye=robot&step=${at}`);
      await drawn(page);
      seen.push(await canvas(page).screenshot());
    }
    const eyes = seen[1];
    assert(!eyes.equals(seen[0]), "from elsewhere the robot sees the same");
    await page.getByRole("button", { name: "Above" }).click();
    await drawn(page);
    const above = await canvas(page).screenshot();
    assert(!above.equals(eyes) && parameter(page, "eye") === "above", "from above it looks the same");
    // The clock moves the robot while the camera stands.
    await page.locator("body").press("Home");
    await until(async () => (await moment(page)).startsWith("start"), "the start");
    await drawn(page);
    assert(!(await canvas(page).screenshot()).equals(above), "the clock changes nothing");
    const { name } = await pointAt(page, (name) => /target|destination/.test(name));
    assert(name.length > 6, name);
    assert((await page.locator(".scene .label:not(.name)").allInnerTexts()).some((text) => /target|destination/.test(text)), "no label");
    const found = await findings(page);
    assert(!found.length, found.join("\n"));
  });
}

/** Things are where the record says: the target ends at its destination, and did not begin there. */
export async function orbit_moves_what_was_carried(browser) {
  const [{ trace, length }] = await sql(`SELECT trace, length FROM episodes WHERE success AND family = 'FDP' AND parent_trace IS NULL
    ORDER BY trace LIMIT 1`);
  await onPage(browser, async (page) => {
    const far = async (step) => {
      await visit(page, `/episodes/${traceName(trace)}?camera=3d&eye=above&show=after${step === null ? "" : `&step=${step}`}`);
      await drawn(page);
      const middle = async (text) => {
        const { x, y, width, height } = await page.locator(".scene .label:not(.name)", { hasText: text }).first().boundingBox();
        return [x + width / 2, y + height / 2];
      };
      const [target, destination] = [await middle("target"), await middle("destination")];
      return Math.hypot(target[0] - destination[0], target[1] - destination[1]);
    };
    const [start, end] = [await far(null), await far(length - 1)];
    assert(end < 60 && start > end + 20, `the target is ${start} pixels from its destination at the start, and ${end} at the end`);
  });
}

/** The episode plays in 3D as it does with images, and nothing is drawn while nothing changes. */
export async function orbit_plays_and_rests(browser, { trace }) {
  await onPage(browser, async (page) => {
    await page.addInitScript(() => {
      const plain = requestAnimationFrame;
      window.asked = 0;
      window.requestAnimationFrame = (draw) => ((window.asked += 1), plain(draw));
    });
    const last = (await stepsOf(trace)).length - 1;
    await visit(page, `/episodes/${trace}?camera=3d&speed=4`);
    await drawn(page);
    await page.getByRole("button", { name: "Play", exact: true }).click();
    await until(async () => (await moment(page)).startsWith(`step ${last}`), "the last step");
    await drawn(page);
    await page.waitForTimeout(500);
    const before = await page.evaluate(() => window.asked);
    await page.waitForTimeout(1500);
    const after = await page.evaluate(() => window.asked);
    assert(after === before, `${after - before} frames were drawn while nothing changed`);
  });
}

/** Drag, wheel and keys move the camera; where it stands then is in the address, and a reload brings it back. */
export async function orbit_moves_by_hand(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?camera=3d&step=${step}`);
    await drawn(page);
    const box = await canvas(page).boundingBox();
    const middle = [box.x + box.width / 2, box.y + box.height / 2];
    let eye = parameter(page, "eye");
    const moved = async (how) => {
      await until(async () => parameter(page, "eye") !== eye, `an eye in the address after ${how}`);
      eye = parameter(page, "eye");
      assert(/^-?[\d.]+,-?[\d.]+,-?[\d.]+$/.test(eye), `${how}: ${eye}`);
      await drawn(page);
    };
    await page.mouse.move(...middle);
    await page.mouse.down();
    await page.mouse.move(middle[0] + 90, middle[1] + 20, { steps: 4 });
    await page.mouse.up();
    await moved("a drag");
    await page.mouse.wheel(0, -240);
    await moved("the wheel");
    const lookAt = parameter(page, "look_at");
    await page.mouse.down({ button: "right" });
    await page.mouse.move(middle[0] + 60, middle[1], { steps: 4 });
    await page.mouse.up({ button: "right" });
    await moved("a drag with the right button");
    assert(parameter(page, "look_at") !== lookAt, "nothing else is looked at");
    await canvas(page).focus();
    for (const key of ["ArrowLeft", "ArrowUp", "+", "-", "Shift+ArrowRight"]) {
      await page.keyboard.press(key);
      await moved(key);
    }
    assert(parameter(page, "step") === String(step), `arrows on the scene changed the step: ${page.url()}`);
    await page.evaluate(() => document.activeElement.blur());
    await page.mouse.move(5, 5);
    await drawn(page);
    const before = await canvas(page).screenshot();
    await page.reload({ waitUntil: "networkidle" });
    await drawn(page);
    assert(parameter(page, "eye") === eye, page.url());
    const after = await canvas(page).screenshot();
    const [a, b] = [before, after].map(pixelsOf);
    let other = 0;
    const differs = (x, y) => a.at(x, y).some((value, k) => Math.abs(value - b.at(x, y)[k]) > 24);
    for (let y = 0; y < a.height; y += 4) for (let x = 0; x < a.width; x += 4) other += differs(x, y) ? 1 : 0;
    const share = other / ((a.width * a.height) / 16);
    assert(share < 0.002, `a reload changes ${(share * 100).toFixed(1)}% of the scene`);
  });
}

/** Two episodes side by side have one eye. */
export async function orbit_beside(browser) {
  const [{ a, b }] = await sql(`SELECT a.trace AS a, b.trace AS b FROM episodes a JOIN episodes b ON a.task_digest = b.task_digest
    WHERE a.policy = 'oracle' AND b.policy = 'planner' ORDER BY 1, 2`);
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${traceName(a)}?beside=${traceName(b)}&camera=3d&eye=above`);
    await until(async () => (await canvas(page).count()) === 2, "two scenes");
    await drawn(page);
    const other = canvas(page).nth(1);
    const before = await other.screenshot();
    await canvas(page).first().focus();
    await page.keyboard.press("ArrowDown");
    await until(async () => /,/.test(parameter(page, "eye") ?? ""), "an eye in the address");
    await drawn(page);
    assert(!(await other.screenshot()).equals(before), "the other scene stays");
  }, { width: 1024 });
}

/** While a call is edited, a click on a body that has a marker takes the marker. */
export async function orbit_fills_a_call(browser) {
  const episodes = await sql("SELECT trace FROM episodes WHERE policy = 'planner' ORDER BY 1");
  for (const trace of episodes.map(({ trace }) => traceName(trace))) {
    const steps = await stepsOf(trace);
    const at = steps.findIndex(({ markers }) => markers.length > 0) + 1;
    if (!at || at >= steps.length) continue;
    await onPage(browser, async (page) => {
      await visit(page, `/episodes/${trace}?camera=3d&eye=robot&step=${at}&whatif=1`);
      await drawn(page);
      const { name, at: [x, y] } = await pointAt(page, (name) => /marker \d+$/.test(name));
      await page.mouse.click(x, y);
      const number = /marker (\d+)$/.exec(name)[1];
      const field = page.getByLabel("marker_id");
      await until(async () => (await field.count()) && (await field.inputValue()) === number, `marker ${number} in the call`);
    });
    return;
  }
  throw new Error("no episode has markers");
}

/** The image that fills the screen is whole, and names its step, its call and whether it is from before or after. */
export async function fullscreen_names_the_step(browser, { trace, step }) {
  const steps = await stepsOf(trace);
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${step}`);
    const caption = page.locator(".view .caption");
    assert(!(await caption.isVisible()), "the caption is in the page, too");
    await page.locator("body").press("f");
    await caption.waitFor();
    const says = (wanted) => until(async () => (await caption.innerText()).replace(/\s+/g, " ").startsWith(wanted), wanted);
    await says(`Step ${step} / ${steps.length - 1} ${steps[step].input.call.name}(`);
    await caption.getByText(`What the head camera shows before step ${step}`).waitFor();
    await page.keyboard.press("b");
    await caption.getByText(`What the head camera shows after step ${step}`).waitFor();
    await page.keyboard.press("Home");
    await says("Start What the head camera shows before the first call");
    const { width, height, y } = await page.locator(".view img").boundingBox();
    assert(height <= 900 && y >= 0 && width <= 1440, `the image is ${width} x ${height} on a screen of 1440 x 900`);
    await page.keyboard.press("f");
    await caption.waitFor({ state: "hidden" });
  });
}

/** Without WebGL the page says so and leads to the free camera. */
export async function orbit_without_webgl(browser, { trace, step }) {
  await onPage(browser, async (page) => {
    await page.addInitScript(() => {
      const plain = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...given) {
        return kind.startsWith("webgl") ? null : plain.call(this, kind, ...given);
      };
    });
    await visit(page, `/episodes/${trace}?step=${step}&camera=3d`);
    await page.getByText("This browser draws no WebGL").waitFor();
    assert(!(await canvas(page).count()), "there is a canvas");
    await page.getByRole("link", { name: "the free camera" }).click();
    await page.getByAltText(/What the free camera shows/).waitFor();
    assert(parameter(page, "camera") === "free" && parameter(page, "eye"), page.url());
  });
}

/** An image is enlarged about the pointer, dragged, and shown as a whole again; its markers stay where they are. */
export async function zoom_of_an_image(browser) {
  const [{ trace: path }] = await sql("SELECT trace FROM episodes WHERE policy = 'planner' ORDER BY 1");
  const trace = traceName(path);
  const steps = await stepsOf(trace);
  const at = steps.findIndex(({ markers }) => markers.length > 0) + 1;
  await onPage(browser, async (page) => {
    await visit(page, `/episodes/${trace}?step=${at}`);
    const image = page.locator(".view img");
    await image.waitFor();
    const whole = await image.boundingBox();
    const scale = async () => (await image.boundingBox()).width / whole.width;
    const about = async (wanted) => until(async () => Math.abs((await scale()) - wanted) < 0.01, `an image ${wanted} times as large`);
    const back = page.getByRole("button", { name: "back to the whole image" });
    const spot = [whole.x + whole.width * 0.75, whole.y + whole.height * 0.25];
    await page.mouse.move(...spot);
    await page.locator(".overlay rect.label").first().waitFor({ state: "attached" });
    const label = page.locator(".overlay rect.label").first();
    const inImage = async () => {
      const [mark, all] = [await label.boundingBox(), await image.boundingBox()];
      return [(mark.x - all.x) / all.width, (mark.y - all.y) / all.height];
    };
    const markedAt = await inImage();
    await page.mouse.dblclick(...spot);
    await about(2);
    const now = await image.boundingBox();
    const under = [(spot[0] - now.x) / now.width, (spot[1] - now.y) / now.height];
    assert(Math.abs(under[0] - 0.75) < 0.01 && Math.abs(under[1] - 0.25) < 0.01, `what is under the pointer moved to ${under}`);
    await page.keyboard.press("+");
    await about(3);
    assert((await image.evaluate((node) => getComputedStyle(node).imageRendering)) === "pixelated", "pixels are smoothed");
    const marked = await inImage();
    assert(marked.every((value, k) => Math.abs(value - markedAt[k]) < 0.01), `a marker moved from ${markedAt} to ${marked}`);
    // A drag moves it.
    const left = (await image.boundingBox()).x;
    const middle = [whole.x + whole.width / 2, whole.y + whole.height / 2];
    await page.mouse.move(...middle);
    await page.mouse.down();
    await page.mouse.move(middle[0] + 50, middle[1], { steps: 3 });
    await page.mouse.up();
    await until(async () => Math.abs((await image.boundingBox()).x - left - 50) < 2, "an image that was dragged");
    // It stays enlarged at the next step, up to eight times.
    await page.keyboard.press("ArrowRight");
    await about(3);
    for (let times = 0; times < 4; times += 1) await page.keyboard.press("+");
    await about(8);
    const found = await findings(page);
    assert(!found.length, found.join("\n"));
    await page.keyboard.press("Escape");
    await about(1);
    assert(!(await back.count()), "there is something to go back from");
    // By Ctrl and the wheel; without Ctrl the wheel moves the page.
    await page.mouse.move(...middle);
    await page.keyboard.down("Control");
    await page.mouse.wheel(0, -200);
    await page.keyboard.up("Control");
    await until(async () => (await scale()) > 1.2, "an image enlarged by the wheel");
    await back.click();
    await about(1);
    await page.mouse.move(...middle);
    await page.mouse.wheel(0, 100);
    await until(() => page.evaluate(() => scrollY > 0), "a page that is scrolled");
    await about(1);
    // Two fingers spread over the image enlarge it as well.
    await page.evaluate(() => scrollTo(0, 0));
    const fingers = await page.context().newCDPSession(page);
    const touch = (type, apart) => fingers.send("Input.dispatchTouchEvent", {
      type, touchPoints: apart === null ? [] : [-1, 1].map((side, id) => ({ x: middle[0] + side * apart, y: middle[1], id })),
    });
    await touch("touchStart", 30);
    for (const apart of [40, 50, 60, 75, 90]) await touch("touchMove", apart);
    await touch("touchEnd", null);
    await about(3);
    // Another camera shows its whole image.
    await page.locator("body").press("2");
    await about(1);
  });
}
