// One worker for one episode: its memory ends with it, and the page stays free.

import { Instance } from "./instance.ts";
import type { Request } from "./types.ts";

/** What the page posts: the compiled module first, then requests. */
export type ToWorker = { module: WebAssembly.Module } | { id: number; request: Request; bytes?: Uint8Array };

let instance: Instance | undefined;

self.onmessage = ({ data }: MessageEvent<ToWorker>) => {
  if ("module" in data) {
    instance = new Instance(data.module);
    return;
  }
  const { response, bytes } = instance!.request(data.request, data.bytes);
  self.postMessage({ id: data.id, response, bytes }, { transfer: [bytes.buffer] });
};
