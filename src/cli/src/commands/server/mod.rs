//! `reel server`: tokens, configuration and audit log of `reel serve`.

mod audit;
mod config;
mod token;

use crate::ExitStatus;

/// Set up `reel serve`, and look after it: tokens, configuration file, audit log.
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
    #[command(about = "Show who changed, deleted, exported, granted or revoked what")]
    Audit(audit::Arguments),
    #[cfg(feature = "analytics")]
    #[command(
        hide = true,
        about = "Answer questions in SQL for `reel serve`, in a process of their own"
    )]
    SqlProcess {
        #[command(flatten)]
        assets: crate::inputs::Assets,
    },
    #[command(about = "Check a configuration file of `reel serve`, or print the default")]
    Config(config::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        #[cfg(feature = "analytics")]
        Command::SqlProcess { assets } => {
            // What the server's own log says the details of; its standard error is ours, too.
            let _logs = reel_server::start_logs(&reel_server::Config::default());
            reel_server::answer_sql(assets.trace_files()?)?;
            Ok(ExitStatus::Success)
        }
        Command::Audit(arguments) => audit::run(arguments),
        Command::Token(arguments) => token::run(arguments),
        Command::Config(arguments) => config::run(arguments),
    }
}
