//! `reel completions` and `reel man`: files for the shell, from the command line's own parser.

use std::{fs, io, path::PathBuf};

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;

use crate::ExitStatus;

/// Print completions for a shell.
///
/// Examples:
///   reel completions bash > ~/.local/share/bash-completion/completions/reel
///   reel completions zsh > ~/.zfunc/_reel        # where ~/.zfunc is in $fpath
///   reel completions fish > ~/.config/fish/completions/reel.fish
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Completions {
    /// The shell to complete in
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Write a man page for every command: reel.1, reel-run.1, reel-trace-recover.1 and so on.
///
/// Example:
///   reel man --out ~/.local/share/man/man1
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Man {
    /// Folder for the pages; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints the completions of a shell.
pub fn completions(arguments: &Completions, mut command: Command) -> ExitStatus {
    clap_complete::generate(arguments.shell, &mut command, "reel", &mut io::stdout());
    ExitStatus::Success
}

/// Writes the man pages.
pub fn man(arguments: &Man, command: Command) -> anyhow::Result<ExitStatus> {
    let out = &arguments.out;
    fs::create_dir_all(out)
        .and_then(|()| clap_mangen::generate_to(command, out))
        .with_context(|| format!("cannot write man pages to {}", out.display()))?;
    Ok(ExitStatus::Success)
}
