//! A shard: many episodes in one MCAP file, each as its inputs and the digests of the trace that
//! they give. Who executes them has the traces again, byte for byte; this crate cannot.
//!
//! Three channels in chunks of their own: `/packed/scene` and `/packed/task` (canonical JSON, each
//! once) and `/packed/episode` ([`reel.v1.PackedEpisode`](../../../schemas/reel/v1/packed.proto)). A log time
//! is the number of a message on its channel, plus a base that tells channels apart: the chunk index, which
//! every MCAP reader has, leads from a number to its chunk. The attachment `episodes.index` leads from an
//! episode's id to its number.

mod bounds;
mod read;
mod write;

use std::{collections::BTreeMap, sync::Arc};

use prost::Message as _;
use reel_world::{
    Digest, Scene, Task,
    record::{Backend, EpisodeHeader, StepInput},
};

use crate::{
    FrameLayers, Images, Timing, Trace,
    chain::Covered,
    codec,
    schema::{Channel, reel},
};

pub(crate) use read::begins_as_shard;
pub use read::{Shard, member, name_of_member, trace_stem};
pub use write::{ShardSummary, ShardWriter};

/// Named in the header record of the file.
const PROFILE: &str = "reel.shard";
/// Name of the attachment that leads from ids to numbers.
const INDEX: &str = "episodes.index";
/// Stands for the id of the episode in the name of its trace.
const ID: &str = "\u{1}";
/// Stands for the id of the task in the name of its trace.
const TASK_ID: &str = "\u{2}";

const EPISODES: Channel = Channel {
    id: 1,
    topic: "/packed/episode",
    message: "reel.v1.PackedEpisode",
};

/// What messages of a shard are, with the first log time of each kind.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    Episode,
    Task,
    Scene,
}

impl Kind {
    const ALL: [Kind; 3] = [Kind::Episode, Kind::Task, Kind::Scene];

    fn topic(self) -> &'static str {
        match self {
            Kind::Episode => EPISODES.topic,
            Kind::Task => "/packed/task",
            Kind::Scene => "/packed/scene",
        }
    }

    fn log_time(self, number: u32) -> u64 {
        ((self as u64) << 40) + u64::from(number)
    }
}

/// An episode as a shard holds it.
#[derive(Clone, Debug)]
pub struct PackedEpisode {
    /// File of its trace, relative to the folder that was packed.
    pub name: String,
    /// The inputs known before the first call.
    pub header: EpisodeHeader,
    /// The task of the episode.
    pub task: Arc<Task>,
    /// The scene of the episode.
    pub scene: Arc<Scene>,
    /// The inputs of each step.
    pub inputs: Vec<StepInput>,
    /// By step, the clock of episodes that were recorded while they were played elsewhere.
    pub timings: BTreeMap<u32, Timing>,
    /// Whether its trace holds images.
    pub images: Images,
    /// What else its trace holds of a frame.
    pub layers: FrameLayers,
    /// The last link of its hash chain.
    pub chain: Digest,
    /// BLAKE3 digest of the whole file that was packed.
    pub digest: Digest,
    /// Size of the file that was packed, in bytes.
    pub bytes: u64,
    pub(crate) covered: Covered,
}

impl PackedEpisode {
    /// The inputs of a trace that was read from these bytes.
    ///
    /// # Errors
    /// What the trace holds that its inputs do not give.
    pub fn of(trace: &Trace, bytes: &[u8], name: &str) -> Result<Self, String> {
        let header = &trace.header;
        if let Some(origin) = header.backend.not_replayable_reason() {
            return Err(format!("it was recorded {origin}"));
        }
        if trace.end.is_none() {
            return Err("its recording broke off".to_owned());
        }
        if !trace.recoveries.is_empty() {
            return Err("it was recovered".to_owned());
        }
        if name.chars().any(char::is_control) {
            return Err("its name has control characters".to_owned());
        }
        if header.clone().identified().episode_id != header.episode_id {
            return Err("its id is not that of its inputs".to_owned());
        }
        Ok(Self {
            name: name.to_owned(),
            header: header.clone(),
            task: trace.task.clone(),
            scene: trace.scene.clone(),
            inputs: trace.steps.iter().map(|step| step.input.clone()).collect(),
            timings: trace.timings.clone(),
            images: match trace.image_count() {
                0 => Images::None,
                _ => Images::Full,
            },
            layers: trace.layers(),
            chain: trace.chain(),
            digest: Digest::of(bytes),
            bytes: bytes.len() as u64,
            covered: trace.covered,
        })
    }

    /// As it is read back once it is packed.
    ///
    /// # Errors
    /// What cannot be read back.
    pub fn stored(&self) -> Result<Self, String> {
        let task = (self.task.clone(), self.header.task_digest);
        let scene = (self.scene.clone(), self.header.scene_digest);
        let message = self.encode(0, 0);
        bounds::check(&message.encode_to_vec())?;
        Self::decode(message, task, scene)
    }

