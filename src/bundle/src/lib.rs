//! Results that carry their proof. A bundle is one file with the tasks and scenes of a benchmark run, its episodes as packed inputs (the
//! words of the models among them), the results that are claimed of them, an in-toto statement over all of it, and a signature. Whoever has it
//! executes the episodes again and says whether the claim holds: [`verify`].
//!
//! The file has exactly one form: it is written again from what was read, and every byte has to be the same.

mod archive;
mod error;
mod findings;
mod make;
mod manifest;
mod sample;
mod signature;
mod statement;
mod verify;

pub use archive::Bundle;
pub use error::BundleError;
pub use findings::{Finding, FindingKind};
pub use make::{BundleInputs, make};
pub use manifest::{Cell, ClaimedEpisode, Grid, Manifest, ResultRow, Settings, TaskEntry, results};
pub use sample::{Sample, miss_probability};
pub use signature::{Key, Signer};
pub use verify::{Benchmark, CheckedBundle, Verification, episode_fingerprints, verify};
