//! Puts the messages of a trace together to records, in the one order they may have.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::records::MessageHeader;
use prost::Message;
use reel_world::{
    Digest, Outcome, Scene, Task, ToolCall, chain,
    record::{
        EndRecord, EpisodeHeader, GraphChanges, Graphs, Lookup, PolicyOutput, RefusedReply,
        RewardTerm, StartRecord, StepInput, StepRecord, UserReply,
    },
};
use serde::de::DeserializeOwned;

use crate::{
    Timing, Trace, TraceError, codec,
    container::Item,
    image,
    journal::{
        HEADER_METADATA, RECOVERY_METADATA, SCENE_ATTACHMENT, TASK_ATTACHMENT, check_attachment,
        header_metadata,
    },
    reader::{DocumentCache, Parsed},
    robot::{Alignment, CameraImage, PrimitiveOutcome, RobotLog, VlaLatency},
    schema::{
        self,
        foxglove::CompressedImage,
        reel::{self, episode_event::Event},
    },
    sensors::SensorReader,
};

/// A refusal of one message: what is wrong with it, or an error that says so itself.
enum Refusal {
    What(String),
    Error(TraceError),
}

impl From<String> for Refusal {
    fn from(what: String) -> Self {
        Refusal::What(what)
    }
}

impl From<&str> for Refusal {
    fn from(what: &str) -> Self {
        Refusal::What(what.to_owned())
    }
}

/// Records so far, and the moment that is being put together.
pub(crate) struct Assembly<'a> {
    path: &'a Path,
    /// Where images are of no use: tasks and scenes that were parsed before.
    records_only: Option<&'a DocumentCache>,
    attachments: BTreeMap<String, Vec<u8>>,
    metadata: Option<BTreeMap<String, String>>,
    recoveries: Vec<BTreeMap<String, String>>,
    log_time: u64,
    header: Option<EpisodeHeader>,
    settled: Option<reel::EpisodeSettled>,
    start_graphs: Option<Graphs>,
    start: Option<StartRecord>,
    draft: Option<Draft>,
    steps: Vec<StepRecord>,
    end_graphs: Option<Graphs>,
    end: Option<EndRecord>,
    image: Option<Vec<u8>>,
    images: BTreeMap<Option<u32>, Vec<u8>>,
    depth: Option<Vec<u8>>,
    depths: BTreeMap<Option<u32>, Vec<u8>>,
    mask: Option<Vec<u8>>,
    masks: BTreeMap<Option<u32>, Vec<u8>>,
    offsets: Vec<u64>,
    timings: BTreeMap<u32, Timing>,
    robot: RobotLog,
    sensors: SensorReader,
    original: Option<CameraImage>,
    originals: BTreeMap<Option<u32>, CameraImage>,
}

/// A step whose last message has not come yet.
struct Draft {
    offset: u64,
    call: ToolCall,
    policy: Option<PolicyOutput>,
    user_reply: Option<UserReply>,
    refused_replies: Vec<RefusedReply>,
    lookup: Option<Lookup>,
    result: Option<(Outcome, reel::ToolResult)>,
    answer: Option<UserReply>,
    changes: Option<GraphChanges>,
    reward: Option<Vec<RewardTerm>>,
}

impl<'a> Assembly<'a> {
    pub(crate) fn new(path: &'a Path) -> Self {
        Self {
            path,
            records_only: None,
            attachments: BTreeMap::new(),
            metadata: None,
            recoveries: Vec::new(),
            log_time: 0,
            header: None,
            settled: None,
            start_graphs: None,
            start: None,
            draft: None,
            steps: Vec::new(),
            end_graphs: None,
            end: None,
            image: None,
            images: BTreeMap::new(),
            depth: None,
            depths: BTreeMap::new(),
            mask: None,
            masks: BTreeMap::new(),
            offsets: Vec::new(),
            timings: BTreeMap::new(),
            robot: RobotLog::default(),
            sensors: SensorReader::default(),
            original: None,
            originals: BTreeMap::new(),
        }
    }

    /// Leaves out the images.
    pub(crate) fn records_only(path: &'a Path, known: &'a DocumentCache) -> Self {
        Self {
            records_only: Some(known),
            ..Self::new(path)
        }
    }

    /// How many steps are whole.
    pub(crate) fn step_count(&self) -> u32 {
        self.steps.len() as u32
    }

