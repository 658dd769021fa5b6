//! What replays found, for the table `verdicts`.

use anyhow::Context as _;
use reel_replay::FileVerdict;
use reel_tables::{Store, TraceVerdict};

/// Keeps the verdicts that hold as long as the files do in the table `verdicts`.
pub fn keep_verdicts(store: &Store, judged: &[FileVerdict]) -> anyhow::Result<()> {
    let lasting = judged.iter().filter(|judged| judged.is_lasting());
    let verdicts: Vec<TraceVerdict> = lasting
        .filter_map(|judged| {
            Some(TraceVerdict::new(
                judged.file?,
                judged.trace,
                reel_replay::SIM_VERSION,
                judged.verdict.name().to_owned(),
                judged.verdict.to_string(),
            ))
        })
        .collect();
    store
        .append_new_verdicts(&verdicts)
        .context("the verdicts cannot be kept in the store")
}
