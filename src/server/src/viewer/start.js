// Opens the episode that the address names, at the step that it names.
"use strict";

const asked = new URLSearchParams(location.search);
const trace = asked.get("trace");
const step = Number(asked.get("step") ?? NaN);
const said = document.getElementById("said");
const say = (text) => {
  said.textContent = text;
  said.hidden = !text;
};

/** The recording; with the token that the pages of this service keep, where it demands one. */
async function recording() {
  const token = localStorage.getItem("reel-token");
  const headers = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(`/api/traces/${encodeURIComponent(trace)}/rrd`, { headers });
  if (!answer.ok) {
    const { error } = await answer.json().catch(() => ({}));
    throw new Error(error?.message ?? `the service answers ${answer.status}`);
  }
  return new Uint8Array(await answer.arrayBuffer());
}

/**
 * Sets the clock as soon as the viewer knows the recording, however long that takes, and again until it has stayed there for two
 * seconds: a new recording is followed to its end first. After ten seconds the clock is the reader's in any case.
 */
function go(handle, tries = 0, stayed = 0) {
  const id = handle.get_active_recording_id();
  if (id !== undefined && handle.get_timeline_time_range(id, "step")) {
    if (!Number.isFinite(step)) return;
    tries += 1;
    stayed = handle.get_time_for_timeline(id, "step") === step ? stayed + 1 : 0;
    handle.set_playing(id, false);
    handle.set_active_timeline(id, "step");
    handle.set_time_for_timeline(id, "step", step);
    document.documentElement.dataset.step = handle.get_time_for_timeline(id, "step");
  }
  if (stayed < 40 && tries < 200) setTimeout(() => go(handle, tries, stayed), 50);
}

/** The page of the episode at the same step, where this service has pages. */
async function wayBack() {
  const episode = document.getElementById("episode");
  const address = `/episodes/${encodeURIComponent(trace)}`;
  const page = await fetch(address, { method: "HEAD", headers: { accept: "text/html" } }).catch(() => null);
  if (!page?.ok) return;
  episode.href = Number.isFinite(step) ? `${address}?step=${step}` : address;
  episode.hidden = false;
}

async function main() {
  if (!trace) throw new Error("the address names no trace: /rerun/?trace=NAME");
  document.title = `${trace} in Rerun`;
  void wayBack();
  const [data] = await Promise.all([recording(), wasm_bindgen({ module_or_path: "re_viewer_bg.wasm" })]);
  const handle = new wasm_bindgen.WebHandle({
    url: [], hide_welcome_screen: true, enable_history: false, notebook: false, persist: false,
    render_backend: asked.get("renderer") ?? undefined,
  });
  await handle.start(document.getElementById("viewer"));
  say("");
  handle.open_channel("reel", trace);
  handle.send_rrd_to_channel("reel", data);
  handle.close_channel("reel");
  go(handle);
}

main().catch((error) => say(`This episode cannot be shown in Rerun: ${error.message ?? error}`));
