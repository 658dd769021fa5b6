// An instance of the module: requests go in as JSON with bytes behind it, answers come out likewise.

import type { Responded, Request } from "./types.ts";

/** What the module exports (src/web/src/exports.rs). */
interface Exports {
  memory: WebAssembly.Memory;
  reel_input(length: number): number;
  reel_request(jsonLength: number): void;
  reel_json(): number;
  reel_json_length(): number;
  reel_bytes(): number;
  reel_bytes_length(): number;
  reel_panic(): number;
  reel_panic_length(): number;
}

/** One session: it holds one episode, and is dropped with it. */
export class Instance {
  readonly #exports: Exports;

  constructor(module: WebAssembly.Module) {
    this.#exports = new WebAssembly.Instance(module, {}).exports as unknown as Exports;
  }

  /** Bytes of memory that the instance has. */
  get memory(): number {
    return this.#exports.memory.buffer.byteLength;
  }

  request(request: Request, bytes: Uint8Array = new Uint8Array()): Responded {
    const { reel_input, reel_request, reel_json, reel_json_length, reel_bytes, reel_bytes_length } = this.#exports;
    const json = new TextEncoder().encode(JSON.stringify(request));
    const start = reel_input(json.length + bytes.length);
    const place = new Uint8Array(this.#exports.memory.buffer, start, json.length + bytes.length);
    place.set(json);
    place.set(bytes, json.length);
    try {
      reel_request(json.length);
    } catch (error) {
      return { response: { response: "failed", reason: `the module stopped: ${this.#panic() || error}` }, bytes: new Uint8Array() };
    }
    const response = JSON.parse(this.#text(reel_json(), reel_json_length()));
    return { response, bytes: this.#copy(reel_bytes(), reel_bytes_length()) };
  }

  #panic(): string {
    return this.#text(this.#exports.reel_panic(), this.#exports.reel_panic_length());
  }

  #text(start: number, length: number): string {
    return new TextDecoder().decode(this.#copy(start, length));
  }

  #copy(start: number, length: number): Uint8Array {
    return new Uint8Array(this.#exports.memory.buffer, start, length).slice();
  }
}
