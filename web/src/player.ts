// The player: an episode on a page, verified as it is read, with a camera that goes anywhere and another future to try; or a bundle, executed
// episode by episode, each of which can be opened.

import { Bundle } from "./bundle.ts";
import { Episode } from "./episode.ts";
import type { Camera, Opened, Point, Step, Verdict } from "./types.ts";

/** What the player needs from where it runs: a worker, and the compiled module. */
export interface Runtime {
  module: WebAssembly.Module;
  worker: () => Worker;
}

/** What a verdict proves and what not; stands beside every badge. */
const PROVEN =
  "proves that these calls, in this scene, with this seed, give every digest, image, text, reward and metric in the file. " +
  "Not proven: who wrote the calls and the words of the policy, and that no other episodes were left out.";

/** How many findings of a bundle are listed. */
const FINDINGS = 20;

/** Shows traces and bundles in an element, one after the other. */
export class Player {
  readonly #root: HTMLElement;
  readonly #runtime: Runtime;
  #shown: { close(): void } | undefined;

  constructor(root: HTMLElement, runtime: Runtime) {
    this.#root = root;
    this.#runtime = runtime;
  }

  /** Opens a trace or a bundle and verifies it; what was shown before is closed. A trace that is verified is shown after so many calls, or at its end. */
  async show(name: string, bytes: Uint8Array, at?: number): Promise<void> {
    this.#shown?.close();
    this.#shown = undefined;
    this.#root.replaceChildren(element("p", { className: "status" }, `Reading ${name} ...`));
    try {
      // An archive begins with PK.
      if (bytes[0] === 0x50 && bytes[1] === 0x4b) await this.#bundle(bytes);
      else await this.#episode(name, bytes, at);
    } catch (error) {
      this.#root.replaceChildren(badge("refused", "REFUSED"), element("p", { className: "problem" }, message(error)));
    }
  }

  async #episode(name: string, bytes: Uint8Array, at?: number, back?: () => void): Promise<void> {
    const { module, worker } = this.#runtime;
    const episode = await Episode.open(module, worker(), name, bytes);
    this.#shown = episode;
    await new EpisodeView(this.#root, episode, back).begin(at);
  }

  async #bundle(bytes: Uint8Array): Promise<void> {
    const { module, worker } = this.#runtime;
    const bundle = await Bundle.open(module, worker(), bytes);
    this.#shown = bundle;
    const view = new BundleView(this.#root, bundle, async (number) => {
      view.stop();
      const { name, bytes: trace } = await bundle.unpack(number);
      bundle.close();
      await this.#episode(name, trace, undefined, () => this.show("the bundle", bytes));
    });
    await view.begin();
  }
}

/** A bundle that is shown. */
class BundleView {
  readonly #bundle: Bundle;
  readonly #badge = badge("running", "");
  readonly #signer = element("p", { className: "about" });
  readonly #rows: HTMLElement[];
  #stopped = false;