    /// Takes the next thing of the file.
    pub(crate) fn item(&mut self, offset: u64, item: Item) -> Result<(), TraceError> {
        match item {
            Item::Metadata(metadata) if metadata.name == HEADER_METADATA => {
                self.metadata = Some(metadata.metadata.clone());
            }
            Item::Metadata(metadata) if metadata.name == RECOVERY_METADATA => {
                self.recoveries.push(metadata.metadata.clone())
            }
            Item::Attachment { header, data } => {
                let twice = self
                    .attachments
                    .insert(header.name.clone(), data.to_vec())
                    .is_some();
                let what = format!("the attachment {} stands there twice", header.name);
                let damaged = TraceError::Damaged {
                    path: self.path.to_owned(),
                    offset,
                    problem: what,
                };
                return if twice { Err(damaged) } else { Ok(()) };
            }
            Item::Schema { header, data } => self.sensors.schema(header, data),
            Item::Channel(channel) => self.sensors.channel(channel),
            Item::Message {
                header,
                topic,
                data,
            } => {
                return self.message(offset, header, topic, data).map_err(
                    |refusal| match refusal {
                        Refusal::Error(error) => error,
                        Refusal::What(what) => TraceError::Message {
                            path: self.path.to_owned(),
                            offset,
                            topic: topic.to_owned(),
                            problem: what,
                        },
                    },
                );
            }
            // Metadata of others, and what the container is made of.
            _ => {}
        }
        Ok(())
    }

    /// The call that was received, but of which nothing came that is whole.
    pub(crate) fn under_way(&self) -> Option<(u32, StepInput)> {
        self.draft.as_ref().map(|draft| {
            (
                self.step_count(),
                StepInput {
                    call: draft.call.clone(),
                    policy: draft.policy.clone(),
                    user_reply: draft.user_reply.clone(),
                    refused_replies: draft.refused_replies.clone(),
                    lookup: draft.lookup.clone(),
                },
            )
        })
    }

    /// Whether the start is whole.
    pub(crate) fn has_start(&self) -> bool {
        self.start.is_some()
    }

    /// The names of the recordings that were recovered, where nothing of an episode was.
    pub(crate) fn nothing_restored(&self) -> Option<TraceError> {
        let last = self.recoveries.last().filter(|_| self.start.is_none())?;
        let of = |key: &str| last.get(key).cloned().unwrap_or_default();
        Some(TraceError::NothingRestored {
            path: self.path.to_owned(),
            source_name: of("source"),
            lost: of("lost"),
        })
    }

    /// What is known before the first call, if all of it can be read.
    pub(crate) fn head(&self) -> Result<(EpisodeHeader, Arc<Task>, Arc<Scene>), TraceError> {
        let Some(header) = self.header.clone() else {
            return Err(self.missing("header of an episode"));
        };
        let task = self.attachment(TASK_ATTACHMENT, header.task_digest, |known| &known.tasks)?;
        let scene =
            self.attachment(SCENE_ATTACHMENT, header.scene_digest, |known| &known.scenes)?;
        Ok((header, task, scene))
    }

    /// What a finished file must hold besides.
    pub(crate) fn check_finished(&self) -> Result<(), TraceError> {
        if self.end.is_some() {
            Ok(())
        } else {
            Err(self.missing("end of the episode"))
        }
    }

    /// Whether an unfinished recording ends with a whole step.
    pub(crate) fn check_open(&self, bytes: u64) -> Result<(), TraceError> {
        let (offset, lost) = match &self.draft {
            Some(draft) => (
                draft.offset,
                format!(
                    "call {} was received, {}, but not what came of it",
                    self.steps.len(),
                    draft.call
                ),
            ),
            None if self.start.is_none() => (bytes, "the state after settling".to_owned()),
            None if self.end_graphs.is_some() && self.end.is_none() => {
                (bytes, "the end of the episode".to_owned())
            }
            None => return Ok(()),
        };
        Err(TraceError::Torn {
            path: self.path.to_owned(),
            offset,
            steps_readable: self.step_count(),
            lost,
        })
    }

    /// The trace up to here.
    ///
    /// # Errors
    /// When there is no state after settling.
    pub(crate) fn into_trace(mut self, bytes: u64) -> Result<Trace, TraceError> {
        let (header, task, scene) = self.head()?;
        let Some(start) = self.start.take() else {
            return Err(self.missing("state after settling"));
        };
        Ok(Trace {
            path: self.path.to_owned(),
            header,
            task,
            scene,
            meshes: reel_world::Meshes::default(),
            start,
            steps: self.steps,
            end: self.end,
            bytes,
            recoveries: self.recoveries,
            images: self.images,
            depths: self.depths,
            masks: self.masks,
            offsets: self.offsets,
            timings: self.timings,
            robot: self.robot,
            sensors: self.sensors.into_channels(),
            originals: self.originals,
        })
    }

