//! The hash chain of an episode: each link covers the link before it, the step's inputs and its
//! outputs, so that nothing can be changed, left out or put elsewhere without being seen.
//! Wall-clock values, log-probabilities and the version of Reel are not covered: they do not belong
//! to what an episode is a function of.

use crate::{
    Digest, canonical_json,
    record::{EpisodeHeader, StartRecord, StepRecord},
};

/// The link of the start: over the header and the start record.
pub fn start_link(header: &EpisodeHeader, start: &StartRecord) -> Digest {
    let mut header = header.clone();
    header.build.clear();
    let mut start = start.clone();
    start.digests.chain = Digest::default();
    Digest::of(canonical_json(&(&header, &start)).as_bytes())
}

/// The link of a step: over the link before it and the step's record.
pub fn step_link(before: &Digest, step: &StepRecord) -> Digest {
    let mut step = step.clone();
    step.digests.chain = Digest::default();
    if let Some(policy) = &mut step.input.policy {
        policy.latency_ns = None;
        policy.logprobs = None;
    }
    Digest::of(canonical_json(&(before, &step)).as_bytes())
}

/// Links records anew, as an episode under this header would have linked them; gives the last link.
pub fn relink(header: &EpisodeHeader, start: &mut StartRecord, steps: &mut [StepRecord]) -> Digest {
    start.digests.chain = start_link(header, start);
    let mut link = start.digests.chain;
    for step in steps {
        step.digests.chain = step_link(&link, step);
        link = step.digests.chain;
    }
    link
}