  constructor(root: HTMLElement, bundle: Bundle, open: (episode: number) => void) {
    this.#bundle = bundle;
    const { manifest } = bundle;
    const findings = bundle.findings.slice(0, FINDINGS).map(({ episode, text }) => element("li", {}, episode === null ? text : `episode ${episode}: ${text}`));
    if (bundle.findings.length > FINDINGS) findings.push(element("li", {}, `and ${bundle.findings.length - FINDINGS} more: \`reel verify\` tells them all`));
    const { policy, profile, skills, preset } = manifest.settings;
    const percent = (share: number) => (100 * share).toFixed(1);
    const results = manifest.results.map((row) => element("tr", {}, cell(row.family), cell(`${row.played} of ${row.episodes}`), cell(`${percent(row.success_rate)} %`), cell(`${percent(row.success_low)} to ${percent(row.success_high)}`)));
    this.#rows = manifest.episodes.map((episode, number) => {
      const link = element("button", { type: "button", className: "link" }, `${episode.task} with seed ${episode.seed}`);
      link.onclick = () => open(number);
      return element("li", {}, link, element("span", { className: "outcome" }, episode.success ? "success" : "failure"), element("span", { className: "reward" }, episode.reward.toFixed(2)));
    });
    root.replaceChildren(
      element("header", {}, element("h1", {}, `${manifest.name}: ${policy.name}`), element("p", { className: "about" }, `profile ${profile}, skills ${skills}, rewards of preset ${preset}; recorded by simulator ${manifest.simulator}, reel ${manifest.build}`), this.#badge, element("ul", { className: "findings" }, ...findings), this.#signer,
        element("p", { className: "proven" }, `HOLDS ${PROVEN} The tasks are those in the bundle: \`reel verify --tasks\` compares them with a benchmark's.`)),
      element("table", {}, element("tr", {}, ...["family", "episodes", "success", "95 %"].map((name) => element("th", {}, name))), ...results),
      element("aside", {}, element("ol", { className: "calls" }, ...this.#rows)),
    );
  }

  async begin(): Promise<void> {
    const of = this.#rows.length;
    for (const [number, row] of this.#rows.entries()) {
      this.#badge.textContent = `Executing episode ${number + 1} of ${of} ...`;
      const findings = await this.#bundle.execute(number);
      if (this.#stopped) return;
      row.className = findings.length ? "error" : "equal";
      row.append(...findings.map((finding) => element("span", { className: "outcome" }, finding.text)));
    }
    const { verification, text } = await this.#bundle.conclude();
    this.#badge.className = `badge ${verification.holds ? "exact" : "refused"}`;
    this.#badge.textContent = text;
    this.#signer.textContent = verification.signer ? `signed by ${verification.signer}` : "not signed";
  }

  stop(): void {
    this.#stopped = true;
  }
}

/** An episode that is shown. */
class EpisodeView {
  readonly #episode: Episode;
  readonly #opened: Opened;
  readonly #badge = element("div", { className: "badge", role: "status" });
  readonly #canvas = element("canvas", { width: 640, height: 480, tabIndex: 0 });
  readonly #slider = element("input", { type: "range", min: "0" });
  readonly #calls = element("ol", { className: "calls" });
  readonly #cameras = element("select", {});
  readonly #where = element("output", {});
  readonly #future = element("section", { className: "future" });
  #orbit: { target: Point; distance: number; yaw: number; pitch: number } = { target: [0, 0, 0.8], distance: 3, yaw: 0.4, pitch: 1.1 };
  /** The other future: where it began and how many calls were made in it; none where the recorded one is shown. */
  #branch: { at: number; made: number } | undefined;
  /** Leads back to the bundle that the episode is of. */
  readonly #back: (() => void) | undefined;
  #drawing = false;
  #drawAgain = false;

  constructor(root: HTMLElement, episode: Episode, back?: () => void) {
    this.#episode = episode;
    this.#back = back;
    this.#opened = episode.opened;
    root.replaceChildren(this.#head(), this.#stage(), this.#side());
  }

  async begin(at = this.#opened.steps.length): Promise<void> {
    const of = this.#opened.steps.length;
    this.#verdict("running", `Verifying call 0 of ${of} ...`);
    // The end can be drawn at once when it was executed; before, the start can.
    this.go(0);
    const start = performance.now();
    try {
      const { verdict, text } = await this.#episode.verify(({ calls }) => {
        this.#verdict("running", `Verifying: ${calls} of ${of} calls are equal ...`);
        for (const item of this.#calls.children) item.classList.toggle("equal", Number((item as HTMLElement).dataset.at) <= calls);
      });
      const seconds = ((performance.now() - start) / 1000).toFixed(1);
      if (this.#slider.value === "0" && !this.#branch) this.go(Math.min(at, of));
      this.#verdict(verdict.verdict, verdict.verdict === "exact" ? `EXACT: ${text.replace(/^exact: /, "")}, executed again in ${seconds} s` : text);
    } catch (error) {
      this.#verdict("refused", message(error));
    }
  }

  /** Shows the recorded episode after so many calls. */
  go(at: number): void {
    this.#branch = undefined;
    this.#slider.value = String(at);
    const robot = this.#opened.steps[Math.max(0, at - 1)]?.robot;
    if (robot) this.#orbit.target = [robot.base[0], robot.base[1], 0.8];
    for (const item of this.#calls.children) {
      const current = Number((item as HTMLElement).dataset.at) === at;
      item.classList.toggle("current", current);
      if (current) reveal(this.#calls, item);
    }
    this.#tryHere(at);
    this.#draw();
  }

  #head(): HTMLElement {
    const { header, instruction, end, success, trace } = this.#opened;
    const result = success === null ? "not judged" : success ? "success" : "failure";
    const told = `${header.policy.name} · seed ${header.seed} · ${header.task_id} (${header.family}) in ${header.scene_id} · ${result}${end ? ` · reward ${end.metrics.total_reward.toFixed(2)} under ${header.reward_preset}` : ""}`;
    const back = element("button", { type: "button", className: "link", hidden: !this.#back }, "back to the bundle");
    back.onclick = () => this.#back?.();
    return element("header", {}, back, element("h1", {}, instruction), element("p", { className: "about" }, told), this.#badge,
      element("p", { className: "proven" }, `EXACT ${PROVEN}`),
      element("details", { className: "proven" }, element("summary", {}, "Digests and versions"), element("p", {}, `Trace ${trace}, recorded by simulator ${header.sim_version}; this page is ${this.#opened.build}. File: BLAKE3 ${this.#opened.file}.`)));
  }

  #stage(): HTMLElement {
    const names: [string, string][] = [["head", "what the agent saw"], ["top-down", "from above"], ["free", "free: drag, scroll, arrow keys"], ["follow:target", "follow the target"]];
    this.#cameras.append(...names.map(([value, label]) => element("option", { value }, label)));
    this.#cameras.ariaLabel = "Camera";
    this.#cameras.onchange = () => this.#draw();
    this.#slider.max = String(this.#opened.steps.length);
    this.#slider.ariaLabel = "Call";
    this.#slider.oninput = () => this.go(Number(this.#slider.value));
    this.#canvas.ariaLabel = "The home as the camera sees it";
    this.#canvas.onpointerdown = (event) => this.#canvas.setPointerCapture(event.pointerId);
    this.#canvas.onpointermove = (event) => event.buttons && this.#turn(-event.movementX / 150, event.movementY / 150, 1);
    this.#canvas.onwheel = (event) => {
      event.preventDefault();
      this.#turn(0, 0, Math.exp(event.deltaY / 500));
    };
    this.#canvas.onkeydown = (event) => {
      const turns: Record<string, [number, number, number]> = { ArrowLeft: [-0.15, 0, 1], ArrowRight: [0.15, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1], "+": [0, 0, 0.8], "-": [0, 0, 1.25] };
      const turn = turns[event.key];
      if (!turn) return;
      event.preventDefault();
      this.#turn(...turn);
    };
    return element("div", { className: "stage" }, this.#canvas, element("div", { className: "controls" }, this.#slider, this.#where, this.#cameras));
  }

  #side(): HTMLElement {
    const start = element("li", {}, "start");
    start.dataset.at = "0";
    start.onclick = () => this.go(0);
    this.#calls.append(start, ...this.#opened.steps.map((step) => this.#call(step)));
    return element("aside", {}, this.#calls, this.#future);
  }

  #call(step: Step): HTMLElement {
    const { call } = step.input;
    const reward = step.reward.reduce((sum, term) => sum + term.value, 0);
    const item = element("li", { className: step.outcome.error ? "error" : "" }, element("code", {}, element("span", { className: "number" }, `${step.step} `), spelled(call.name, call.arguments)),
      element("span", { className: "outcome" }, step.outcome.error ? `${step.outcome.error}: ${step.outcome.text}` : step.outcome.text));
    if (reward) item.append(element("span", { className: "reward" }, `${reward > 0 ? "+" : ""}${reward.toFixed(2)}`));
    item.dataset.at = String(step.step + 1);
    item.onclick = () => this.go(step.step + 1);
    return item;
  }

  /** The form for another call after so many calls. */
  #tryHere(at: number): void {
    const { tools, receptacles, steps } = this.#opened;
    const next = steps[at]?.input.call;
    const over = at >= steps.length && this.#opened.end !== null;
    this.#future.replaceChildren(element("h2", {}, next ? `Instead of call ${at}` : "After the last call"));
    if (over) {
      this.#future.append(element("p", {}, "The episode is over here. Go back to try another call."));
      return;
    }
    const chosen = element("select", { ariaLabel: "Tool" }, ...tools.map((tool) => element("option", { value: tool.name, title: tool.description }, tool.name)));
    const argument = element("input", { type: "text", ariaLabel: "Argument" });
    const places = element("datalist", { id: "places" }, ...receptacles.map((value) => element("option", { value })));
    const said = element("ol", { className: "said" });
    const tool = () => tools.find((tool) => tool.name === chosen.value)!;
    chosen.onchange = () => {
      const name = tool().argument;
      argument.disabled = !name;
      argument.placeholder = name ?? "no argument";
      argument.toggleAttribute("list", false);
      if (name === "receptacle_name") argument.setAttribute("list", "places");
    };
    if (next && tools.some((tool) => tool.name === next.name)) chosen.value = next.name;
    chosen.onchange(new Event("change"));
    const button = element("button", { type: "submit" }, "Make this call");
    const form = element("form", {}, chosen, argument, places, button);
    form.onsubmit = async (event) => {
      event.preventDefault();
      button.disabled = true;
      try {
        if (!this.#branch) {
          await this.#episode.branch(at);
          this.#branch = { at, made: 0 };
        }
        const name = tool().argument;
        const value = name === "marker_id" && /^\d+$/.test(argument.value.trim()) ? Number(argument.value) : argument.value;
        const call = { name: chosen.value, arguments: name ? { [name]: value } : {} };
        const { step, ended, success } = await this.#episode.act(call);
        this.#branch.made += 1;
        const reward = step.reward.reduce((sum, term) => sum + term.value, 0);
        said.append(element("li", { className: step.outcome.error ? "error" : "" }, element("code", {}, spelled(call.name, call.arguments)), ` ${step.outcome.error ? `${step.outcome.error}: ` : ""}${step.outcome.text}`,
          element("span", { className: "reward" }, ` ${reward >= 0 ? "+" : ""}${reward.toFixed(2)}`)));
        if (ended) said.after(element("p", {}, `The episode is over (${ended}): ${success === null ? "nobody knows whether it succeeded" : success ? "success" : "failure"}.`));
        button.disabled = ended !== null;
        this.#draw();
      } catch (error) {
        said.append(element("li", { className: "error" }, message(error)));
        button.disabled = false;
      }
    };
    this.#future.append(form, said);
  }

  #turn(yaw: number, pitch: number, zoom: number): void {
    if (this.#cameras.value !== "free") this.#cameras.value = "free";
    const orbit = this.#orbit;
    orbit.yaw += yaw;
    orbit.pitch = Math.min(1.5, Math.max(-0.2, orbit.pitch + pitch));
    orbit.distance = Math.min(20, Math.max(0.4, orbit.distance * zoom));
    this.#draw();
  }

  #camera(): Camera {
    const name = this.#cameras.value as Camera["name"];
    if (name !== "free") return { name };
    const { target, distance, yaw, pitch } = this.#orbit;
    const flat = distance * Math.cos(pitch);
    return { name, eye: [target[0] + flat * Math.cos(yaw), target[1] + flat * Math.sin(yaw), target[2] + distance * Math.sin(pitch)], look_at: target };
  }

  /** Draws what is chosen; while an image is on its way only the last wish is kept. */
  async #draw(): Promise<void> {
    if (this.#drawing) {
      this.#drawAgain = true;
      return;
    }
    this.#drawing = true;
    do {
      this.#drawAgain = false;
      const at = Number(this.#slider.value);
      try {
        const image = this.#branch ? await this.#episode.viewBranch(this.#camera()) : await this.#episode.view(at, this.#camera());
        this.#canvas.width = image.width;
        this.#canvas.height = image.height;
        this.#canvas.getContext("2d")!.putImageData(image, 0, 0);
        this.#where.value = this.#branch ? `another future: ${this.#branch.made} instead of call ${this.#branch.at}` : at === 0 ? "start" : `after call ${at - 1}`;
      } catch (error) {
        this.#where.value = message(error);
      }
    } while (this.#drawAgain);
    this.#drawing = false;
  }

  #verdict(kind: Verdict["verdict"] | "running", text: string): void {
    this.#badge.className = `badge ${kind}`;
    this.#badge.textContent = text;
  }
}

/** Scrolls a list to an item; the page stays where the reader has it. */
function reveal(list: Element, item: Element): void {
  const [outer, inner] = [list.getBoundingClientRect(), item.getBoundingClientRect()];
  if (inner.top < outer.top) list.scrollTop += inner.top - outer.top;
  else if (inner.bottom > outer.bottom) list.scrollTop += inner.bottom - outer.bottom;
}

function cell(text: string): HTMLElement {
  return element("td", {}, text);
}

function badge(kind: string, text: string): HTMLElement {
  return element("div", { className: `badge ${kind}`, role: "status" }, text);
}

/** `pick(marker_id=3)`, as transcripts spell calls. */
function spelled(name: string, given: unknown): string {
  const inside = given && typeof given === "object" && !Array.isArray(given) ? Object.entries(given).map(([key, value]) => `${key}=${JSON.stringify(value)}`).join(", ") : given == null ? "" : JSON.stringify(given);
  return `${name}(${inside})`;
}

function message(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

function element<K extends keyof HTMLElementTagNameMap>(tag: K, properties: Partial<HTMLElementTagNameMap[K]>, ...children: (Node | string)[]): HTMLElementTagNameMap[K] {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}
