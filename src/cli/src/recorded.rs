//! How the recorded episodes of one run went.

use std::path::Path;

use anyhow::bail;
use reel_agents::EpisodeReport;
use reel_world::record::EndReason;

use crate::inputs;

/// The episodes below a path that were played to an end, one for each task and seed, ordered by family, task and seed.
///
/// # Errors
/// Fails where a trace cannot be read, or two are of one task and seed.
pub fn recorded(path: &Path) -> anyhow::Result<Vec<EpisodeReport>> {
    let mut reports = Vec::new();
    let files = inputs::trace_files();
    for path in inputs::traces(&files, &[path.to_owned()])? {
        let trace = files.read(&path)?;
        reports.extend(
            EpisodeReport::of_trace(&trace, &path)
                .filter(|report| report.end_reason != EndReason::Aborted),
        );
    }
    reports.sort_by(|a, b| (a.family, &a.task_id, a.seed).cmp(&(b.family, &b.task_id, b.seed)));
    if let Some([one, _]) = reports
        .array_windows()
        .find(|[one, next]| (&one.task_id, one.seed) == (&next.task_id, next.seed))
    {
        bail!(
            "{} has several episodes of task {} at seed {}; give a folder of one agent",
            path.display(),
            one.task_id,
            one.seed
        );
    }
    Ok(reports)
}
