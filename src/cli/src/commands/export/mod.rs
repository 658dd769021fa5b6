//! `reel export`: training sets and recordings for other tools.

use std::path::PathBuf;

use serde_json::json;

use crate::Answer;
#[cfg(feature = "analytics")]
use crate::{inputs, progress};

/// Write training sets and recordings for other tools.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// One prompt-response pair a step as Hugging Face Parquet, from successful episodes that replay exactly
    #[cfg(feature = "analytics")]
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel export sft traces-out --out sft.parquet
    ///   python -c "import datasets; print(datasets.load_dataset('parquet', data_files='sft.parquet'))"
    Sft {
        /// Trace files, or folders of them
        #[arg(required = true, value_name = "PATH")]
        paths: Vec<PathBuf>,
        /// The Parquet file
        #[arg(long, value_name = "FILE", default_value = "sft.parquet")]
        out: PathBuf,
        /// Failed episodes too
        #[arg(long)]
        all: bool,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// One episode as a Rerun recording: pictures, transforms, boxes, transcript, rewards
    #[cfg(feature = "rerun")]
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel export rrd traces-out/FDP_home_0001--oracle--0.mcap --out episode.rrd
    Rrd {
        /// The trace
        #[arg(value_name = "TRACE")]
        trace: PathBuf,
        /// The recording
        #[arg(long, value_name = "FILE", default_value = "episode.rrd")]
        out: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// A contact sheet PNG of one episode
    #[command(verbatim_doc_comment)]
    ///
    /// Example:
    ///   reel export sheet traces-out/FDP_home_0001--oracle--0.mcap --out sheet.png
    Sheet {
        /// The trace
        #[arg(value_name = "TRACE")]
        trace: PathBuf,
        /// The picture
        #[arg(long, value_name = "FILE", default_value = "contact_sheet.png")]
        out: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    match &arguments.command {
        #[cfg(feature = "analytics")]
        Command::Sft { paths, out, all, json } => {
            let paths = inputs::traces(paths)?;
            let bar = progress::bar(paths.len(), "export");
            let verify = |path: &std::path::Path| {
                let verdict = reel_replay::verify(path);
                if verdict.is_exact() { Ok(()) } else { Err(verdict.to_string()) }
            };
            let options = reel_export::SftOptions { all: *all };
            let report = reel_export::sft(&paths, out, options, &verify, &|_, _| bar.inc(1))?;
            bar.finish_and_clear();
            for (path, reason) in &report.refused {
                eprintln!("reel: {} is not exported: {reason}", path.display());
            }
            if *json {
                println!(
                    "{}",
                    json!({ "episodes": report.episodes, "rows": report.rows, "unsuccessful": report.unsuccessful,
                            "failed_calls": report.failed_calls, "refused": report.refused, "bytes": report.bytes, "out": out })
                );
            } else {
                println!("{} rows of {} episodes in {} ({} bytes)", report.rows, report.episodes, out.display(), report.bytes);
                println!(
                    "  left out: {} failed episodes, {} failed calls, {} refused traces",
                    report.unsuccessful,
                    report.failed_calls,
                    report.refused.len()
                );
            }
            Ok(if report.refused.is_empty() { Answer::Yes } else { Answer::Loss })
        }
        #[cfg(feature = "rerun")]
        Command::Rrd { trace, out, json } => {
            reel_view::rrd(&reel_trace::Trace::read(trace)?, out)?;
            if *json {
                println!("{}", json!({ "out": out }));
            } else {
                println!("{}: open it with `rerun {0}`", out.display());
            }
            Ok(Answer::Yes)
        }
        Command::Sheet { trace, out, json } => {
            std::fs::write(out, reel_view::contact_sheet(&reel_trace::Trace::read(trace)?)?)?;
            if *json {
                println!("{}", json!({ "out": out }));
            } else {
                println!("{}", out.display());
            }
            Ok(Answer::Yes)
        }
    }
}