    fn message(
        &mut self,
        offset: u64,
        header: &MessageHeader,
        topic: &str,
        data: &[u8],
    ) -> Result<(), Refusal> {
        let Some(channel) = schema::channel(topic) else {
            // Images of cameras are among them.
            if self.records_only.is_none() {
                self.sensors.message(header, data);
            }
            return Ok(());
        };
        if self.end.is_some() {
            return Err("the episode is already over".into());
        }
        if header.log_time <= self.log_time {
            return Err("it is not later than the message before it".into());
        }
        self.log_time = header.log_time;
        match channel {
            schema::EPISODE => match decode::<reel::EpisodeEvent>(data)?
                .event
                .ok_or("it holds no event")?
            {
                Event::Start(start) => self.episode_start(start),
                Event::Settled(settled) => once(&mut self.settled, settled),
                Event::End(end) => self.episode_end(end),
            },
            schema::WORLD_GRAPH => self.world_graph(decode(data)?),
            schema::TOOL_CALL => self.tool_call(offset, decode(data)?),
            schema::POLICY_OUTPUT => {
                let message: reel::PolicyOutput = decode(data)?;
                let draft = self.draft(message.step)?;
                once(&mut draft.policy, codec::read_policy_output(message))
            }
            schema::LOGPROBS => {
                let message: reel::TokenLogprobs = decode(data)?;
                let policy = self
                    .draft(message.step)?
                    .policy
                    .as_mut()
                    .ok_or("the policy output of its step is missing before it")?;
                once(&mut policy.logprobs, codec::read_logprobs(message)?)
            }
            schema::USER_DIALOGUE => {
                let message: reel::UserDialogue = decode(data)?;
                let draft = self.draft(message.step)?;
                match message.kind.as_str() {
                    "refused" => {
                        let refused = codec::read_refused_reply(message)?;
                        draft.refused_replies.push(refused);
                        Ok(())
                    }
                    "outside" => once(&mut draft.user_reply, codec::read_reply(message)?),
                    "answer" => once(&mut draft.answer, codec::read_reply(message)?),
                    other => Err(format!("{other:?} is not a kind of reply").into()),
                }
            }
            schema::TOOL_RESULT => {
                let message: reel::ToolResult = decode(data)?;
                let draft = self.draft(message.step)?;
                once(&mut draft.result, (codec::read_outcome(&message)?, message))
            }
            schema::TIMING => {
                let message: reel::Timing = decode(data)?;
                self.draft(message.step)?;
                let timing = Timing {
                    called_unix_ns: message.called_unix_ns,
                    took_ns: message.took_ns,
                };
                match self.timings.insert(message.step, timing) {
                    None => Ok(()),
                    Some(_) => Err("it was already said".into()),
                }
            }
            schema::ODOMETRY => {
                let measured = codec::read_odometry(decode(data)?)?;
                self.expect_moment(measured.step)?;
                self.robot.odometry.push(measured);
                Ok(())
            }
            schema::PRIMITIVE => {
                let outcome = PrimitiveOutcome::from(decode::<reel::PrimitiveOutcome>(data)?);
                self.expect_moment(outcome.step)?;
                self.robot.primitives.push(outcome);
                Ok(())
            }
            schema::VLA => {
                let measured = VlaLatency::from(decode::<reel::VlaLatency>(data)?);
                self.expect_moment(measured.step)?;
                self.robot.vla.push(measured);
                Ok(())
            }
            schema::ALIGNMENT => {
                let measured = Alignment::from(decode::<reel::Alignment>(data)?);
                self.expect_moment(measured.step)?;
                self.robot.alignments.push(measured);
                Ok(())
            }
            schema::CAMERA_ORIGINAL if self.records_only.is_some() => Ok(()),
            schema::CAMERA_ORIGINAL => {
                let image: CompressedImage = decode(data)?;
                once(
                    &mut self.original,
                    CameraImage {
                        format: image.format,
                        data: image.data,
                    },
                )
            }
            schema::WORLD_DIFF => {
                let message: reel::WorldDiff = decode(data)?;
                let draft = self.draft(message.step)?;
                once(&mut draft.changes, codec::read_changes(message)?)
            }
            schema::REWARD => self.reward(decode(data)?),
            schema::CAMERA if self.records_only.is_some() => Ok(()),
            schema::CAMERA => match image::finished(decode(data)?) {
                Some(image) => once(&mut self.image, image.data),
                None => Ok(()),
            },
            schema::DEPTH | schema::INSTANCES if self.records_only.is_some() => Ok(()),
            schema::DEPTH => once(&mut self.depth, image::layer(decode(data)?)?),
            schema::INSTANCES => once(&mut self.mask, image::layer(decode(data)?)?),
            schema::SIM_DIGEST => self.moment(codec::read_sim_digest(decode(data)?)?),
            // Derived for viewers; a recorder writes them, nobody reads them back.
            _ => Ok(()),
        }
    }

