//! The hash chain of a trace: each link covers the link before it and the records of its moment, so
//! that nothing can be changed, left out or put elsewhere without being seen. What a clock, a
//! robot or a viewer says is not covered: an episode is not a function of it.

use reel_world::Digest;

use crate::schema::{self, Channel};

/// The channels whose messages are covered. `schemas/reel/v1/chain.proto` lists them for readers.
const COVERED: [Channel; 9] = [
    schema::EPISODE,
    schema::TOOL_CALL,
    schema::POLICY_OUTPUT,
    schema::USER_DIALOGUE,
    schema::TOOL_RESULT,
    schema::WORLD_DIFF,
    schema::WORLD_GRAPH,
    schema::REWARD,
    schema::SIM_DIGEST,
];

/// What the links of a trace cover.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Covered {
    /// The bytes of messages: a link after the start, each step, and the end.
    #[default]
    Messages,
    /// The canonical JSON of records ([`records`]), as in traces of before there was a channel for links: a
    /// link after the start and each step.
    Records,
}

/// The link that is being made of messages.
pub(crate) struct MessageChain(blake3::Hasher);

impl MessageChain {
    /// Before the first message of a trace.
    pub(crate) fn new() -> Self {
        Self::behind(Digest::default())
    }

    fn behind(link: Digest) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&link.0);
        Self(hasher)
    }

    /// Takes a message as it stands in the file.
    pub(crate) fn cover(&mut self, channel: Channel, data: &[u8]) {
        if COVERED.contains(&channel) {
            self.0
                .update(channel.topic.as_bytes())
                .update(&[0])
                .update(&(data.len() as u64).to_le_bytes())
                .update(data);
        }
    }

    /// The link over everything since the link before.
    pub(crate) fn link(&mut self) -> Digest {
        let link = Digest(*self.0.finalize().as_bytes());
        *self = Self::behind(link);
        link
    }
}

/// Links as traces have them that were recorded before links covered the bytes of the file: over canonical JSON.
pub(crate) mod records {
    use reel_world::{
        Digest, canonical_json,
        record::{EpisodeHeader, StartRecord, StepRecord},
    };
    use serde::Serialize;
    use serde_json::Value;

    /// The link of the start: over the header and the start record.
    pub(crate) fn start_link(header: &EpisodeHeader, start: &StartRecord) -> Digest {
        let mut header = header.clone();
        header.build.clear();
        link(&header, start)
    }

    /// The link of a step: over the link before it and the step's record.
    pub(crate) fn step_link(before: &Digest, step: &StepRecord) -> Digest {
        let mut step = step.clone();
        if let Some(policy) = &mut step.input.policy {
            policy.latency_ns = None;
            policy.logprobs = None;
        }
        link(before, &step)
    }

    /// Over two values. The digests of a record had a link, which was zero here.
    fn link(before: &impl Serialize, record: &impl Serialize) -> Digest {
        let mut record = serde_json::to_value(record).expect("a record is always JSON");
        record["digests"]["chain"] = Value::String(Digest::default().to_string());
        Digest::of(canonical_json(&(before, record)).as_bytes())
    }
}
