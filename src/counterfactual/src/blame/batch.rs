//! Many episodes at a time, on several threads; results come in the order of the paths.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use reel_replay::{Verdict, check_meshes};
use reel_trace::{Trace, TraceFiles};
use serde::{Deserialize, Serialize};

use crate::blame::{Alternative, Blame, CompetentAgent, alternative, blame_against};

/// A trace with what its measurement found.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct MeasuredTrace {
    /// Path of the trace that was measured.
    pub trace: PathBuf,
    /// The competent agent that it was measured against.
    #[serde(default)]
    pub competent_agent: CompetentAgent,
    /// What the measurement found; its fields stand beside `trace` in JSON.
    #[serde(flatten)]
    pub blame: Blame,
    /// What would have been better at the decisive step, where it was asked for.
    pub alternative: Option<Alternative>,
    /// Why there is none, where it was asked for.
    pub no_alternative: Option<String>,
}

/// How traces are measured.
#[derive(Clone, Debug, Default)]
pub struct BlameOptions {
    /// The competent agent that episodes are measured against, and that takes over.
    pub competent_agent: CompetentAgent,
    /// Whether what would have been better is played.
    pub alternatives: bool,
    /// The folder for those branches, verified; none: they are played and thrown away.
    pub branches: Option<PathBuf>,
}

/// Measures traces. A trace that cannot be read is an error in words, and keeps
/// the others from nothing.
pub fn blame_all(
    files: &TraceFiles,
    paths: &[PathBuf],
    workers: usize,
    options: &BlameOptions,
    on_done: impl Fn() + Sync,
) -> Vec<Result<MeasuredTrace, String>> {
    let measure = |path: &PathBuf| {
        let measured = files
            .read(path)
            .map_err(|error| error.to_string())
            .and_then(|trace| measure(&trace, options).map_err(|refused| refused.to_string()));
        on_done();
        measured
    };
    match rayon::ThreadPoolBuilder::new()
        .num_threads(workers.max(1))
        .build()
    {
        Ok(pool) => pool.install(|| paths.par_iter().with_max_len(1).map(measure).collect()),
        Err(_) => paths.iter().map(measure).collect(),
    }
}

/// Measures a trace that was read.
///
/// # Errors
/// Refuses a trace whose meshes are not there: its costs would be those of other objects.
pub fn measure(trace: &Trace, options: &BlameOptions) -> Result<MeasuredTrace, Verdict> {
    check_meshes(&trace.header, &trace.meshes)?;
    let blame = blame_against(trace, options.competent_agent);
    let (mut found, mut reason) = (None, None);
    if let Some(decisive) = blame.decisive.as_ref().filter(|_| options.alternatives) {
        let path = options
            .branches
            .as_ref()
            .map(|folder| folder.join(branch_name(&trace.path, decisive.step)));
        match alternative(trace, decisive, path.as_deref(), options.competent_agent) {
            Ok(Ok(alternative)) => found = Some(alternative),
            Ok(Err(why)) => reason = Some(why),
            Err(error) => reason = Some(error.to_string()),
        }
    }
    Ok(MeasuredTrace {
        trace: trace.path.clone(),
        competent_agent: options.competent_agent,
        blame,
        alternative: found,
        no_alternative: reason,
    })
}

fn branch_name(trace: &Path, step: u32) -> String {
    let stem = reel_trace::trace_stem(trace);
    format!("{stem}--better-at-{step}.mcap")
}
