// Builds the package (dist/index.js, worker.js, types, modules) and the page that needs nothing else (dist/player.html).
//   node build.mjs FOLDER/NAME...    modules are FOLDER/NAME.wasm: `reel-simd`, which the page holds, and `reel` for browsers without vectors

import { execFileSync } from "node:child_process";
import { basename } from "node:path";
import { copyFileSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const modules = process.argv.slice(2);
const common = { bundle: true, minify: true, target: "es2022", legalComments: "none" };
const text = async (entry, more = {}) => (await build({ ...common, ...more, entryPoints: [entry], format: "iife", write: false })).outputFiles[0].text;

rmSync("dist", { recursive: true, force: true });
mkdirSync("dist");
const worker = await text("src/worker.ts");
writeFileSync("dist/worker.js", worker);
await build({ ...common, entryPoints: ["src/index.ts", "src/player.ts"], format: "esm", outdir: "dist", minify: false });
execFileSync("npx", ["tsc", "--noEmit", "false", "--emitDeclarationOnly", "--declaration", "--allowImportingTsExtensions", "--rootDir", "src", "--outDir", "dist", "--project", "tsconfig.build.json"], { stdio: "inherit" });
for (const module of modules) copyFileSync(`${module}.wasm`, `dist/${basename(module)}.wasm`);

const script = await text("src/page.ts", { define: { WORKER: JSON.stringify(worker) } });
const embedded = (module) => `<script type="application/octet-stream" id="${basename(module)}">${gzipSync(readFileSync(`${module}.wasm`), { level: 9 }).toString("base64")}</script>`;
const parts = { STYLE: readFileSync("src/page.css", "utf8").trim(), SCRIPT: script.trim().replaceAll("</script", "<\\/script"), MODULES: embedded(modules[0]) };
const page = readFileSync("src/page.html", "utf8").replaceAll(/@(STYLE|SCRIPT|MODULES)@/g, (_, part) => parts[part]);
writeFileSync("dist/player.html", page);
const size = (path) => `${path} ${(readFileSync(path).length / 1e6).toFixed(2)} MB`;
console.log([...modules.map((module) => size(`dist/${basename(module)}.wasm`)), size("dist/player.html")].join(", "));
