//! `reel key`: keys that sign bundles.

use std::{
    fs::{self, OpenOptions},
    io::Write as _,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use reel_bundle::Key;
use reel_world::is_invisible;

use crate::ExitStatus;

/// Make a key that signs bundles, or show one. A key is an Ed25519 key as OpenSSH writes it;
/// `ssh-keygen` makes and reads such keys too.
///
/// Examples:
///   reel key new lab --comment "our lab"      # `reel bundle --key lab` signs; lab.pub is for others
///   reel key show lab
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Make a key: FILE holds the private half and is for nobody else, FILE.pub the public one
    New {
        /// Where to write it
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Whose it is, for people
        #[arg(long, value_name = "TEXT", default_value = "")]
        comment: String,
    },
    /// Print the public half of a key and its fingerprint, which `reel verify` tells
    Show {
        /// The private half of a key
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// Makes or shows a key.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::New { file, comment } => {
            if comment.contains(is_invisible) {
                bail!("--comment has characters that cannot be seen; it is one line of text");
            }
            let mut seed = [0; 32];
            getrandom::fill(&mut seed).map_err(|error| {
                anyhow::anyhow!("this machine gives no random numbers: {error}")
            })?;
            let key = Key::of_seed(&seed, comment);
            let public = file.with_added_extension("pub");
            for path in [file, &public] {
                if path.symlink_metadata().is_ok() {
                    bail!(
                        "{} is there already; a key is not written over",
                        path.display()
                    );
                }
            }
            write_new(file, &key.to_openssh(), 0o600)?;
            let written = write_new(&public, &(key.signer().to_openssh() + "\n"), 0o644);
            written.inspect_err(|_| {
                // Half a key is of use to nobody.
                let _ = fs::remove_file(file);
            })?;
            println!(
                "{}: keep it to yourself\n{}: give it to those who verify\n{}",
                file.display(),
                public.display(),
                key.signer()
            );
        }
        Command::Show { file } => {
            let text = fs::read_to_string(file)
                .with_context(|| format!("cannot read the key {}", file.display()))?;
            let signer = Key::from_openssh(&text)
                .with_context(|| file.display().to_string())?
                .signer();
            println!("{}\n{signer}", signer.to_openssh());
        }
    }
    Ok(ExitStatus::Success)
}

/// Writes a file that was not there, for those whom `mode` lets read it.
fn write_new(path: &Path, text: &str, mode: u32) -> anyhow::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, mode);
    #[cfg(not(unix))]
    let _ = mode;
    options
        .open(path)
        .and_then(|mut file| file.write_all(text.as_bytes()))
        .with_context(|| format!("cannot write {}", path.display()))
}
