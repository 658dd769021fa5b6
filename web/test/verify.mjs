// Verifies traces with the module under Node, and says of each what `reel replay` should say too.
//   node test/verify.mjs MODULE.wasm TRACE... > verdicts.jsonl
// Fails if one is not exact.

import { readFileSync } from "node:fs";
import { basename } from "node:path";
import { Instance } from "../dist/index.js";

const [path, ...traces] = process.argv.slice(2);
const module = new WebAssembly.Module(readFileSync(path));
let wrong = 0;
for (const trace of traces) {
  const start = performance.now();
  const instance = new Instance(module);
  let { answer } = instance.request({ request: "open", name: basename(trace) }, readFileSync(trace));
  while (answer.answer === "opened" || (answer.answer === "verified" && !answer.verdict)) ({ answer } = instance.request({ request: "verify" }));
  const verdict = answer.verdict ?? { verdict: "refused", reason: answer.reason };
  wrong += verdict.verdict !== "exact";
  console.log(JSON.stringify({ path: trace, ...verdict, ms: Math.round(performance.now() - start), memory_mb: Math.round(instance.memory / 1e6) }));
}
process.exitCode = wrong ? 1 : 0;
