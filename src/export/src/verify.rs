//! Whether the trace of an episode is what it says it is: the file is the one that was ingested,
//! and replaying it gives the same bits. Verdicts are kept in the store under the digest of the
//! file, so that nothing is replayed twice.

use std::{collections::HashMap, path::Path};

use rayon::prelude::*;
use reel_replay::{Detail, Verdict};
use reel_tables::{Store, TraceVerdict};
use reel_trace::TraceFiles;
use reel_world::Digest;

use crate::{ExportError, ExportOptions, Progress, select::Candidate};

/// Traces replayed between two commits of their verdicts.
const TRACES_PER_COMMIT: usize = 4_096;

/// How much a replay compares before an episode is exported.
#[derive(Clone, Copy)]
pub(crate) struct Comparison {
    detail: Detail,
    /// Behind a verdict that depends on it.
    suffix: &'static str,
    /// The verdict of an episode that may be exported.
    pub exact: &'static str,
}

impl Comparison {
    const ALL: Self = Self {
        detail: Detail::Full,
        suffix: "",
        exact: "exact",
    };
    /// Rows without images depend on no colour: not drawing any takes two fifths of the time.
    const WITHOUT_RGB: Self = Self {
        detail: Detail::Geometry,
        suffix: "_without_rgb",
        exact: "exact_without_rgb",
    };

    pub(crate) fn of(options: &ExportOptions) -> Self {
        if options.images {
            Self::ALL
        } else {
            Self::WITHOUT_RGB
        }
    }

    /// The verdict on a trace. Where what was compared made no difference, it is as of any replay.
    fn name(self, verdict: &Verdict) -> String {
        match verdict {
            Verdict::Exact { .. } | Verdict::Diverged { .. } => {
                format!("{}{}", verdict.name(), self.suffix)
            }
            _ => verdict.name().to_owned(),
        }
    }

    /// Whether a verdict that is known makes a replay needless. One that found colours different says
    /// nothing of the rest.
    fn is_settled_by(self, verdict: &str) -> bool {
        match verdict.strip_suffix(Self::WITHOUT_RGB.suffix) {
            Some(_) => self.detail == Detail::Geometry,
            None => self.detail == Detail::Full || verdict != "diverged",
        }
    }

    fn is_exact(self, verdict: &str) -> bool {
        verdict == Self::ALL.exact || verdict == self.exact
    }
}

/// Whether an episode may be trained on; else why not.
pub(crate) type Verified = Result<(), String>;

/// Whether each candidate may be exported. A trace without a verdict is replayed where the
/// options ask for that.
pub(crate) fn verify(
    store: &Store,
    candidates: &[Candidate],
    options: &ExportOptions,
    progress: Progress<'_>,
) -> Result<Vec<Verified>, ExportError> {
    let this = reel_replay::SIM_VERSION;
    let comparison = Comparison::of(options);
    let known = store.verdicts()?.into_iter().filter(|verdict| {
        verdict.sim_version == this && comparison.is_settled_by(&verdict.verdict)
    });
    let known: HashMap<String, TraceVerdict> = known
        .map(|verdict| (verdict.file_digest.clone(), verdict))
        .collect();
    let mut verified = Vec::with_capacity(candidates.len());
    for some in candidates.chunks(TRACES_PER_COMMIT) {
        let looked: Vec<(Verified, Option<TraceVerdict>)> = some
            .par_iter()
            .map(|candidate| {
                let looked = look(
                    store.trace_files(),
                    candidate,
                    &known,
                    comparison,
                    options.replay,
                );
                progress(1);
                looked
            })
            .collect();
        let new: Vec<TraceVerdict> = looked
            .iter()
            .filter_map(|(_, verdict)| verdict.clone())
            .collect();
        store.append_verdicts(&new)?;
        verified.extend(looked.into_iter().map(|(verified, _)| verified));
    }
    Ok(verified)
}

/// One trace, and its verdict where it is a new one.
fn look(
    files: &TraceFiles,
    candidate: &Candidate,
    known: &HashMap<String, TraceVerdict>,
    comparison: Comparison,
    replay: bool,
) -> (Verified, Option<TraceVerdict>) {
    let path = Path::new(&candidate.trace);
    let unread = |error| (Err(format!("the trace cannot be read: {error}")), None);
    let bytes = match files.bytes(path) {
        Ok(bytes) => bytes,
        Err(error) => return unread(error),
    };
    let file_digest = Digest::of(&bytes).to_string();
    let (verdict, new) = match known.get(&file_digest) {
        Some(verdict) => (verdict.clone(), None),
        None if !replay => return (Err("not verified: nothing was replayed".into()), None),
        None => {
            let (verdict, holds) = verdict(files, path, &bytes, comparison);
            (verdict.clone(), holds.then_some(verdict))
        }
    };
    let verified = match verdict.verdict.as_str() {
        exact if comparison.is_exact(exact) && verdict.trace_digest == candidate.trace_digest => {
            Ok(())
        }
        exact if comparison.is_exact(exact) => {
            Err("the file holds another recording than the tables: `reel ingest` it again".into())
        }
        _ => Err(format!("{}: {}", verdict.verdict, verdict.reason)),
    };
    (verified, new)
}

/// The verdict on the bytes of a trace, and whether it holds whatever meshes are there next time.
fn verdict(
    files: &TraceFiles,
    path: &Path,
    bytes: &[u8],
    comparison: Comparison,
) -> (TraceVerdict, bool) {
    let judged = reel_replay::verify_bytes(files, path, bytes, comparison.detail);
    let reason = match comparison.detail {
        Detail::Full => judged.verdict.to_string(),
        Detail::Geometry => format!("{} (colours were not compared)", judged.verdict),
    };
    let verdict = TraceVerdict::new(
        Digest::of(bytes),
        judged.trace,
        reel_replay::SIM_VERSION,
        comparison.name(&judged.verdict),
        reason,
    );
    (verdict, judged.is_lasting())
}
