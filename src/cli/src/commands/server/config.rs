//! `reel server config`: the configuration of `reel serve`.

use std::path::PathBuf;

use reel_server::Config;

use crate::ExitStatus;

/// Check a configuration of `reel serve`, or print the default.
///
/// Examples:
///   reel server config default > serve.toml
///   reel server config check serve.toml
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Check a file, load its tasks, and print what it comes to
    Check {
        /// Configuration file (TOML) to check
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Print the file that changes nothing
    Default,
}

/// Checks a configuration file and prints the effective values, or prints the default.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.what {
        Command::Default => print!("{}", Config::default().to_toml()),
        Command::Check { file } => {
            let config = Config::read(file)?;
            let mut broken = 0;
            let setup = config.setup("check".to_owned(), |complaint| {
                eprintln!("reel: {complaint}");
                broken += 1;
            })?;
            print!("{}", config.to_toml());
            let scenes: Vec<&str> = setup
                .scenes
                .iter()
                .map(|scene| scene.scene_id.as_str())
                .collect();
            println!(
                "# fine: {} tasks in scene {}",
                setup.tasks.len(),
                scenes.join(", ")
            );
            return Ok(if broken > 0 {
                ExitStatus::Partial
            } else {
                ExitStatus::Success
            });
        }
    }
    Ok(ExitStatus::Success)
}
