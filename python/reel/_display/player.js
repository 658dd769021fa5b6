// Texts reach the page as text nodes alone.
function element(parent, name, kind, text) {
  const made = document.createElement(name);
  if (kind) made.className = kind;
  if (text) made.textContent = text;
  parent.appendChild(made);
  return made;
}
function render({ model, el }) {
  const root = element(el, "div", "reel-view player");
  const top = element(root, "div", "top");
  element(top, "h3", "", model.get("title"));
  element(root, "div", "facts", model.get("ending"));
  const stage = element(root, "div", "stage");
  const seen = element(stage, "div", "seen");
  const image = element(seen, "img");
  const note = element(seen, "span");
  const now = element(stage, "div", "now");
  const clock = element(stage, "div", "clock");
  const back = element(clock, "button", "", "\u2039");
  const range = element(clock, "input");
  const on = element(clock, "button", "", "\u203a");
  const place = element(clock, "output");
  back.setAttribute("aria-label", "one call back");
  on.setAttribute("aria-label", "one call on");
  range.type = "range";
  range.min = -1;
  range.setAttribute("aria-label", "call");
  const steps = model.get("steps");
  range.max = steps.length - 1;
  const frames = new Map();
  const asked = new Set();
  function ask(call) {
    if (call < -1 || call >= steps.length || asked.has(call)) return;
    asked.add(call);
    model.send({ frame: call });
  }
  function show() {
    const call = model.get("call");
    range.value = call;
    place.textContent = call < 0 ? "start" : `call ${call} of ${steps.length}`;
    back.disabled = call < 0;
    on.disabled = call >= steps.length - 1;
    now.replaceChildren();
    const about = element(now, "div", "about");
    if (call < 0) element(about, "div", "answer soft", "before the first call");
    else {
      const step = steps[call];
      const line = element(about, "div", "line");
      element(line, "span", "soft", `call ${call}`);
      element(line, "span", "reward " + (step.reward < 0 ? "bad" : "good"), step.reward_text);
      element(element(about, "div", "call"), "code", "", step.call);
      element(about, "div", "answer " + (step.error ? "bad" : "soft"), (step.error ? `\u2715 ${step.error}: ` : "") + step.text);
      const more = element(about, "dl", "more");
      for (const [name, value] of step.more) {
        element(more, "dt", "", name);
        element(more, "dd", "", value);
      }
    }
    const found = frames.get(call);
    if (found) {
      image.src = found.url;
      image.alt = `image at call ${call}`;
      note.hidden = found.call === call;
      note.textContent = found.call === null ? "no image" : "no new image: the latest one";
      image.style.visibility = found.url ? "visible" : "hidden";
      ask(call + 1);
    } else ask(call);
  }
  function go(call) {
    model.set("call", Math.max(-1, Math.min(steps.length - 1, call)));
    model.save_changes();
  }
  function receive(content, buffers) {
    if (!content || typeof content.frame !== "number") return;
    const url = buffers && buffers.length ? URL.createObjectURL(new Blob([buffers[0]], { type: content.type })) : "";
    frames.set(content.frame, { url, call: content.of });
    if (content.frame === model.get("call")) show();
  }
  range.addEventListener("input", () => go(Number(range.value)));
  back.addEventListener("click", () => go(model.get("call") - 1));
  on.addEventListener("click", () => go(model.get("call") + 1));
  model.on("change:call", show);
  model.on("msg:custom", receive);
  show();
  return () => {
    model.off("change:call", show);
    model.off("msg:custom", receive);
    for (const { url } of frames.values()) if (url) URL.revokeObjectURL(url);
  };
}
export default { render };
