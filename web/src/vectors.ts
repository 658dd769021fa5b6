// Which of the two modules a browser runs.

/** Whether WebAssembly has vector instructions here: all browsers since 2023 have them. */
export function hasVectors(): boolean {
  // A function that makes a vector of 16 bytes.
  return WebAssembly.validate(new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11]));
}

/** The module of this package to fetch: the one without vectors gives the same bits in twice the time. */
export function moduleName(): "reel-simd.wasm" | "reel.wasm" {
  return hasVectors() ? "reel-simd.wasm" : "reel.wasm";
}
