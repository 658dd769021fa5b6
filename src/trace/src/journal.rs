//! The records of an episode as MCAP messages, in their one order, onto anything that can be
//! written to. Checks the turn and makes the hash chain. Knows no files. What a robot or a clock measured
//! beside the records is in [`measured`].

mod measured;

use std::{
    borrow::Cow,
    collections::BTreeMap,
    io::{Seek, Write},
    path::{Path, PathBuf},
};

use mcap::{
    McapError, WriteOptions,
    records::{AttachmentHeader, MessageHeader, Metadata},
};
use prost::Message;
use reel_world::{
    Digest, FRAME_HEIGHT, FRAME_WIDTH, Frame, Scene, Task, canonical_json, little_endian,
    record::{
        Backend, BodyState, EndRecord, EpisodeHeader, RobotState, StartRecord, StepInput,
        StepRecord, VisibleObject,
    },
};

use crate::{
    FrameLayers, Images, TraceError,
    chain::{self, Covered, MessageChain},
    codec, container, encode_webp, image,
    schema::{
        self, Channel,
        foxglove::log::Level,
        reel::{self, episode_event::Event},
    },
    viewer,
};

/// Log time of simulation time zero: 2020-01-01T00:00:00Z in nanoseconds since 1970.
pub(crate) const EPOCH_NS: u64 = 1_577_836_800_000_000_000;
/// Most time of policies that moves log times, ten years in nanoseconds: a
/// clock that cannot overflow.
const POLICY_NS_MAX: u64 = 315_360_000_000_000_000;
/// Physics steps in a second of simulation time.
const STEPS_PER_S: u128 = 240;
/// Name of the metadata record that lists the header.
pub(crate) const HEADER_METADATA: &str = "reel.episode";
/// Name of the metadata records that say how a trace was recovered.
pub(crate) const RECOVERY_METADATA: &str = "reel.recovery";
/// Name of the task's attachment.
pub(crate) const TASK_ATTACHMENT: &str = "task.json";
/// Name of the scene's attachment.
pub(crate) const SCENE_ATTACHMENT: &str = "scene.json";

/// Name of the attachment that says what instance ids stand for, where there are masks.
const INSTANCES_ATTACHMENT: &str = "instances.json";

/// An image on its way into a trace.
#[derive(Clone, Copy)]
pub(crate) enum FrameSource<'a> {
    /// 8-bit RGB, to be encoded.
    Rgb(&'a [u8]),
    /// An image that is already encoded as WebP and stored as it is.
    Webp(&'a [u8]),
    /// A PNG file in Base64, as a protocol brought it; the finished file holds it as WebP.
    Base64(&'a str),
}

/// What a frame holds besides its image, on its way into a trace; written where it was asked for.
#[derive(Clone, Default)]
pub(crate) struct Layers<'a> {
    /// 16-bit depth in millimetres, little-endian.
    pub depth: Option<Cow<'a, [u8]>>,
    /// 16-bit instance ids, little-endian.
    pub masks: Option<Cow<'a, [u8]>>,
}

impl Layers<'_> {
    /// Those of a frame that are wanted; one without pixels has none.
    pub(crate) fn of(frame: Option<&Frame>, wanted: FrameLayers) -> Self {
        let bytes = |wanted: bool, values: fn(&Frame) -> &Vec<u16>| {
            let values = frame.filter(|_| wanted).map(values);
            let values = values.filter(|values| !values.is_empty());
            values.map(|values| little_endian(values).into())
        };
        Self {
            depth: bytes(wanted.depth, |frame| &frame.depth_mm),
            masks: bytes(wanted.masks, |frame| &frame.ids),
        }
    }
}

/// Writes one episode. Calls come in the order `start`, then `input` and `step` for
/// each step, then `end`.
pub(crate) struct Journal<W: Write + Seek> {
    /// Path of the recording, named in error messages.
    path: PathBuf,
    images: Images,
    layers: FrameLayers,
    reward_preset: String,
    header: EpisodeHeader,
    /// Always there until `into_inner` or drop; taken then, because the writer of the library
    /// would close the file.
    writer: Option<mcap::Writer<W>>,
    /// Messages written so far, by channel.
    written: BTreeMap<u16, u32>,
    log_time: u64,
    sim_step: u64,
    /// Time that the policy took so far, where there is no simulation time.
    policy_ns: u64,
    bodies: Vec<BodyState>,
    /// The link in the making; none where links cover records, in an old trace that is written again.
    chain: Option<MessageChain>,
    link: Digest,
    turn: Expected,
}

