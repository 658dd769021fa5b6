//! `reel config`: what `reel.toml` and the environment say.

use serde_json::json;

use crate::{
    ExitStatus,
    settings::{KEYS, Settings},
};

/// Show the values that stand where no flag is given, and where each comes from: the environment,
/// or the nearest `reel.toml` in the working folder or above (docs/config.md). `reel serve` has a
/// configuration of its own, see `reel server config`.
///
/// Example:
///   reel config
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Print one JSON object per key
    #[arg(long)]
    json: bool,
}

/// Prints every key with its value and origin.
pub fn run(arguments: &Arguments, settings: &Settings) -> ExitStatus {
    if !arguments.json {
        match &settings.file {
            Some(file) => println!("{}", file.display()),
            None => println!("no reel.toml in this folder or above"),
        }
    }
    for (key, _) in KEYS {
        let found = settings.get(key);
        if arguments.json {
            let (values, origin) = found.unzip();
            println!(
                "{}",
                json!({ "key": key, "values": values, "from": origin })
            );
        } else {
            let default = if key == "store" { "store" } else { "" };
            let (value, origin) = found
                .map_or((default.to_owned(), "default"), |(values, origin)| {
                    (values.join(", "), origin)
                });
            println!("{key:11} {value:40} {origin}");
        }
    }
    ExitStatus::Success
}
