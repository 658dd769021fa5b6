// Runs a wasm32-wasip1 program under Node: node --no-warnings wasi.mjs PROGRAM.wasm [ARGUMENT...]
// It gets standard input, output and error, and neither files nor environment.
import { readFile } from "node:fs/promises";
import { argv, exit } from "node:process";
import { WASI } from "node:wasi";

const program = argv[2];
const wasi = new WASI({ version: "preview1", args: argv.slice(2), env: {}, returnOnExit: true });
// Called through functions of JavaScript: V8's fast path into Node's WASI crashes (nodejs/node issue 53087).
const system = Object.fromEntries(
  Object.entries(wasi.wasiImport).map(([name, call]) => [name, (...values) => call(...values)]),
);
const module = await WebAssembly.compile(await readFile(program));
exit(wasi.start(await WebAssembly.instantiate(module, { wasi_snapshot_preview1: system })));