/// What the recorder waits for.
#[derive(Debug)]
enum Expected {
    Start,
    InputOrEnd {
        step: u32,
    },
    Step {
        step: u32,
        input: Box<StepInput>,
    },
    /// Writing failed half-way; nothing may follow.
    Failed,
}

impl<W: Write + Seek> Journal<W> {
    /// Writes the inputs that are known before the first call.
    pub(crate) fn create(
        sink: W,
        path: &Path,
        (header, task, scene): (&EpisodeHeader, &Task, &Scene),
        (images, layers): (Images, FrameLayers),
        recoveries: &[BTreeMap<String, String>],
        covered: Covered,
    ) -> Result<Self, TraceError> {
        let (task_json, scene_json) = (canonical_json(task), canonical_json(scene));
        check_attachment(
            path,
            TASK_ATTACHMENT,
            header.task_digest,
            task_json.as_bytes(),
        )?;
        check_attachment(
            path,
            SCENE_ATTACHMENT,
            header.scene_digest,
            scene_json.as_bytes(),
        )?;
        let options = WriteOptions::new()
            .library(container::LIBRARY)
            .use_chunks(false);
        let writer = options
            .create(sink)
            .map_err(|error| TraceError::unwritten(path, error))?;
        let mut journal = Journal {
            path: path.to_owned(),
            images,
            layers,
            reward_preset: header.reward_preset.clone(),
            header: header.clone(),
            writer: Some(writer),
            written: BTreeMap::new(),
            log_time: 0,
            sim_step: 0,
            policy_ns: 0,
            bodies: Vec::new(),
            chain: (covered == Covered::Messages).then(MessageChain::new),
            link: Digest::default(),
            turn: Expected::Failed,
        };
        journal.attach(TASK_ATTACHMENT, &task_json)?;
        journal.attach(SCENE_ATTACHMENT, &scene_json)?;
        if layers.masks {
            let table = canonical_json(&reel_world::instances(task, scene));
            journal.attach(INSTANCES_ATTACHMENT, &table)?;
        }
        let metadata = Metadata {
            name: HEADER_METADATA.to_owned(),
            metadata: header_metadata(header),
        };
        journal.with_writer(|writer| writer.write_metadata(&metadata))?;
        for recovery in recoveries {
            let metadata = Metadata {
                name: RECOVERY_METADATA.to_owned(),
                metadata: recovery.clone(),
            };
            journal.with_writer(|writer| writer.write_metadata(&metadata))?;
        }
        let mut start = codec::episode_start(header);
        if let (false, Some(Event::Start(start))) = (journal.chain.is_some(), &mut start.event) {
            start.build.clone_from(&header.build);
        }
        journal.message(schema::EPISODE, &start)?;
        journal.message(schema::SCENE, &viewer::scene(EPOCH_NS, scene, task))?;
        if images == Images::Full || layers.any() {
            journal.message(schema::CALIBRATION, &viewer::calibration(EPOCH_NS))?;
        }
        journal.flush()?;
        journal.turn = Expected::Start;
        Ok(journal)
    }

    /// Records the state after settling.
    pub(crate) fn start(
        &mut self,
        record: &StartRecord,
        frame: Option<FrameSource>,
        layers: Layers<'_>,
    ) -> Result<(), TraceError> {
        if !matches!(self.turn, Expected::Start) {
            return Err(self.out_of_turn("the start"));
        }
        self.turn = Expected::Failed;
        self.message(schema::EPISODE, &codec::episode_settled(record))?;
        self.message(
            schema::WORLD_GRAPH,
            &codec::world_graphs("start", &record.graphs),
        )?;
        self.layers(None, layers)?;
        self.derived(None, frame, &record.visible, &record.robot, &record.bodies)?;
        let header = &self.header;
        let line = format!(
            "episode {}: task {} ({}), scene {}, seed {}, policy {}",
            header.episode_id,
            header.task_id,
            header.family,
            header.scene_id,
            header.seed,
            header.policy.name
        );
        self.message(
            schema::LOG,
            &viewer::line(self.time_ns(), Level::Info, line),
        )?;
        let digest = codec::sim_digest(None, 0, &record.bodies, &record.robot, &record.digests);
        self.moment(digest, |journal| {
            chain::records::start_link(&journal.header, record)
        })?;
        self.flush()?;
        self.turn = Expected::InputOrEnd { step: 0 };
        Ok(())
    }

