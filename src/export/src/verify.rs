//! Whether the trace of an episode is what it says it is: the file is the one that was ingested,
//! and replaying it gives the same bits. Verdicts are kept in the store under the digest of the
//! file, so that nothing is replayed twice.

use std::{collections::HashMap, path::Path};

use rayon::prelude::*;
use reel_replay::Verdict;
use reel_tables::{Store, TraceVerdict};
use reel_trace::{Limits, Trace, TraceFiles};
use reel_world::Digest;

use crate::{ExportError, Progress, select::Candidate};

/// Traces replayed between two commits of their verdicts.
const TRACES_PER_COMMIT: usize = 4_096;

/// Whether an episode may be trained on; else why not.
pub(crate) type Verified = Result<(), String>;

/// What is known of each candidate's trace; those that nothing is known of are replayed
/// where `replay` says so.
pub(crate) fn verify(
    store: &Store,
    candidates: &[Candidate],
    replay: bool,
    progress: Progress<'_>,
) -> Result<Vec<Verified>, ExportError> {
    let this = reel_replay::SIM_VERSION;
    let known = store
        .verdicts()?
        .into_iter()
        .filter(|verdict| verdict.sim_version == this);
    let known: HashMap<String, TraceVerdict> = known
        .map(|verdict| (verdict.file_digest.clone(), verdict))
        .collect();
    let mut verified = Vec::with_capacity(candidates.len());
    for some in candidates.chunks(TRACES_PER_COMMIT) {
        let looked: Vec<(Verified, Option<TraceVerdict>)> = some
            .par_iter()
            .map(|candidate| {
                let looked = look(store.trace_files(), candidate, &known, replay);
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
            let (verdict, holds) = verdict(files, path, &bytes);
            (verdict.clone(), holds.then_some(verdict))
        }
    };
    let verified = match verdict.verdict.as_str() {
        "exact" if verdict.trace_digest == candidate.trace_digest => Ok(()),
        "exact" => {
            Err("the file holds another recording than the tables: `reel ingest` it again".into())
        }
        _ => Err(format!("{}: {}", verdict.verdict, verdict.reason)),
    };
    (verified, new)
}

/// The verdict on the bytes of a trace, and whether it holds whatever meshes are there next time.
fn verdict(files: &TraceFiles, path: &Path, bytes: &[u8]) -> (TraceVerdict, bool) {
    let mut holds = true;
    let (trace_digest, verdict) = match Trace::from_bytes(path, bytes, &Limits::default()) {
        Ok(trace) => {
            let trace = files.with_meshes(trace);
            let verdict = reel_replay::verify_catching_panics(&trace);
            let refused = matches!(verdict, Verdict::Refused { .. });
            holds = !refused || trace.header.meshes.is_empty();
            (trace.chain().to_string(), verdict)
        }
        Err(error) => (
            String::new(),
            Verdict::Refused {
                reason: error.to_string(),
            },
        ),
    };
    let verdict = TraceVerdict {
        file_digest: Digest::of(bytes).to_string(),
        trace_digest,
        sim_version: reel_replay::SIM_VERSION,
        build: env!("CARGO_PKG_VERSION").into(),
        verdict: verdict.name().into(),
        reason: verdict.to_string(),
    };
    (verdict, holds)
}
