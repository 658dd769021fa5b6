//! `reel server audit`: who changed what.

use std::path::PathBuf;

use anyhow::Context as _;
use reel_server::{AuditLog, Config};

use crate::ExitStatus;

/// Show who changed, deleted, exported, granted or revoked what, oldest first: uploads, deletions,
/// branches, jobs (exports among them), labels, definitions, sessions that were ended, answers to
/// questions, tokens. Reading and playing are not in it.
///
/// Examples:
///   reel server audit
///   reel server audit --json | jq 'select(.token == "trainer")'
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The server's data folder [default: reel-data]
    #[arg(long, value_name = "DIR", env = "REEL_DATA")]
    data: Option<PathBuf>,
    /// Print each change as a line of JSON
    #[arg(long)]
    json: bool,
}

/// Prints the audit log of a data folder.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let defaults = Config::default();
    let config = Config {
        data: arguments.data.clone().unwrap_or(defaults.data),
        ..Config::default()
    };
    let log = AuditLog::at(config.audit());
    let entries = log
        .entries()
        .with_context(|| format!("cannot read {}", log.path().display()))?;
    for entry in &entries {
        if arguments.json {
            println!("{}", serde_json::to_string(entry)?);
            continue;
        }
        let who = match (&entry.token, &entry.client) {
            (Some(token), _) => token.clone(),
            (None, Some(client)) => client.clone(),
            (None, None) => "command line".to_owned(),
        };
        let status = entry
            .status
            .map_or_else(String::new, |status| format!("  {status}"));
        println!("{}  {who:<16}  {}{status}", entry.at, entry.action);
    }
    if entries.is_empty() && !arguments.json {
        println!("{} has no changes", log.path().display());
    }
    Ok(ExitStatus::Success)
}
