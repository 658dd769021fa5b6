// The module under Node beside the native build: the same verdicts, also in words, on sound traces and on changed ones.

import { spawnSync } from "node:child_process";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { basename, join } from "node:path";
import { Instance } from "../../web/dist/index.js";

const { REEL, TRACES, WORK, FORM } = process.env;
const short = FORM === "--short";
const module = new WebAssembly.Module(readFileSync("web/dist/reel-simd.wasm"));

/** The verdict of the module on the bytes of a trace. */
function inModule(path) {
  const instance = new Instance(module);
  let { response } = instance.request({ request: "open", name: path }, readFileSync(path));
  while (response.response === "opened" || (response.response === "verified" && !response.verdict)) ({ response } = instance.request({ request: "verify" }));
  return { verdict: response.verdict ?? { verdict: "refused", reason: response.reason }, memory: instance.memory };
}

/** The verdicts of the native build, in the order of the paths. */
function native(paths) {
  const ran = spawnSync(REEL, ["replay", "--json", "--jobs", "1", ...paths], { encoding: "utf8", maxBuffer: 1 << 28 });
  const verdicts = ran.stdout.trim().split("\n").map((line) => JSON.parse(line));
  const of = new Map(verdicts.map(({ trace, ...verdict }) => [trace, verdict]));
  return paths.map((path) => of.get(path));
}

function compare(paths) {
  const expected = native(paths);
  let memory = 0;
  paths.forEach((path, index) => {
    const found = inModule(path);
    memory = Math.max(memory, found.memory);
    const [ours, theirs] = [JSON.stringify(found.verdict), JSON.stringify(expected[index])];
    if (ours !== theirs) throw new Error(`${path}: the module says ${ours}, the native build ${theirs}`);
  });
  return { verdicts: expected, memory };
}

let golden = readdirSync(TRACES).filter((name) => name.endsWith(".mcap")).sort().map((name) => join(TRACES, name));
if (short) golden = golden.filter((_, index) => index % 6 === 0);
const start = performance.now();
const { verdicts, memory } = compare(golden);
const exact = verdicts.filter((verdict) => verdict.verdict === "exact").length;
if (exact !== golden.length) throw new Error(`${exact} of ${golden.length} are exact`);
console.log(`${golden.length} traces: verdicts of the native build, all exact; at most ${(memory / 1e6).toFixed(0)} MB, ${((performance.now() - start) / 1000).toFixed(0)} s`);

// Bytes changed by a generator with a seed: equal from run to run.
let state = 7;
const random = (below) => ((state = (Math.imul(state, 1664525) + 1013904223) >>> 0) / 2 ** 32) * below | 0;
const changed = [];
for (let number = 0; number < (short ? 40 : 500); number += 1) {
  const path = golden[random(golden.length)];
  const bytes = readFileSync(path);
  bytes[random(bytes.length)] ^= 1 << random(8);
  changed.push(join(WORK, `${number}-${basename(path)}`));
  writeFileSync(changed[number], bytes);
}
const kinds = {};
for (const { verdict } of compare(changed).verdicts) kinds[verdict] = (kinds[verdict] ?? 0) + 1;
console.log(`${changed.length} changed bytes, named as natively: ${JSON.stringify(kinds)}`);
