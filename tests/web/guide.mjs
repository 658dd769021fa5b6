// The programs in docs/proof.md against the types of the package.

import { execFileSync } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { join, resolve } from "node:path";

import { assert } from "./browser.mjs";

const { WORK } = process.env;
const programs = [...readFileSync("docs/proof.md", "utf8").matchAll(/```ts\n(.*?)```/gs)];
assert(programs.length > 0, "docs/proof.md has no program any more");
const files = programs.map(([, program], number) => {
  const path = join(WORK, `program-${number}.ts`);
  // What a guide takes for granted: the bytes of a trace.
  writeFileSync(path, `${program}\ndeclare const bytes: Uint8Array;\n`);
  return path;
});
const options = { noUnusedLocals: false, types: [], paths: { "reel-replay": [resolve("web/src/index.ts")] } };
writeFileSync(join(WORK, "tsconfig.json"), JSON.stringify({ extends: resolve("web/tsconfig.json"), compilerOptions: options, include: [], files }));
execFileSync("npx", ["tsc", "--project", join(WORK, "tsconfig.json")], { cwd: "web", stdio: "inherit" });
console.log(`${files.length} program of docs/proof.md fits the types of the package`);
