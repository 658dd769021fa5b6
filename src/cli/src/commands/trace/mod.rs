//! `reel trace`: check, restore, repack, copy and draw trace files.

#[cfg(feature = "analytics")]
mod copy;
mod doctor;
mod frames;
mod logprobs;
mod recover;
mod repack;
mod video;

use crate::ExitStatus;

/// Check, restore, repack, copy and draw traces. `reel show` prints one, `reel replay` executes it.
///
/// Examples:
///   reel trace doctor traces
///   reel trace recover traces --out recovered
///   reel trace compact traces --out lean
///   reel trace video traces/FDP_home_0001--oracle--0.mcap
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    #[command(about = "Check traces: checksums, index, schemas, order, hash chain, frames")]
    Doctor(doctor::Arguments),
    #[command(about = "Restore what unfinished, truncated or damaged recordings hold")]
    Recover(recover::Arguments),
    #[command(about = "Drop the frames of traces; their digests stay")]
    Compact(repack::Compact),
    #[command(about = "Render the frames of compacted traces again")]
    Expand(repack::Expand),
    #[command(about = "Copy traces to buckets, and back")]
    #[cfg(feature = "analytics")]
    Copy(copy::Arguments),
    #[command(about = "Write the frames of a trace as PNG files, and a contact sheet")]
    Frames(frames::Arguments),
    #[command(about = "Write an episode as GIF or MP4, with the calls as captions")]
    Video(video::Arguments),
    #[command(
        about = "List the log-probabilities of recorded tokens, and add those of other policies"
    )]
    Logprobs(logprobs::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    match &arguments.command {
        Command::Doctor(arguments) => doctor::run(arguments),
        Command::Recover(arguments) => recover::run(arguments),
        Command::Compact(arguments) => repack::compact(arguments),
        Command::Expand(arguments) => repack::expand(arguments),
        #[cfg(feature = "analytics")]
        Command::Copy(arguments) => copy::run(arguments),
        Command::Frames(arguments) => frames::run(arguments),
        Command::Video(arguments) => video::run(arguments),
        Command::Logprobs(arguments) => logprobs::run(arguments),
    }
}
