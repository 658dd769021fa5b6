//! `reel server`: the tokens and the configuration of `reel serve`.

mod config;
mod token;

use crate::ExitStatus;

/// Set up `reel serve`: its tokens and its configuration file.
///
/// Examples:
///   reel server token create trainer --role act
///   reel server config default > serve.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(about = "Create, list and revoke the tokens of clients")]
    Token(token::Arguments),
    #[command(about = "Check a configuration file of `reel serve`, or print the default")]
    Config(config::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Token(arguments) => token::run(arguments),
        Command::Config(arguments) => config::run(arguments),
    }
}
