//! Full traces to lean ones and back: pixels are dropped where replay can bring them back, and
//! drawn again from the inputs. Digests stay, so that a lean trace says what its images were.

use std::{collections::BTreeMap, path::Path};

use reel_trace::{Images, Trace, TraceError, TraceSummary};

use crate::{Verdict, player::config, replay_with, verify_trace};

/// Why a trace is left as it is.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum RepackError {
    /// Its images could not be brought back, or not these.
    #[error("its images cannot be rendered again: {verdict}")]
    NotExact { verdict: Box<Verdict> },
    /// It cannot be written.
    #[error(transparent)]
    Trace(#[from] TraceError),
}

/// Writes a trace without its images; with `verify` only after a replay that brought back
/// every one of them.
///
/// # Errors
/// When the replay is not exact, the trace is not of our simulator, or the file cannot be written.
pub fn compact(trace: &Trace, to: &Path, verify: bool) -> Result<TraceSummary, RepackError> {
    let refused = if verify {
        Some(verify_trace(trace)).filter(|verdict| !verdict.is_exact())
    } else {
        config(trace).err()
    };
    match refused {
        Some(verdict) => Err(RepackError::NotExact {
            verdict: Box::new(verdict),
        }),
        None => Ok(trace.rewrite(to, Images::None, |_| None)?),
    }
}

/// Writes a trace with its images, drawn again: the bytes of the trace as it
/// was recorded with them.
///
/// # Errors
/// When the replay is not exact or the file cannot be written.
pub fn expand(trace: &Trace, to: &Path) -> Result<TraceSummary, RepackError> {
    let mut images: BTreeMap<Option<u32>, Vec<u8>> = BTreeMap::new();
    let replayed = replay_with(trace, |step, frame| {
        drop(images.insert(step, frame.rgb.clone()))
    });
    replayed.map_err(|verdict| RepackError::NotExact {
        verdict: Box::new(verdict),
    })?;
    Ok(trace.rewrite(to, Images::Full, |step| images.remove(&step))?)
}