    fn encode(&self, task: u32, scene: u32) -> reel::PackedEpisode {
        let mut start = codec::start(&self.header);
        start.build.clone_from(&self.header.build);
        for implied in [
            &mut start.episode_id,
            &mut start.task_id,
            &mut start.family,
            &mut start.scene_id,
            &mut start.backend,
        ] {
            implied.clear();
        }
        start.task_digest.clear();
        start.scene_digest.clear();
        let numbered = self.inputs.iter().enumerate();
        let steps = numbered.map(|(step, input)| {
            let timing = self.timings.get(&(step as u32));
            packed_step(input, timing)
        });
        reel::PackedEpisode {
            name: self
                .name
                .replace(&self.header.episode_id, ID)
                .replace(&in_name(&self.header.task_id), TASK_ID),
            task,
            scene,
            start: Some(start),
            steps: steps.collect(),
            images: self.images == Images::Full,
            depth: self.layers.depth,
            masks: self.layers.masks,
            linked_records: self.covered == Covered::Records,
            chain: self.chain.0.to_vec(),
            digest: self.digest.0.to_vec(),
            bytes: self.bytes,
        }
    }

    /// `documents` gives the task and the scene of these numbers, with their digests.
    fn decode(
        message: reel::PackedEpisode,
        (task, task_digest): (Arc<Task>, Digest),
        (scene, scene_digest): (Arc<Scene>, Digest),
    ) -> Result<Self, String> {
        let mut start = message.start.ok_or("its start is missing")?;
        start.task_id.clone_from(&task.task_id);
        start.family = codec::word(&task.family);
        start.scene_id.clone_from(&scene.scene_id);
        start.task_digest = task_digest.0.to_vec();
        start.scene_digest = scene_digest.0.to_vec();
        start.backend = codec::word(&Backend::Sim);
        let header = codec::read_header(start)?.identified();
        let (mut inputs, mut timings) = (Vec::new(), BTreeMap::new());
        for (number, step) in (0..).zip(message.steps) {
            if let Some(timing) = &step.timing {
                timings.insert(
                    number,
                    Timing {
                        called_unix_ns: timing.called_unix_ns,
                        took_ns: timing.took_ns,
                    },
                );
            }
            inputs.push(read_step(step)?);
        }
        Ok(Self {
            name: message
                .name
                .replace(TASK_ID, &in_name(&header.task_id))
                .replace(ID, &header.episode_id),
            header,
            task,
            scene,
            inputs,
            timings,
            images: match message.images {
                true => Images::Full,
                false => Images::None,
            },
            layers: FrameLayers {
                depth: message.depth,
                masks: message.masks,
            },
            chain: codec::digest(&message.chain)?,
            digest: codec::digest(&message.digest)?,
            bytes: message.bytes,
            covered: match message.linked_records {
                true => Covered::Records,
                false => Covered::Messages,
            },
        })
    }
}

/// A task's id as names of traces have it.
fn in_name(task_id: &str) -> String {
    task_id.replace('/', "_")
}

fn packed_step(input: &StepInput, timing: Option<&Timing>) -> reel::PackedStep {
    let refused = input.refused_replies.iter();
    let refused = refused.map(|refused| codec::refused_reply(0, refused));
    let outside = input.user_reply.iter();
    let outside = outside.map(|reply| codec::user_dialogue(0, "outside", reply));
    let policy = input.policy.as_ref();
    reel::PackedStep {
        call: Some(codec::tool_call(0, &input.call, input.lookup.as_ref())),
        policy: policy.map(|policy| reel::PolicyOutput {
            latency_ns: policy.latency_ns,
            ..codec::policy_output(0, policy)
        }),
        replies: refused.chain(outside).collect(),
        logprobs: policy
            .and_then(|policy| policy.logprobs.as_ref())
            .map(|logprobs| codec::logprobs(0, logprobs)),
        timing: timing.map(|timing| codec::timing(0, timing)),
    }
}

fn read_step(step: reel::PackedStep) -> Result<StepInput, String> {
    let (call, lookup) = codec::read_tool_call(step.call.ok_or("a call is missing")?)?;
    let mut policy = step.policy.map(codec::read_policy_output);
    if let (Some(policy), Some(logprobs)) = (&mut policy, step.logprobs) {
        policy.logprobs = Some(codec::read_logprobs(logprobs)?);
    }
    let mut input = StepInput {
        call,
        policy,
        user_reply: None,
        refused_replies: Vec::new(),
        lookup,
    };
    for reply in step.replies {
        match reply.kind.as_str() {
            "refused" => input
                .refused_replies
                .push(codec::read_refused_reply(reply)?),
            _ => input.user_reply = Some(codec::read_reply(reply)?),
        }
    }
    Ok(input)
}
