//! `reel server token`: who may use `reel serve`.

use std::{collections::BTreeSet, path::PathBuf};

use anyhow::Context as _;
use reel_server::{AuditEntry, AuditLog, Config, Role, Tokens};
use serde_json::json;

use crate::ExitStatus;

/// Make, list and revoke the tokens that clients of `reel serve` show. The file holds hashes only:
/// a token is printed once.
///
/// Roles: act (play: policies and trainers), read (episodes, tables, SQL, analysis), admin
/// (all of it, and uploads, jobs, labels). A policy gets act alone, so that it cannot read
/// what it is graded by.
///
/// Examples:
///   reel server token create trainer --role act
///   reel server token create dashboard --role read --role act
///   reel server token revoke trainer
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// File of tokens [default: tokens.toml in the data folder]
    #[arg(long, value_name = "FILE", env = "REEL_TOKENS", global = true)]
    tokens: Option<PathBuf>,
    /// The server's data folder [default: reel-data]
    #[arg(long, value_name = "DIR", env = "REEL_DATA", global = true)]
    data: Option<PathBuf>,
    /// Print each token's name and roles as a line of JSON
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Make a token, and print it this once
    Create {
        /// Name of the new token; no other token may have it
        #[arg(value_name = "NAME")]
        name: String,
        /// What it allows; may be given several times
        #[arg(long = "role", value_name = "ROLE", required = true, value_parser = role)]
        roles: Vec<Role>,
    },
    /// List the tokens by name
    List,
    /// Take a token back; a running server notices within a second
    Revoke {
        /// Name of the token to revoke
        #[arg(value_name = "NAME")]
        name: String,
    },
}

fn role(text: &str) -> Result<Role, String> {
    Role::parse(text).ok_or_else(|| "there are read, act and admin".to_owned())
}

/// Creates, lists or revokes the tokens that clients of `reel serve` show.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let defaults = Config::default();
    let data = arguments.data.clone().unwrap_or(defaults.data.clone());
    let config = Config {
        data,
        tokens: arguments.tokens.clone(),
        ..defaults
    };
    let path = config.tokens();
    let audit = |action: String| {
        let kept = AuditLog::at(config.audit()).append(&AuditEntry::of_command(action));
        kept.with_context(|| format!("done, but not on {}", config.audit().display()))
    };
    let tokens = Tokens::open(&path)?;
    match &arguments.what {
        Command::Create { name, roles } => {
            let token = tokens.create(name, roles.iter().copied().collect::<BTreeSet<_>>())?;
            let names: Vec<_> = roles.iter().map(|role| role.name()).collect();
            audit(format!("token create {name} ({})", names.join(", ")))?;
            if arguments.json {
                println!(
                    "{}",
                    json!({ "name": name, "roles": roles, "token": token })
                );
            } else {
                eprintln!(
                    "the token of {name}; it is shown only now. Its hash is in {}",
                    path.display()
                );
                println!("{token}");
            }
        }
        Command::List => {
            for entry in tokens.entries().iter() {
                let roles = json!(entry.roles);
                if arguments.json {
                    println!("{}", json!({ "name": entry.name, "roles": roles }));
                } else {
                    let roles: Vec<&str> = roles
                        .as_array()
                        .into_iter()
                        .flatten()
                        .filter_map(|role| role.as_str())
                        .collect();
                    println!("{:24} {}", entry.name, roles.join(", "));
                }
            }
        }
        Command::Revoke { name } => {
            tokens.revoke(name)?;
            audit(format!("token revoke {name}"))?;
        }
    }
    Ok(ExitStatus::Success)
}