    /// Records the inputs of a step, before they are used.
    pub(crate) fn input(&mut self, step: u32, input: &StepInput) -> Result<(), TraceError> {
        if !matches!(self.turn, Expected::InputOrEnd { step: next } if next == step) {
            return Err(self.out_of_turn(&format!("the input of step {step}")));
        }
        self.turn = Expected::Failed;
        if self.header.backend != Backend::Sim {
            let latency_ns = input
                .policy
                .as_ref()
                .and_then(|policy| policy.latency_ns)
                .unwrap_or(0);
            self.policy_ns = self.policy_ns.saturating_add(latency_ns).min(POLICY_NS_MAX);
        }
        self.message(
            schema::TOOL_CALL,
            &codec::tool_call(step, &input.call, input.lookup.as_ref()),
        )?;
        if let Some(policy) = &input.policy {
            let mut output = codec::policy_output(step, policy);
            if self.chain.is_none() {
                output.latency_ns = policy.latency_ns;
            }
            self.message(schema::POLICY_OUTPUT, &output)?;
            if let (true, Some(ns)) = (self.chain.is_some(), policy.latency_ns) {
                self.message(schema::POLICY_LATENCY, &codec::policy_latency(step, ns))?;
            }
            if let Some(logprobs) = &policy.logprobs {
                self.message(schema::LOGPROBS, &codec::logprobs(step, logprobs))?;
            }
        }
        for refused in &input.refused_replies {
            self.message(schema::USER_DIALOGUE, &codec::refused_reply(step, refused))?;
        }
        if let Some(reply) = &input.user_reply {
            self.message(
                schema::USER_DIALOGUE,
                &codec::user_dialogue(step, "outside", reply),
            )?;
        }
        self.flush()?;
        self.turn = Expected::Step {
            step,
            input: Box::new(input.clone()),
        };
        Ok(())
    }

    /// Records what came of a step.
    pub(crate) fn step(
        &mut self,
        record: &StepRecord,
        frame: Option<FrameSource>,
        layers: Layers<'_>,
    ) -> Result<(), TraceError> {
        if !matches!(&self.turn, Expected::Step { step, input } if *step == record.step && **input == record.input)
        {
            return Err(self.out_of_turn(&format!("step {} ({})", record.step, record.input.call)));
        }
        self.turn = Expected::Failed;
        self.sim_step = record.sim_step;
        self.message(schema::TOOL_RESULT, &codec::tool_result(record))?;
        if let Some(reply) = &record.reply {
            self.message(
                schema::USER_DIALOGUE,
                &codec::user_dialogue(record.step, "answer", reply),
            )?;
        }
        self.message(schema::WORLD_DIFF, &codec::world_diff(record))?;
        let reward = codec::reward(&self.reward_preset, record);
        self.message(schema::REWARD, &reward)?;
        self.layers(Some(record.step), layers)?;
        self.derived(
            Some(record.step),
            frame,
            &record.visible,
            &record.robot,
            &record.bodies,
        )?;
        self.message(schema::LOG, &viewer::step_line(self.time_ns(), record))?;
        let digest = codec::sim_digest(
            Some(record.step),
            record.sim_step,
            &record.bodies,
            &record.robot,
            &record.digests,
        );
        self.moment(digest, |journal| {
            chain::records::step_link(&journal.link, record)
        })?;
        self.flush()?;
        self.turn = Expected::InputOrEnd {
            step: record.step + 1,
        };
        Ok(())
    }

