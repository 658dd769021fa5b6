//! What each message adds to the records, and the order that messages must keep.

use mcap::records::MessageHeader;
use prost::Message;
use reel_world::{
    Digest,
    record::{PolicyOutput, StartRecord},
};

use super::{
    Assembly,
    draft::{Draft, Unlinked},
};
use crate::{
    Timing, TraceError,
    chain::{self, Covered},
    codec, image,
    journal::header_metadata,
    mcp_answer,
    robot::{Alignment, CameraImage, PrimitiveOutcome, VlaLatency},
    schema::{
        self,
        foxglove::CompressedImage,
        reel::{self, episode_event::Event},
    },
};

/// A refusal of one message: what is wrong with it, or an error that says so itself.
pub(super) enum Refusal {
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

impl Assembly<'_> {
    pub(super) fn message(
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
        if self.unlinked.is_some() && channel != schema::CHAIN {
            return Err("the link of what is before it is missing".into());
        }
        self.chain.cover(channel, data);
        match channel {
            schema::EPISODE => match decode::<reel::EpisodeEvent>(data)?
                .event
                .ok_or("it holds no event")?
            {
                Event::Start(start) => self.episode_start(start),
                Event::Settled(_) if self.start.is_some() => Err("it was already said".into()),
                Event::Settled(settled) => once(&mut self.settled, settled),
                Event::End(end) => self.episode_end(end),
            },
            schema::WORLD_GRAPH => self.world_graph(decode(data)?),
            schema::TOOL_CALL => self.tool_call(offset, decode(data)?),
            schema::POLICY_OUTPUT => {
                let message: reel::PolicyOutput = decode(data)?;
                self.old_fields |= message.latency_ns.is_some();
                let draft = self.draft(message.step)?;
                once(&mut draft.policy, codec::read_policy_output(message))
            }
            schema::LOGPROBS => {
                let message: reel::TokenLogprobs = decode(data)?;
                let policy = self.policy(message.step)?;
                once(&mut policy.logprobs, codec::read_logprobs(message)?)
            }
            schema::POLICY_LATENCY => {
                let message: reel::PolicyLatency = decode(data)?;
                let policy = self.policy(message.step)?;
                once(&mut policy.latency_ns, message.latency_ns)
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
            schema::MCP_ANSWER if self.records_only.is_some() => Ok(()),
            schema::MCP_ANSWER => {
                let message: reel::McpAnswer = decode(data)?;
                self.expect_moment(message.step)?;
                let request = mcp_answer::request(&message).ok_or_else(|| {
                    format!("{:?} is not a method with an answer", message.method)
                })?;
                match self.mcp_answers.insert(request, message.json) {
                    None => Ok(()),
                    Some(_) => Err("it was already said".into()),
                }
            }
            schema::REDACTED => {
                let message: reel::Redacted = decode(data)?;
                self.expect_moment(message.step)?;
                match self.redactions.insert(message.step, message.count) {
                    None => Ok(()),
                    Some(_) => Err("it was already said".into()),
                }
            }
            schema::REPORTED => {
                let said = codec::read_reported(decode(data)?);
                once(&mut self.reported, said)
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
            schema::SIM_DIGEST => self.moment(decode(data)?),
            schema::CHAIN => self.link(&decode(data)?),
            // Derived for viewers; a recorder writes them, nobody reads them back.
            _ => Ok(()),
        }
    }

    fn episode_start(&mut self, message: reel::EpisodeStart) -> Result<(), Refusal> {
        let mut header = codec::read_header(message)?;
        let listed = self
            .metadata
            .as_ref()
            .ok_or("there is no metadata record of the header")?;
        match listed.get("build") {
            Some(build) if header.build.is_empty() => header.build.clone_from(build),
            _ => self.old_fields = true,
        }
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

    /// The last record of a moment. Its link follows, or stands in it where the trace is an old one.
    fn moment(&mut self, message: reel::SimDigest) -> Result<(), Refusal> {
        let link = message.chain.clone();
        let moment = codec::read_sim_digest(message)?;
        let unlinked = match moment.step {
            None => {
                let (true, Some(settled), Some(graphs)) = (
                    self.header.is_some(),
                    self.settled.take(),
                    self.start_graphs.take(),
                ) else {
                    return Err(
                        "header, settled state or graphs of the start are missing before it".into(),
                    );
                };
                if self.start.is_some() {
                    return Err("it was already said".into());
                }
                Unlinked::Start(Box::new(StartRecord {
                    graphs,
                    bodies: moment.bodies,
                    robot: moment.robot,
                    visible: codec::read_visible(settled.visible)?,
                    shortest_path_m: settled.shortest_path_m,
                    digests: moment.digests,
                }))
            }
            Some(step) => {
                self.draft(step)?;
                let draft = self.draft.take().ok_or("its call is missing")?;
                Unlinked::Step {
                    offset: draft.offset,
                    record: Box::new(draft.into_record(step, moment)?),
                }
            }
        };
        if link.is_empty() {
            self.unlinked = Some(unlinked);
            return Ok(());
        }
        self.old_link(&unlinked, codec::digest(&link)?)?;
        self.accept(unlinked);
        Ok(())
    }

    /// The link of a moment, or of the end. Without it they are not believed; what is before it stays
    /// readable.
    fn link(&mut self, message: &reel::ChainLink) -> Result<(), Refusal> {
        let Some(unlinked) = self.unlinked.take() else {
            return Err("what it links is missing before it".into());
        };
        let (expected, found) = (self.chain.link(), codec::digest(&message.link)?);
        self.check_link(&unlinked, expected, found)?;
        if self.covered != Covered::Messages {
            return Err("the links before it are in /sim/digest".into());
        }
        if self.old_fields {
            return Err(
                "before it is a version of Reel or a latency where old traces alone have it".into(),
            );
        }
        self.links.push(found);
        self.accept(unlinked);
        Ok(())
    }

    /// The link of a moment as old traces have it: over records.
    fn old_link(&mut self, unlinked: &Unlinked, found: Digest) -> Result<(), Refusal> {
        let expected = match (unlinked, self.links.last(), &self.header) {
            (Unlinked::Start(start), None, Some(header)) => {
                chain::records::start_link(header, start)
            }
            (Unlinked::Step { record, .. }, Some(before), _) => {
                chain::records::step_link(before, record)
            }
            (Unlinked::End(_), Some(last), _) => *last,
            _ => return Err("it has no link before it".into()),
        };
        self.check_link(unlinked, expected, found)?;
        if self.links.is_empty() {
            self.covered = Covered::Records;
        }
        if self.covered != Covered::Records {
            return Err("the links before it are in /chain".into());
        }
        if !matches!(unlinked, Unlinked::End(_)) {
            self.links.push(found);
        }
        Ok(())
    }

    fn check_link(
        &self,
        unlinked: &Unlinked,
        expected: Digest,
        found: Digest,
    ) -> Result<(), Refusal> {
        if expected == found {
            return Ok(());
        }
        let step = match unlinked {
            Unlinked::Start(_) => None,
            Unlinked::Step { record, .. } => Some(record.step),
            Unlinked::End(_) => self.step_count().checked_sub(1),
        };
        Err(Refusal::Error(TraceError::ChainBroken {
            path: self.path.to_owned(),
            step,
            expected,
            found,
        }))
    }

    /// Takes what is linked, and the images of its moment.
    fn accept(&mut self, linked: Unlinked) {
        let at = match linked {
            Unlinked::Start(start) => {
                self.start = Some(*start);
                None
            }
            Unlinked::Step { record, offset } => {
                let at = Some(record.step);
                self.steps.push(*record);
                self.offsets.push(offset);
                at
            }
            Unlinked::End(end) => {
                self.end = Some(*end);
                return;
            }
        };
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
    }

    fn episode_end(&mut self, message: reel::EpisodeEnd) -> Result<(), Refusal> {
        if self.draft.is_some() {
            return Err("a step before it is not whole".into());
        }
        let graphs = self
            .end_graphs
            .clone()
            .ok_or("the graphs of the end are missing before it")?;
        let link = message.chain.clone();
        let reported = self.reported.take().unwrap_or_default();
        let end = codec::read_end(message, graphs, reported)?;
        if end.steps != self.step_count() {
            return Err(format!(
                "it speaks of {} steps, but there are {}",
                end.steps,
                self.step_count()
            )
            .into());
        }
        let unlinked = Unlinked::End(Box::new(end));
        if link.is_empty() {
            self.unlinked = Some(unlinked);
            return Ok(());
        }
        self.old_link(&unlinked, codec::digest(&link)?)?;
        self.accept(unlinked);
        Ok(())
    }

    /// What a robot measured belongs to the step in the making, or stands before the start.
    fn expect_moment(&mut self, step: Option<u32>) -> Result<(), Refusal> {
        match step {
            Some(step) => self.draft(step).map(drop),
            None if self.start.is_none() => Ok(()),
            None => Err("it belongs to no step, but stands behind the start".into()),
        }
    }

    /// What came with the call of the step in the making, for a message that adds to it.
    fn policy(&mut self, step: u32) -> Result<&mut PolicyOutput, Refusal> {
        let policy = self.draft(step)?.policy.as_mut();
        policy.ok_or_else(|| "the policy output of its step is missing before it".into())
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
