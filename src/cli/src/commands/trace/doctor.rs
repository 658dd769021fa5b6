//! `reel trace doctor`: says what is wrong with traces, where, and what to do.

use std::path::PathBuf;

use reel_trace::{DoctorReport, TraceError, examine};

use crate::{ExitStatus, inputs, progress};

/// Check traces: magic bytes, structure, every checksum, index against content, schemas against
/// those of this version, order, hash chain, attachments and images against their digests. Names
/// every fault, its place and what to do. Unfinished recordings (.mcap.part) are not healthy.
///
/// Examples:
///   reel trace doctor traces-out
///   reel trace doctor traces-out/FDP_home_0001--oracle--0.mcap --json
///
/// Exit code 0: all healthy; 1: something is wrong; 2: a file could not be read at all.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// Examines every recording and prints what is wrong with it.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let paths = inputs::recordings(&arguments.paths)?;
    let bar = progress::bar(paths.len(), "doctor");
    let results: Vec<Result<DoctorReport, TraceError>> = paths
        .iter()
        .map(|path| {
            let result = examine(path);
            bar.inc(1);
            result
        })
        .collect();
    bar.finish_and_clear();
    let (mut failed, mut ill) = (0, 0);
    for result in results {
        let examination = match result {
            Ok(examination) => examination,
            Err(error) => {
                failed += 1;
                eprintln!("reel: {error}");
                continue;
            }
        };
        ill += usize::from(!examination.findings.is_empty());
        if arguments.json {
            println!("{}", serde_json::to_string(&examination)?);
        } else {
            print!("{}", text(&examination));
        }
    }
    if !arguments.json && paths.len() > 1 {
        println!("{} of {} healthy", paths.len() - ill - failed, paths.len());
    }
    Ok(if failed > 0 {
        ExitStatus::BadInput
    } else if ill > 0 {
        ExitStatus::CheckFailed
    } else {
        ExitStatus::Success
    })
}

fn text(examination: &DoctorReport) -> String {
    let DoctorReport {
        path,
        bytes,
        steps,
        images,
        findings,
        notes,
        ..
    } = examination;
    let notes: String = notes.iter().map(|note| format!("; {note}")).collect();
    if findings.is_empty() {
        return format!(
            "{}: healthy, {steps} steps, {images} images, {bytes} bytes{notes}\n",
            path.display()
        );
    }
    let mut text = format!(
        "{}: not healthy, {steps} steps are readable{notes}\n",
        path.display()
    );
    for finding in findings {
        text.push_str(&format!("  {finding}\n"));
    }
    text
}
