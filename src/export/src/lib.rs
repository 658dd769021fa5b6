//! Training sets from traces: one prompt-response pair a decision, as Hugging Face Parquet (SPEC sections 8 and 11).
//!
//! Only what a policy could see reaches a prompt, and a row that names an instance is refused. Never runs physics: whether
//! a trace is verified is the caller's answer, and nothing that is not verified is exported.

mod dataset;
mod prompt;

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use reel_trace::{Trace, TraceError, encode_png};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde::Serialize;

pub use prompt::{SYSTEM_PROMPT, prompt_digest};

/// Traces held in memory at a time.
const TRACES_PER_BATCH: usize = 32;

/// Says whether a trace re-executes to the same digests; the reason where it does not.
pub type Verify<'a> = &'a (dyn Fn(&Path) -> Result<(), String> + Sync);
/// Called with (traces done, traces in all) from several threads.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// Which episodes become rows.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct SftOptions {
    /// Failed and broken-off episodes too.
    pub all: bool,
}

/// What an export did.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct SftReport {
    /// Episodes exported.
    pub episodes: usize,
    /// Rows: decisions with their prompts.
    pub rows: usize,
    /// Failed or broken-off episodes left out.
    pub unsuccessful: usize,
    /// Decisions of exported episodes left out, because their call failed: nothing to imitate.
    pub failed_calls: usize,
    /// Traces refused: unreadable, not verified, or naming what a policy must not know.
    pub refused: Vec<(PathBuf, String)>,
    /// Size of the file.
    pub bytes: u64,
}

/// Why nothing was exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A file cannot be written.
    #[error("cannot write the dataset: {source}: {path}", path = path.display())]
    Io {
        /// The system's reason.
        source: io::Error,
        /// Which file.
        path: PathBuf,
    },
    /// The columns cannot be built.
    #[error("columns of the dataset: {0}")]
    Columns(#[from] polars_core::error::PolarsError),
}

/// One row: one decision.
pub(crate) struct Row {
    pub episode_id: String,
    pub task_id: String,
    pub step: u32,
    pub trace_uri: String,
    pub trace_digest: String,
    pub preset: String,
    /// (role, content)
    pub messages: Vec<(&'static str, String)>,
    /// (name, PNG)
    pub images: Vec<(String, Vec<u8>)>,
}

/// Exports traces as one Parquet file, in the order given; the file appears only when it is whole.
///
/// # Errors
/// When the file cannot be written. A trace that cannot be used is refused in the report, and the rest goes on.
pub fn sft(
    traces: &[PathBuf],
    out: &Path,
    options: SftOptions,
    verify: Verify<'_>,
    progress: Progress<'_>,
) -> Result<SftReport, ExportError> {
    let io_error = |source| ExportError::Io { source, path: out.to_path_buf() };
    let unfinished = out.with_added_extension("part");
    let mut report = SftReport::default();
    let mut file = dataset::Writer::create(&unfinished)?;
    let done = std::sync::atomic::AtomicUsize::new(0);
    for paths in traces.chunks(TRACES_PER_BATCH) {
        let read = |path: &PathBuf| {
            let rows = rows(path, options, verify);
            progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, traces.len());
            rows
        };
        let results: Vec<_> = paths.par_iter().map(read).collect();
        let mut batch = Vec::new();
        for (path, result) in paths.iter().zip(results) {
            match result {
                Ok(Some((rows, failed_calls))) => {
                    report.episodes += 1;
                    report.failed_calls += failed_calls;
                    batch.extend(rows);
                }
                Ok(None) => report.unsuccessful += 1,
                Err(reason) => report.refused.push((path.clone(), reason)),
            }
        }
        report.rows += batch.len();
        file.write(&batch)?;
    }
    file.finish()?;
    fs::rename(&unfinished, out).map_err(io_error)?;
    report.bytes = fs::metadata(out).map_err(io_error)?.len();
    Ok(report)
}

/// The rows of one trace and how many calls were left out; none where the episode failed.
fn rows(path: &Path, options: SftOptions, verify: Verify<'_>) -> Result<Option<(Vec<Row>, usize)>, String> {
    let trace = Trace::read(path).map_err(|error| error.to_string())?;
    if !options.all && !trace.end.as_ref().is_some_and(|end| end.metrics.success) {
        return Ok(None);
    }
    verify(path).map_err(|reason| format!("not verified: {reason}"))?;
    let mut rows = Vec::new();
    for (index, record) in trace.steps.iter().enumerate().filter(|(_, record)| record.outcome.is_ok()) {
        let messages = prompt::messages(&trace, index);
        if let Some(secret) = prompt::secret(&trace, &messages) {
            return Err(format!("step {}: the text names {secret}, which a policy must not know", record.step));
        }
        rows.push(Row {
            episode_id: trace.header.episode_id.clone(),
            task_id: trace.header.task_id.clone(),
            step: record.step,
            trace_uri: path.display().to_string(),
            trace_digest: trace.chain().to_string(),
            preset: trace.header.reward_preset.clone(),
            messages,
            images: latest_image(&trace, index).map_err(|error| error.to_string())?.into_iter().collect(),
        });
    }
    let failed_calls = trace.steps.len() - rows.len();
    Ok(Some((rows, failed_calls)))
}

/// The picture that the policy saw last before a decision.
fn latest_image(trace: &Trace, index: usize) -> Result<Option<(String, Vec<u8>)>, TraceError> {
    let earlier = trace.steps[..index].iter().rev().map(|record| Some(record.step));
    for step in earlier.chain([None]) {
        if let Some(rgb) = trace.frame_rgb(step)? {
            let moment = step.map_or("start".to_owned(), |step| format!("step-{step:03}"));
            return Ok(Some((
                format!("{}-{moment}.png", trace.header.episode_id),
                encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32),
            )));
        }
    }
    Ok(None)
}
