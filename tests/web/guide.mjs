// The programs in docs/proof.md against the types of the package; one for Node is executed.

import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, symlinkSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";

import { assert } from "./browser.mjs";

const { TRACES, WORK } = process.env;
const programs = [...readFileSync("docs/proof.md", "utf8").matchAll(/```ts\n(.*?)```/gs)];
assert(programs.length > 0, "docs/proof.md has no program any more");
const files = programs.map(([, program], number) => {
  const path = join(WORK, `program-${number}.ts`);
  // What a guide takes for granted: the bytes of a trace.
  writeFileSync(path, `${program}\ndeclare const bytes: Uint8Array;\n`);
  return path;
});
const options = { noUnusedLocals: false, types: ["node"], typeRoots: [resolve("web/node_modules/@types")], paths: { "reel-replay": [resolve("web/src/index.ts")] } };
writeFileSync(join(WORK, "tsconfig.json"), JSON.stringify({ extends: resolve("web/tsconfig.json"), compilerOptions: options, include: [], files }));
execFileSync("npx", ["tsc", "--project", join(WORK, "tsconfig.json")], { cwd: "web", stdio: "inherit" });

// One for Node is executed, beside the package and a trace.
mkdirSync(join(WORK, "node_modules"), { recursive: true });
symlinkSync(resolve("web"), join(WORK, "node_modules/reel-replay"));
copyFileSync(join(TRACES, readdirSync(TRACES).find((name) => name.endsWith(".mcap"))), join(WORK, "a.mcap"));
const forNode = programs.map(([, program]) => program).filter((program) => program.includes('"node:fs"'));
assert(forNode.length > 0, "docs/proof.md has no program for Node any more");
for (const program of forNode) {
  writeFileSync(join(WORK, "program.mjs"), program);
  const told = execFileSync("node", ["program.mjs"], { cwd: WORK, encoding: "utf8" });
  assert(told.includes("verdict: 'exact'"), `the program for Node prints ${told}`);
}
console.log(`${files.length} programs of docs/proof.md fit the types of the package, ${forNode.length} for Node finds a trace exact`);