    fn episode_start(&mut self, message: reel::EpisodeStart) -> Result<(), Refusal> {
        let header = codec::read_header(message)?;
        let listed = self
            .metadata
            .as_ref()
            .ok_or("there is no metadata record of the header")?;
        for (key, value) in header_metadata(&header) {
            if listed.get(&key).is_some_and(|listed| *listed != value) {
                return Err(format!(
                    "{key} is {value:?}, but {:?} in the metadata record",
                    listed[&key]
                )
                .into());
            }
        }
        once(&mut self.header, header)
    }

    fn world_graph(&mut self, message: reel::WorldGraphs) -> Result<(), Refusal> {
        match (message.moment.as_str(), self.start.is_some()) {
            ("start", false) => once(&mut self.start_graphs, codec::read_graphs(message)?),
            ("end", true) if self.draft.is_none() => {
                once(&mut self.end_graphs, codec::read_graphs(message)?)
            }
            (moment, _) => Err(format!("the graphs of {moment:?} are out of place").into()),
        }
    }

    fn tool_call(&mut self, offset: u64, message: reel::ToolCall) -> Result<(), Refusal> {
        let expected = self.step_count();
        if self.start.is_none()
            || self.draft.is_some()
            || self.end_graphs.is_some()
            || message.step != expected
        {
            return Err(format!(
                "call {} is out of place, {expected} whole steps are before it",
                message.step
            )
            .into());
        }
        let (call, lookup) = codec::read_tool_call(message)?;
        self.draft = Some(Draft {
            offset,
            call,
            lookup,
            policy: None,
            user_reply: None,
            refused_replies: Vec::new(),
            result: None,
            answer: None,
            changes: None,
            reward: None,
        });
        Ok(())
    }

    fn reward(&mut self, message: reel::Reward) -> Result<(), Refusal> {
        let preset = self
            .header
            .as_ref()
            .map(|header| header.reward_preset.clone())
            .unwrap_or_default();
        if message.preset != preset {
            return Err(format!(
                "the preset is {:?}, but {preset:?} in the header",
                message.preset
            )
            .into());
        }
        let draft = self.draft(message.step)?;
        once(&mut draft.reward, codec::read_reward(message.terms)?)
    }

    /// The last message of a moment: makes the record and checks its link of the chain.
    fn moment(&mut self, moment: codec::DigestMessage) -> Result<(), Refusal> {
        let (at, found) = (moment.step, moment.digests.chain);
        let expected = match moment.step {
            None => {
                let (Some(header), Some(settled), Some(graphs)) =
                    (&self.header, self.settled.take(), self.start_graphs.take())
                else {
                    return Err(
                        "header, settled state or graphs of the start are missing before it".into(),
                    );
                };
                let start = StartRecord {
                    graphs,
                    bodies: moment.bodies,
                    robot: moment.robot,
                    visible: codec::read_visible(settled.visible)?,
                    shortest_path_m: settled.shortest_path_m,
                    digests: moment.digests,
                };
                let link = chain::start_link(header, &start);
                once(&mut self.start, start)?;
                link
            }
            Some(step) => {
                self.draft(step)?;
                let before = self.last_link();
                let draft = self.draft.take().ok_or("its call is missing")?;
                let offset = draft.offset;
                let record = draft.into_record(step, moment)?;
                let link = chain::step_link(&before, &record);
                self.steps.push(record);
                self.offsets.push(offset);
                link
            }
        };
        if expected != found {
            // The record is not believed; what is before it stays readable.
            match at {
                None => self.start = None,
                Some(_) => drop((self.steps.pop(), self.offsets.pop())),
            }
            return Err(Refusal::Error(TraceError::ChainBroken {
                path: self.path.to_owned(),
                step: at,
                expected,
                found,
            }));
        }
        if let Some(image) = self.image.take() {
            self.images.insert(at, image);
        }
        if let Some(depth) = self.depth.take() {
            self.depths.insert(at, depth);
        }
        if let Some(mask) = self.mask.take() {
            self.masks.insert(at, mask);
        }
        if let Some(original) = self.original.take() {
            self.originals.insert(at, original);
        }
        Ok(())
    }

