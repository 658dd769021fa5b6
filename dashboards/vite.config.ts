import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig, type Plugin } from "vite";

// `npm run dev` shows the pages of a `reel serve` that runs beside it.
const server = process.env.REEL_URL ?? "http://127.0.0.1:8801";
// The service takes calls of its own pages only, and these pages are served from another port.
const proxied = { target: server, changeOrigin: true, headers: { origin: server } };

/** Compresses once, here, what the server would have to compress for every client. */
function zipped(): Plugin {
  return {
    name: "zipped",
    apply: "build",
    writeBundle({ dir }) {
      for (const entry of readdirSync(dir!, { recursive: true, withFileTypes: true })) {
        if (!entry.isFile() || !/\.(js|css|svg|html)$/.test(entry.name)) continue;
        const path = join(entry.parentPath, entry.name);
        writeFileSync(`${path}.gz`, gzipSync(readFileSync(path), { level: 9 }));
      }
    },
  };
}

export default defineConfig({
  plugins: [svelte(), zipped()],
  build: {
    target: "es2023", assetsInlineLimit: 0, chunkSizeWarningLimit: 1200,
    // What several pages share is one file: a browser asks for six at a time, and each costs it some milliseconds.
    rolldownOptions: {
      output: { codeSplitting: { includeDependenciesRecursively: false, groups: [{ name: "shared", test: /\/src\/(lib|components|pages)\//, minShareCount: 2 }] } },
    },
  },
  server: {
    proxy: Object.fromEntries(["/api", "/healthz", "/metrics", "/reset", "/step", "/state"].map((path) => [path, proxied])),
  },
});
