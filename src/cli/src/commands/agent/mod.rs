//! `reel agent`: agents to test with: one that makes mistakes, and a stand-in for a model.

mod faults;
#[cfg(feature = "service")]
mod mock_llm;

use crate::ExitStatus;

/// Agents to test with. `reel run` plays a policy, `reel bench` benchmarks an agent.
///
/// Examples:
///   reel agent faults run --tasks tasks --episodes 200 --out faulty
///   reel agent mock-llm traces --listen 127.0.0.1:8000
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(about = "Play tasks with injected faults, and label what went wrong")]
    Faults(faults::Arguments),
    #[command(
        name = "mock-llm",
        about = "Serve recorded decisions on the OpenAI protocol, with failures on request"
    )]
    #[cfg(feature = "service")]
    MockLlm(mock_llm::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Faults(arguments) => faults::run(arguments),
        #[cfg(feature = "service")]
        Command::MockLlm(arguments) => mock_llm::run(arguments),
    }
}