    /// Records the end of the episode: final graphs, metrics and reason.
    pub(crate) fn end(&mut self, record: &EndRecord) -> Result<(), TraceError> {
        if !matches!(self.turn, Expected::InputOrEnd { step } if step == record.steps) {
            return Err(self.out_of_turn(&format!("the end after {} steps", record.steps)));
        }
        self.turn = Expected::Failed;
        self.message(
            schema::WORLD_GRAPH,
            &codec::world_graphs("end", &record.graphs),
        )?;
        if !record.reported.is_empty() {
            self.message(schema::REPORTED, &codec::reported(&record.reported))?;
        }
        let metrics = &record.metrics;
        let line = format!(
            "{} after {} steps: success {}, completion {:.2}, total reward {:.3}",
            codec::word(&record.reason),
            record.steps,
            metrics.success,
            metrics.completion,
            metrics.total_reward
        );
        self.message(
            schema::LOG,
            &viewer::line(self.time_ns(), Level::Info, line),
        )?;
        let mut end = codec::episode_end(record);
        if let (false, Some(Event::End(end))) = (self.chain.is_some(), &mut end.event) {
            end.chain = self.link.0.to_vec();
        }
        self.message(schema::EPISODE, &end)?;
        self.close_link()?;
        self.flush()
    }

    /// What is written of frames besides images.
    pub(crate) fn wanted_layers(&self) -> FrameLayers {
        self.layers
    }

    /// How many steps are whole; none before the start.
    pub(crate) fn steps(&self) -> Option<u32> {
        match self.turn {
            Expected::InputOrEnd { step } | Expected::Step { step, .. } => Some(step),
            Expected::Start | Expected::Failed => None,
        }
    }

    /// The last link of the hash chain.
    pub(crate) fn chain(&self) -> Digest {
        self.link
    }

    /// Lets go of what was written, without the library's closing records, which belong
    /// to finished files only.
    pub(crate) fn into_inner(mut self) -> W {
        self.writer
            .take()
            .expect("it is taken only here and on drop")
            .into_inner()
    }

