//! Large language models behind OpenAI-compatible endpoints. [`client`] asks, retries, caches
//! and logs; [`agent`] has the policies and the simulated user that ask models, and a mock model
//! for tests and demos.

pub mod agent;
pub mod client;
