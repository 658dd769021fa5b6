//! `reel dev`: what people who change Reel need.

mod eval_insight;
pub mod gate;
mod mint;
mod perf;

use crate::ExitStatus;

/// Work on Reel itself: compare builds, write golden traces anew, measure.
///
/// Examples:
///   reel dev gate --corpus traces/golden
///   reel dev perf
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(
        name = "eval-insight",
        about = "Measure taxonomy and blame on perturbed competent play"
    )]
    EvalInsight(eval_insight::Arguments),
    #[command(about = "Replay a corpus with this build and another, and list changed outcomes")]
    Gate(gate::Arguments),
    #[command(about = "Write golden traces anew, for a reason")]
    Mint(mint::Arguments),
    #[command(about = "Measure this build: physics, rendering, episodes, replay, trace bytes")]
    Perf(perf::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::EvalInsight(arguments) => eval_insight::run(arguments),
        Command::Gate(arguments) => gate::run(arguments),
        Command::Mint(arguments) => mint::run(arguments),
        Command::Perf(arguments) => perf::run(arguments),
    }
}