    /// The current moment as log time: simulation time, and the policy's where the world
    /// is not simulated here.
    fn time_ns(&self) -> u64 {
        let ns = u128::from(self.sim_step) * 1_000_000_000 / STEPS_PER_S;
        (EPOCH_NS + self.policy_ns).saturating_add(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    /// What viewers draw of a moment.
    fn derived(
        &mut self,
        step: Option<u32>,
        frame: Option<FrameSource>,
        visible: &[VisibleObject],
        robot: &RobotState,
        bodies: &[BodyState],
    ) -> Result<(), TraceError> {
        let ns = self.time_ns();
        if let (Images::Full, Some(taken)) = (self.images, frame) {
            let (format, data) = match taken {
                FrameSource::Webp(webp) => ("webp", webp.to_vec()),
                FrameSource::Rgb(rgb) => ("webp", self.encode(step, rgb)?),
                FrameSource::Base64(text) => (image::BASE64_PNG, text.as_bytes().to_vec()),
            };
            self.message(schema::CAMERA, &viewer::image_message(ns, format, data))?;
            self.message(schema::ANNOTATIONS, &viewer::annotations(ns, visible))?;
        }
        let transforms = viewer::transforms(ns, robot, bodies, &self.bodies);
        self.bodies = bodies.to_vec();
        self.message(schema::TRANSFORMS, &transforms)
    }

    /// What was asked for of a frame besides its image.
    fn layers(&mut self, step: Option<u32>, layers: Layers<'_>) -> Result<(), TraceError> {
        let wanted = [
            (schema::DEPTH, self.layers.depth, layers.depth, "depth"),
            (schema::INSTANCES, self.layers.masks, layers.masks, "masks"),
        ];
        for (channel, wanted, data, name) in wanted {
            let Some(data) = data.filter(|_| wanted) else {
                continue;
            };
            if data.len() != image::LAYER_BYTES {
                return Err(TraceError::Image {
                    path: self.path.clone(),
                    step,
                    problem: format!(
                        "has {} bytes of {name} instead of {}",
                        data.len(),
                        image::LAYER_BYTES
                    ),
                });
            }
            let message = viewer::raw_image(self.time_ns(), data.into_owned());
            self.message(channel, &message)?;
        }
        Ok(())
    }

    fn encode(&self, step: Option<u32>, rgb: &[u8]) -> Result<Vec<u8>, TraceError> {
        let (expected, found) = (FRAME_WIDTH * FRAME_HEIGHT * 3, rgb.len());
        if expected != found {
            let what = format!("has {found} bytes instead of {expected}");
            return Err(TraceError::Image {
                path: self.path.clone(),
                step,
                problem: what,
            });
        }
        Ok(encode_webp(rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32))
    }

    /// The last record of a moment, and its link: behind it, or in it where links cover records.
    fn moment(
        &mut self,
        mut digest: reel::SimDigest,
        over_records: impl FnOnce(&Self) -> Digest,
    ) -> Result<(), TraceError> {
        if self.chain.is_none() {
            self.link = over_records(self);
            digest.chain = self.link.0.to_vec();
        }
        self.message(schema::SIM_DIGEST, &digest)?;
        self.close_link()
    }

    /// Writes the link over the messages since the link before.
    fn close_link(&mut self) -> Result<(), TraceError> {
        let Some(chain) = &mut self.chain else {
            return Ok(());
        };
        self.link = chain.link();
        let link = self.link.0.to_vec();
        self.message(schema::CHAIN, &reel::ChainLink { link })
    }

    fn attach(&mut self, name: &str, json: &str) -> Result<(), TraceError> {
        let header = AttachmentHeader {
            log_time: EPOCH_NS,
            create_time: EPOCH_NS,
            name: name.to_owned(),
            media_type: "application/json".to_owned(),
        };
        self.with_writer(|writer| writer.attach(&container::attachment(header, json.as_bytes())))
    }

    /// Appends a message at the current simulation time, or right behind the message before.
    fn message<M: Message>(&mut self, channel: Channel, message: &M) -> Result<(), TraceError> {
        self.log_time = self.time_ns().max(self.log_time + 1);
        if !self.written.contains_key(&channel.id) {
            self.with_writer(|writer| container::announce(writer, &channel))?;
        }
        let sequence = self.written.entry(channel.id).or_insert(0);
        *sequence += 1;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: *sequence,
            log_time: self.log_time,
            publish_time: self.log_time,
        };
        let data = message.encode_to_vec();
        if let Some(chain) = &mut self.chain {
            chain.cover(channel, &data);
        }
        self.with_writer(|writer| writer.write_to_known_channel(&header, &data))
    }

    /// Hands everything written so far to the operating system.
    fn flush(&mut self) -> Result<(), TraceError> {
        self.with_writer(|writer| writer.flush())
    }

    fn with_writer(
        &mut self,
        write: impl FnOnce(&mut mcap::Writer<W>) -> Result<(), McapError>,
    ) -> Result<(), TraceError> {
        let writer = self
            .writer
            .as_mut()
            .expect("the writer is taken only by into_inner and drop");
        write(writer).map_err(|error| TraceError::unwritten(&self.path, error))
    }

    fn out_of_turn(&self, what: &str) -> TraceError {
        let expected = match &self.turn {
            Expected::Start => "the start".to_owned(),
            Expected::InputOrEnd { step } => {
                format!("the input of step {step}, or the end after {step} steps,")
            }
            Expected::Step { step, input } => format!(
                "step {step} ({}) with the inputs recorded before",
                input.call
            ),
            Expected::Failed => "nothing (writing failed)".to_owned(),
        };
        TraceError::UnexpectedCall {
            path: self.path.clone(),
            record: what.to_owned(),
            expected,
        }
    }
}

impl<W: Write + Seek> Drop for Journal<W> {
    fn drop(&mut self) {
        if let Some(writer) = self.writer.take() {
            drop(writer.into_inner());
        }
    }
}

/// The header's fields for quick listing. The header itself is the first message of `/episode`.
pub(crate) fn header_metadata(header: &EpisodeHeader) -> BTreeMap<String, String> {
    let fields = [
        ("episode_id", header.episode_id.clone()),
        ("run_id", header.run_id.clone()),
        ("task_id", header.task_id.clone()),
        ("family", header.family.to_string()),
        ("scene_id", header.scene_id.clone()),
        ("seed", header.seed.to_string()),
        ("sim_version", header.sim_version.to_string()),
        ("build", header.build.clone()),
        ("profile", header.profile.as_str().to_owned()),
        ("reward_preset", header.reward_preset.clone()),
        ("policy", header.policy.name.clone()),
        ("backend", codec::word(&header.backend)),
    ];
    fields
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

/// Checks that an attachment is the one that the header names.
pub(crate) fn check_attachment(
    path: &Path,
    attachment: &'static str,
    expected: Digest,
    json: &[u8],
) -> Result<(), TraceError> {
    let found = Digest::of(json);
    if found == expected {
        Ok(())
    } else {
        Err(TraceError::Attachment {
            path: path.to_owned(),
            attachment,
            expected,
            found,
        })
    }
}