    fn episode_end(&mut self, message: reel::EpisodeEnd) -> Result<(), Refusal> {
        if self.draft.is_some() {
            return Err("a step before it is not whole".into());
        }
        let graphs = self
            .end_graphs
            .clone()
            .ok_or("the graphs of the end are missing before it")?;
        let end = codec::read_end(message, graphs)?;
        let expected = self.last_link();
        if end.chain != expected {
            let (path, step) = (PathBuf::from(self.path), self.step_count().checked_sub(1));
            return Err(Refusal::Error(TraceError::ChainBroken {
                path,
                step,
                expected,
                found: end.chain,
            }));
        }
        if end.steps != self.step_count() {
            return Err(format!(
                "it speaks of {} steps, but there are {}",
                end.steps,
                self.step_count()
            )
            .into());
        }
        once(&mut self.end, end)
    }

    fn last_link(&self) -> Digest {
        let start = self
            .start
            .as_ref()
            .map(|start| start.digests.chain)
            .unwrap_or_default();
        self.steps.last().map_or(start, |step| step.digests.chain)
    }

    /// What a robot measured belongs to the step in the making, or stands before the start.
    fn expect_moment(&mut self, step: Option<u32>) -> Result<(), Refusal> {
        match step {
            Some(step) => self.draft(step).map(drop),
            None if self.start.is_none() => Ok(()),
            None => Err("it belongs to no step, but stands behind the start".into()),
        }
    }

    /// The step in the making, if a message belongs to it.
    fn draft(&mut self, step: u32) -> Result<&mut Draft, Refusal> {
        let expected = self.step_count();
        match &mut self.draft {
            Some(draft) if step == expected => Ok(draft),
            Some(_) => {
                Err(format!("it belongs to step {step}, but stands in step {expected}").into())
            }
            None => Err(format!("the call of step {step} is missing before it").into()),
        }
    }

    fn attachment<T: DeserializeOwned>(
        &self,
        name: &'static str,
        expected: Digest,
        parsed: fn(&DocumentCache) -> &Parsed<T>,
    ) -> Result<Arc<T>, TraceError> {
        let Some(json) = self.attachments.get(name) else {
            return Err(self.missing(name));
        };
        let parsed = self.records_only.map(parsed);
        if let Some(value) = parsed.and_then(|parsed| parsed.get(&expected, json)) {
            return Ok(value);
        }
        check_attachment(self.path, name, expected, json)?;
        let value = serde_json::from_slice(json)
            .map(Arc::new)
            .map_err(|error| TraceError::Damaged {
                path: self.path.to_owned(),
                offset: 0,
                problem: format!("the attachment {name} is not what it should be ({error})"),
            })?;
        if let Some(parsed) = parsed {
            parsed.keep(expected, json, &value);
        }
        Ok(value)
    }

    fn missing(&self, what: &'static str) -> TraceError {
        TraceError::Missing {
            path: self.path.to_owned(),
            part: what,
        }
    }
}

impl Draft {
    fn into_record(self, step: u32, moment: codec::DigestMessage) -> Result<StepRecord, Refusal> {
        let (outcome, result) = self.result.ok_or("the result of its step is missing")?;
        Ok(StepRecord {
            step,
            input: StepInput {
                call: self.call,
                policy: self.policy,
                user_reply: self.user_reply,
                refused_replies: self.refused_replies,
                lookup: self.lookup,
            },
            outcome,
            tool: result.tool,
            reply: self.answer,
            markers: codec::read_markers(result.markers)?,
            visible: codec::read_visible(result.visible)?,
            listed: result.listed.into_iter().map(Into::into).collect(),
            object: result.object.map(Into::into),
            receptacle: result.receptacle.map(Into::into),
            held: result.held.map(Into::into),
            changes: self
                .changes
                .ok_or("the world changes of its step are missing")?,
            bodies: moment.bodies,
            robot: moment.robot,
            sim_step: moment.sim_step,
            reward: self.reward.ok_or("the reward of its step is missing")?,
            digests: moment.digests,
        })
    }
}

fn decode<M: Message + Default>(data: &[u8]) -> Result<M, Refusal> {
    codec::decode_message(data).map_err(Refusal::What)
}

/// Sets what may be said only once.
fn once<T>(slot: &mut Option<T>, value: T) -> Result<(), Refusal> {
    if slot.is_some() {
        return Err("it was already said".into());
    }
    *slot = Some(value);
    Ok(())
}
