//! `reel train`: what a trainer did, from its log and the traces of its rollouts.

mod changes;
mod log;

use reel_query::{Format, QuerySession, format};

use crate::ExitStatus;

/// Look into a training: which rollouts made an update, and what it changed. Reel trains nothing
/// itself; a trainer writes the log (docs/loop.md#the-log-of-a-training).
///
/// Examples:
///   reel train log loop-data/gspo                # a line a step, held against the traces
///   reel train log loop-data/gspo --step 41      # which episodes made its gradient, by which reward terms
///   reel train changes before.store after.store  # what it changed: flips by task, calls, failures, attribution
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(about = "The steps of a training, or the episodes of one step and what they weighed")]
    Log(log::Arguments),
    #[command(about = "What a training changed: the same tasks played before and after it")]
    Changes(changes::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Log(arguments) => log::run(arguments),
        Command::Changes(arguments) => changes::run(arguments),
    }
}

/// The rows of a query.
fn ask<Row: serde::de::DeserializeOwned>(
    session: &QuerySession,
    sql: &str,
) -> anyhow::Result<Vec<Row>> {
    let text = format(&session.run(sql)?, Format::Json)?;
    Ok(serde_json::from_str(&text)?)
}
