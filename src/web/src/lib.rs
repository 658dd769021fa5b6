//! Replay in a browser tab. A [`Session`] holds one episode and answers requests: open its file,
//! verify the next call, draw it from a camera, play another future. Requests and answers are JSON
//! with bytes beside them (files, images), so that the page, a worker and Node speak to the same
//! code; `src/exports.rs` has the few functions that WebAssembly adds.

#[cfg(target_family = "wasm")]
mod exports;
mod session;

pub use session::{Request, Response, Session};
