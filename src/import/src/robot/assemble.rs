//! What was said, in the order of time, as episodes: which calls belong together, what came
//! of each, what was measured and shown meanwhile, and the records that follow. Knows
//! neither files nor encodings.

use std::path::Path;

use reel_reward::{Preset, metrics, open_reward, rewards};
use reel_trace::{
    Timing,
    robot::{Alignment, Odometry, PrimitiveOutcome, RobotLog, VlaLatency},
};
use reel_world::{
    Digest, ErrorCode, FrameDigests, Outcome, Scene, Task, Tool, ToolCall, ToolSpec, WorldGraph,
    record::{
        Backend, EndReason, EndRecord, EpisodeHeader, PolicyInfo, PolicyOutput, RobotState,
        StartRecord, StepInput, StepRecord, UserReply, UserSource,
    },
};
use serde_json::json;

use super::{
    align::{MapAlignment, RobotMap},
    event::{CallEvent, EpisodeEvent, Event, EventPayload, ResultEvent, SensorEvent},
    mapping::{Kind, Mapping},
    sensors::SensorSource,
    trajectory::{INTERVAL_M, TrajectoryError},
};
use crate::{
    ImportOptions, ObservedState, episode, observe,
    observe::CallObservation,
    outcome, same_graph_for_both,
    task::{self, ObservedWorld, TaskSetup},
};

/// Where an image stands: file, and number of its message.
pub(crate) type ImageLocation = [u64; 2];

/// What a step without a result says.
const NO_RESULT: &str = "no result of this call was recorded";

/// Puts what was said, which is in the order of time, together to episodes.
pub(crate) fn episodes(
    events: Vec<Event>,
    mapping: &Mapping,
    sources: &[SensorSource],
) -> Vec<EpisodeBuilder> {
    let bare = !mapping.has(Kind::Call);
    let mut played: Vec<EpisodeBuilder> = Vec::new();
    let mut open: Option<EpisodeBuilder> = None;
    let mut between: Vec<Event> = Vec::new();
    // A map is often told once for all that follows.
    let mut map: Option<RobotMap> = None;
    let mut latched: Vec<(u64, SensorEvent)> = Vec::new();
    for event in events {
        if let EventPayload::Map(told) = &event.payload {
            map = Some(told.clone());
        }
        let begins = match &event.payload {
            EventPayload::Begin(_) => true,
            EventPayload::Call(_) => open.as_ref().is_none_or(|playing| playing.finished),
            EventPayload::Primitive(_) => bare && open.is_none(),
            _ => false,
        };
        if begins {
            played.extend(open.take());
            let mut playing = EpisodeBuilder::after(std::mem::take(&mut between), bare);
            playing.map.clone_from(&map);
            playing.sensors.splice(0..0, latched.iter().copied());
            open = Some(playing);
        }
        if let EventPayload::Sensor(kept) = event.payload
            && sources[kept.source].is_latched
        {
            latched.push((event.ns, kept));
            if let Some(playing) = &mut open {
                playing.sensors.push((event.ns, kept));
            }
            continue;
        }
        match (&mut open, event) {
            (
                Some(playing),
                Event {
                    payload: EventPayload::End(told),
                    ..
                },
            ) => {
                playing.ended = Some(told);
                played.extend(open.take());
            }
            // A `finish` came before.
            (
                None,
                Event {
                    payload: EventPayload::End(told),
                    ..
                },
            ) => {
                if let Some(last) = played.last_mut() {
                    last.ended.get_or_insert(told);
                }
            }
            (Some(playing), event) => playing.take(event),
            (None, event) => between.push(event),
        }
    }
    played.extend(open);
    match played.last_mut() {
        // What is measured after the end is of the last episode; where the robot stands then, and
        // what it sees, is not.
        Some(last) => between
            .into_iter()
            .filter(Event::is_of_skills)
            .for_each(|event| last.take(event)),
        None if between.iter().any(Event::is_of_skills) => {
            played.push(EpisodeBuilder::after(between, bare))
        }
        None => {}
    }
    played
}

impl Event {
    fn is_of_skills(&self) -> bool {
        matches!(
            self.payload,
            EventPayload::Primitive(_) | EventPayload::Vla(_) | EventPayload::Alignment(_)
        )
    }
}

/// An episode in the making.
#[derive(Default)]
pub(crate) struct EpisodeBuilder {
    /// Whether primitives are the decisions.
    bare: bool,
    told: EpisodeEvent,
    ended: Option<Box<EpisodeEvent>>,
    /// Whether `finish` was called.
    finished: bool,
    state: ObservedState,
    /// The last graph before the first call, else the first of all.
    first: Option<WorldGraph>,
    pose: Option<Odometry>,
    path_m: f64,
    /// Before the first call.
    start: PoseSample,
    /// What the policy said last, of which no call came yet.
    policy: Option<PolicyOutput>,
    /// The last image, and when it was taken.
    image: Option<(u64, ImageLocation)>,
    steps: Vec<Step>,
    log: RobotLog,
    /// What the trace keeps as it came, and when it was recorded.
    sensors: Vec<(u64, SensorEvent)>,
    /// Where the robot has receptacles in its map, as it was told last.
    map: Option<RobotMap>,
    /// When the last result came.
    answered_ns: u64,
    /// Results that no call waits for, and the like: what, and when.
    lost: Vec<(u64, String)>,
}

/// Where the robot was, and what it saw.
#[derive(Clone, Default)]
struct PoseSample {
    pose: Option<Odometry>,
    path_m: f64,
    image: Option<ImageLocation>,
}

struct Step {
    call: ToolCall,
    id: Option<String>,
    policy: Option<PolicyOutput>,
    /// The skill that was executed, where that is all there is.
    skill: Option<&'static str>,
    called_ns: Option<u64>,
    answer: Option<(u64, ResultEvent)>,
    reply: Option<UserReply>,
    state: ObservedState,
    moment: PoseSample,
}

/// An episode ready to be recorded.
pub(crate) struct AssembledEpisode {
    pub header: EpisodeHeader,
    pub task: Task,
    pub scene: Scene,
    pub start: StartRecord,
    pub start_image: Option<ImageLocation>,
    pub steps: Vec<(StepRecord, Option<Timing>, Option<ImageLocation>)>,
    pub log: RobotLog,
    /// What the trace keeps as it came, and when it was recorded, in the order of time.
    pub sensors: Vec<(u64, SensorEvent)>,
    /// When the episode began, in nanoseconds since 1970.
    pub began_ns: u64,
    pub end: EndRecord,
    /// What the recording leaves open, and how it was decided.
    pub notes: Vec<String>,
}

impl EpisodeBuilder {
    /// Opens an episode before which something was said: of where the robot was
    /// only the last counts. Of trials the first begins before it is told.
    fn after(between: Vec<Event>, bare: bool) -> Self {
        let mut playing = Self {
            bare,
            ..Self::default()
        };
        let last = between
            .iter()
            .rposition(|event| matches!(event.payload, EventPayload::Odometry(_)));
        for (index, event) in between.into_iter().enumerate() {
            let counts = match event.payload {
                EventPayload::Odometry(_) => Some(index) == last,
                EventPayload::Sensor(_) => bare,
                _ => true,
            };
            if counts {
                playing.take(event);
            }
        }
        playing
    }

    /// The images that its trace shall hold.
    pub(crate) fn images(&self) -> impl Iterator<Item = ImageLocation> {
        self.steps
            .iter()
            .map(|step| &step.moment)
            .chain([&self.start])
            .filter_map(|moment| moment.image)
    }

    /// The messages that its trace keeps as they came.
    pub(crate) fn sensors(&self) -> impl Iterator<Item = SensorEvent> {
        self.sensors.iter().map(|(_, kept)| *kept)
    }

    /// When its first call was made; where there is none, when the first of its sensors spoke.
    fn began_ns(&self) -> u64 {
        let called = self.steps.first().and_then(|step| step.called_ns);
        let sensed = || self.sensors.first().map(|(ns, _)| *ns);
        called.or_else(sensed).unwrap_or_default()
    }

    /// Compares odometry and reference, where the recording has both.
    fn trajectory_error(
        &self,
        mapping: &Mapping,
        notes: &mut Vec<String>,
    ) -> Option<TrajectoryError> {
        let reference: Vec<Odometry> = self
            .sensors
            .iter()
            .filter_map(|(_, kept)| kept.reference)
            .collect();
        if reference.is_empty() || self.log.odometry.is_empty() {
            return None;
        }
        let interval_m = mapping.rpe_interval_m.unwrap_or(INTERVAL_M);
        let error = TrajectoryError::of(&self.log.odometry, &reference, interval_m);
        notes.push(error.as_ref().map_or_else(
            || "odometry and reference have no two poses at the same time".to_owned(),
            TrajectoryError::note,
        ));
        error
    }

    /// What was said and belongs to nothing: when, and what.
    pub(crate) fn lost(&mut self) -> Vec<(u64, String)> {
        std::mem::take(&mut self.lost)
    }

    fn now(&self) -> Option<u32> {
        u32::try_from(self.steps.len())
            .expect("an episode has few steps")
            .checked_sub(1)
    }

    fn take(&mut self, event: Event) {
        let (ns, step) = (event.ns, self.now());
        match event.payload {
            EventPayload::Begin(told) => self.told = *told,
            EventPayload::End(told) => self.ended = Some(told),
            EventPayload::Call(called) => self.call(ns, called),
            EventPayload::Result(answered) => self.answer(ns, answered),
            EventPayload::Primitive(outcome) if self.bare => self.skill(outcome),
            EventPayload::Primitive(outcome) => self
                .log
                .primitives
                .push(PrimitiveOutcome { step, ..outcome }),
            EventPayload::Odometry(measured) => self.drive(Odometry { step, ..measured }),
            EventPayload::Vla(measured) => self.log.vla.push(VlaLatency { step, ..measured }),
            EventPayload::Alignment(measured) => {
                self.log.alignments.push(Alignment { step, ..measured })
            }
            EventPayload::Map(map) => self.map = Some(map),
            EventPayload::Image(place) => self.see(ns, place),
            EventPayload::Sensor(kept) => self.sensors.push((ns, kept)),
            EventPayload::Shows(shown) => {
                self.state = self.state.after(&shown);
                if self.steps.is_empty() || self.first.is_none() {
                    self.first = self.state.graph.clone();
                }
                if let Some(step) = self.steps.last_mut() {
                    step.state = self.state.clone();
                }
            }
            EventPayload::Reply(reply) => match self.steps.last_mut() {
                Some(step) => step.reply = Some(reply),
                None => self
                    .lost
                    .push((ns, "an answer of the user that nobody asked for".to_owned())),
            },
            EventPayload::Policy(output) => self.policy = Some(output),
        }
    }

    fn call(&mut self, ns: u64, called: CallEvent) {
        if self.steps.is_empty() {
            self.start = PoseSample {
                pose: self.pose,
                path_m: self.path_m,
                image: self.image.map(|(_, place)| place),
            };
        }
        self.finished |= is_tool(&called.call, "finish");
        let mut policy = self.policy.take();
        if let Some(raw) = called.raw {
            let policy = policy.get_or_insert_default();
            policy.raw = if policy.raw.is_empty() {
                raw
            } else {
                std::mem::take(&mut policy.raw)
            };
        }
        self.steps.push(Step {
            call: called.call,
            id: called.id,
            policy,
            skill: None,
            called_ns: Some(ns),
            answer: None,
            reply: None,
            state: self.state.clone(),
            moment: PoseSample {
                pose: self.pose,
                path_m: self.path_m,
                image: None,
            },
        });
    }

    /// To the call of its id, else to the last one.
    fn answer(&mut self, ns: u64, answered: ResultEvent) {
        let by_id = |step: &Step| answered.id.is_some() && step.id == answered.id;
        let named = self.steps.iter().rposition(by_id);
        let last = self
            .steps
            .len()
            .checked_sub(1)
            .filter(|last| answered.id.is_none() || self.steps[*last].id.is_none());
        match named
            .or(last)
            .map(|index| &mut self.steps[index])
            .filter(|step| step.answer.is_none())
        {
            Some(step) => {
                step.answer = Some((ns, answered));
                self.answered_ns = ns;
            }
            None => self
                .lost
                .push((ns, "a result that no call waits for".to_owned())),
        }
    }

    /// A skill that was executed without a call is a step of its own, from its beginning on.
    fn skill(&mut self, outcome: PrimitiveOutcome) {
        let ended = outcome.unix_ns;
        let begun = outcome
            .duration_ns
            .map(|took| ended.saturating_sub(took).max(self.answered_ns));
        let since = begun.unwrap_or(self.answered_ns);
        let image = self
            .image
            .filter(|(taken, _)| *taken >= since)
            .map(|(_, place)| place);
        if self.steps.is_empty() {
            let before = self
                .image
                .filter(|(taken, _)| *taken < since)
                .map(|(_, place)| place);
            let pose = self
                .log
                .odometry
                .iter()
                .rev()
                .find(|it| it.unix_ns < since)
                .copied();
            self.start = PoseSample {
                pose,
                path_m: 0.0,
                image: before,
            };
        } else if let Some(last) = self
            .steps
            .last_mut()
            .filter(|last| last.moment.image == image)
        {
            last.moment.image = None;
        }
        let spec = ToolSpec::by_name(&outcome.skill);
        let argument = spec
            .and_then(|spec| spec.argument)
            .map(|argument| argument.name)
            .filter(|name| *name == "receptacle_name");
        let arguments = match outcome.target.as_str() {
            "" => json!({}),
            target => json!({ argument.unwrap_or("target"): target }),
        };
        let answered = ResultEvent {
            text: outcome.error.clone().unwrap_or_default(),
            error: None,
            success: Some(outcome.success),
            id: None,
        };
        self.steps.push(Step {
            call: ToolCall::new(outcome.skill.clone(), arguments),
            id: None,
            policy: self.policy.take(),
            skill: spec.map(|spec| spec.paper_name),
            called_ns: begun,
            answer: Some((ended, answered)),
            reply: None,
            state: self.state.clone(),
            moment: PoseSample {
                pose: self.pose,
                path_m: self.path_m,
                image,
            },
        });
        self.answered_ns = ended;
        let step = self.now();
        let log = &mut self.log;
        log.primitives.push(PrimitiveOutcome { step, ..outcome });
        log.odometry
            .iter_mut()
            .rev()
            .take_while(|it| it.unix_ns >= since)
            .for_each(|it| it.step = step);
        log.vla
            .iter_mut()
            .rev()
            .take_while(|it| it.unix_ns >= since)
            .for_each(|it| it.step = step);
        log.alignments
            .iter_mut()
            .rev()
            .take_while(|it| it.unix_ns >= since)
            .for_each(|it| it.step = step);
    }

    fn drive(&mut self, measured: Odometry) {
        if let Some(before) = self.pose {
            self.path_m += (measured.x - before.x).hypot(measured.y - before.y);
        }
        self.pose = Some(measured);
        self.log.odometry.push(measured);
        if let Some(step) = self.steps.last_mut().filter(|step| step.answer.is_none()) {
            (step.moment.pose, step.moment.path_m) = (self.pose, self.path_m);
        }
    }

    /// The image of a step is the last one up to its result, else the first one after it.
    fn see(&mut self, ns: u64, place: ImageLocation) {
        self.image = Some((ns, place));
        if let Some(step) = self
            .steps
            .last_mut()
            .filter(|step| step.answer.is_none() || step.moment.image.is_none())
        {
            step.moment.image = Some(place);
        }
    }

    /// Makes the records. `frame` tells the digests of an image, if there is one at a place.
    pub(crate) fn finish(
        mut self,
        mapping: &Mapping,
        options: &ImportOptions<'_>,
        (path, lost): (&Path, &[&str]),
        frame: &dyn Fn(ImageLocation) -> Option<FrameDigests>,
    ) -> AssembledEpisode {
        let mut notes = Vec::new();
        let (
            TaskSetup {
                task,
                scene,
                mut settings,
            },
            known,
        ) = self.setting(options, path, &mut notes);
        if let Some(error) = self.trajectory_error(mapping, &mut notes) {
            settings.insert("trajectory_error".to_owned(), error.settings());
        }
        if !lost.is_empty() {
            settings.insert("losses".to_owned(), json!(lost));
        }
        let began_ns = self.began_ns();
        if let Some(map) = self.map.take() {
            match MapAlignment::of(&map, &scene) {
                Some(alignment) => {
                    self.align(&alignment);
                    notes.push(alignment.note());
                    settings.insert("map_alignment".to_owned(), alignment.settings());
                }
                None => notes.push(
                    "the robot's map and the scene have no two receptacles in common; poses stay in the robot's frame"
                        .to_owned(),
                ),
            }
        }
        let reason = self.reason(&mut notes);
        let ended = self.ended.as_deref();
        let told_success = ended.and_then(|told| told.success);

        let initial = self
            .first
            .clone()
            .or_else(|| known.then(|| task.initial.clone()));
        let mut before = ObservedState {
            graph: initial.clone(),
            ..ObservedState::default()
        };
        let start_place = self.start.image;
        let mut start = StartRecord {
            graphs: initial
                .as_ref()
                .map(same_graph_for_both)
                .unwrap_or_default(),
            robot: robot(&mut before, &self.start),
            shortest_path_m: self
                .told
                .shortest_path_m
                .or_else(|| ended.and_then(|told| told.shortest_path_m)),
            ..StartRecord::default()
        };
        start.digests.frame = start_place.and_then(frame);
        let mut steps = Vec::new();
        for (number, step) in (0..).zip(self.steps) {
            let mut after = ObservedState {
                graph: step.state.graph.clone().or_else(|| before.graph.clone()),
                ..step.state.clone()
            };
            let robot = robot(&mut after, &step.moment);
            let timing = step.timing();
            let image = step.moment.image;
            let skill = step.skill;
            let shown = step.shown(image.and_then(frame));
            let mut record = observe::record(number, shown, &before, &after);
            record.robot = robot;
            record.tool = record.tool.or(skill.map(str::to_owned));
            steps.push((record, timing, image));
            before = after;
        }

        let preset = Preset::default();
        let mut records: Vec<StepRecord> =
            steps.iter().map(|(record, ..)| record.clone()).collect();
        let terms = rewards(&preset, &task, &scene, &start, &records);
        for (record, terms) in records.iter_mut().zip(terms) {
            record.reward = terms;
        }
        let open = open_reward(&preset, options.tasks, &task, &scene, &start, &records);
        notes.extend(open.map(|open| open.to_string()));
        let policy = self
            .told
            .policy
            .or_else(|| ended.and_then(|told| told.policy.clone()))
            .or_else(|| mapping.policy.clone());
        let mut header = EpisodeHeader {
            run_id: options.run_id.to_owned(),
            reward_preset: preset.name().to_owned(),
            policy: PolicyInfo {
                name: policy.unwrap_or_else(|| "unknown".to_owned()),
                checkpoint: None,
                parameters: settings,
            },
            backend: Backend::Robot,
            ..observe::header(&task, &scene)
        };
        // Many trials of a skill have equal records; what was measured and when tells them apart.
        let times: Vec<&Option<Timing>> = steps.iter().map(|(_, timing, _)| timing).collect();
        header.episode_id = Digest::of_json(&(&header, &start, &records, times, &self.log))
            .to_string()[..16]
            .to_owned();
        header.build = env!("CARGO_PKG_VERSION").to_owned();
        let link = episode::link(&header, &mut start, &mut records);

        let graphs = before
            .graph
            .as_ref()
            .map(same_graph_for_both)
            .unwrap_or_default();
        let judged = match told_success {
            // Nothing shows how the world was left: the word of the recording counts.
            Some(success) if self.first.is_none() || !known => {
                notes.push(format!(
                    "success is what the recording says ({success}); no graph and goal tell it"
                ));
                same_graph_for_both(if success { &task.goal } else { &task.initial })
            }
            Some(_) => graphs.clone(),
            None => {
                if self.first.is_none() || !known {
                    notes.push(
                        "the recording does not say whether the episode succeeded; it counts as a failure"
                            .to_owned(),
                    );
                }
                graphs.clone()
            }
        };
        let metrics = metrics(&preset, &task, &start, &records, &judged);
        if told_success.is_some_and(|told| told != metrics.success) {
            notes.push(format!(
                "the recording says success {}, the graphs {}",
                !metrics.success, metrics.success
            ));
        }
        let end = EndRecord {
            reason,
            graphs,
            metrics,
            chain: link,
            steps: records.len() as u32,
        };
        let steps = records
            .into_iter()
            .zip(steps)
            .map(|(record, (_, timing, image))| (record, timing, image))
            .collect();
        AssembledEpisode {
            header,
            task,
            scene,
            start,
            start_image: start_place,
            steps,
            log: self.log,
            sensors: self.sensors,
            began_ns,
            end,
            notes,
        }
    }

    /// Brings every pose into the frame of the scene.
    fn align(&mut self, alignment: &MapAlignment) {
        let steps = self.steps.iter_mut().map(|step| &mut step.moment.pose);
        let poses = steps.chain([&mut self.start.pose]).flatten();
        for pose in poses.chain(&mut self.log.odometry) {
            *pose = alignment.pose(*pose);
        }
    }

    /// Its task: of the files given, else of its messages, else none; and whether it is known.
    fn setting(
        &self,
        options: &ImportOptions<'_>,
        path: &Path,
        notes: &mut Vec<String>,
    ) -> (TaskSetup, bool) {
        let mut meta = self.told.meta.clone();
        for (key, value) in self.ended.iter().flat_map(|told| &told.meta) {
            meta.entry(key).or_insert_with(|| value.clone());
        }
        let mut seen = ObservedWorld {
            first: self.first.clone(),
            ..ObservedWorld::default()
        };
        for graph in self.first.iter().chain(
            self.steps
                .iter()
                .filter_map(|step| step.state.graph.as_ref()),
        ) {
            seen.take_in(graph);
        }
        // A single task that was given is that of episodes that name none.
        if let (None, [task]) = (task::text(&meta, "benchmark_task_id"), options.tasks) {
            meta.insert("benchmark_task_id".to_owned(), task.task_id.clone().into());
        }
        let mut told = task::TaskSource {
            meta: &meta,
            folders: [None, None],
            path,
            notes: Vec::new(),
        };
        let setting = task::setting(&mut told, &seen, options);
        notes.append(&mut told.notes);
        match setting {
            Ok(setting) => (setting, true),
            Err(_) => {
                notes.push("the task is not known; give its task file with --tasks".to_owned());
                (
                    task::unknown(&told, self.first.clone().unwrap_or_default()),
                    false,
                )
            }
        }
    }

    /// Why it ended: as its message says, else as its calls do.
    fn reason(&self, notes: &mut Vec<String>) -> EndReason {
        let told = self.ended.as_deref();
        let word = told
            .and_then(|told| told.reason.as_deref())
            .map(str::to_lowercase);
        match word.as_deref() {
            Some("finished" | "finish" | "done" | "success" | "succeeded" | "completed") => {
                EndReason::Finished
            }
            Some("horizon" | "max_steps" | "max_steps_reached" | "timeout") => EndReason::Horizon,
            Some("fault" | "error" | "inference_error" | "action_error") => EndReason::Fault,
            Some("aborted" | "abort" | "stopped" | "interrupted" | "cancelled") => {
                EndReason::Aborted
            }
            _ if self.finished => EndReason::Finished,
            Some(other) => {
                notes.push(format!(
                    "the reason of the end is '{other}'; taken as broken off"
                ));
                EndReason::Aborted
            }
            // Somebody looked at how it went.
            None if told.is_some_and(|told| told.success.is_some()) => EndReason::Finished,
            None => {
                notes.push(
                    "nothing says how the episode ended; it is taken as broken off".to_owned(),
                );
                EndReason::Aborted
            }
        }
    }
}

impl Step {
    fn timing(&self) -> Option<Timing> {
        let (called, (answered, _)) = (self.called_ns?, self.answer.as_ref()?);
        Some(Timing {
            called_unix_ns: called,
            took_ns: answered.saturating_sub(called),
        })
    }

    fn shown(self, frame: Option<FrameDigests>) -> CallObservation {
        let tool = Tool::parse(&self.call).ok();
        let outcome = self.outcome(tool.as_ref());
        let asks = is_tool(&self.call, "ask");
        // An answer of which nobody says from whom it is came from a person: this is no simulation.
        let of_result = || {
            outcome::reply(tool.as_ref(), &outcome).map(|reply| UserReply {
                source: UserSource::Human,
                ..reply
            })
        };
        let reply = self.reply.filter(|_| asks).or_else(of_result);
        let input = StepInput {
            policy: self.policy,
            user_reply: reply.clone(),
            ..StepInput::from_call(self.call)
        };
        CallObservation {
            input,
            tool,
            outcome,
            reply,
            frame,
        }
    }

    /// What the call came to. An error code of Reel's is taken, and so are the published server's
    /// words; else what moves the robot failed by its skill.
    fn outcome(&self, tool: Option<&Tool>) -> Outcome {
        let Some((_, answer)) = &self.answer else {
            return match &self.reply {
                Some(reply) if is_tool(&self.call, "ask") => Outcome::ok(reply.text.clone()),
                _ if is_tool(&self.call, "finish") => Outcome::ok(""),
                _ => Outcome::error(ErrorCode::BackendError, NO_RESULT),
            };
        };
        let tool = tool.map(Tool::paper_name).or(self.skill);
        let told = || {
            ErrorCode::from_message(&answer.text).filter(|_| tool.is_some_and(|tool| tool != "ask"))
        };
        let failed = answer.error.is_some() || answer.success == Some(false);
        if !failed {
            let error = if answer.success.is_none() {
                told()
            } else {
                None
            };
            return Outcome {
                text: answer.text.clone(),
                error,
            };
        }
        let named = answer.error.as_deref().unwrap_or_default();
        let moves = matches!(
            tool,
            Some("nav_to" | "walk_around" | "gaze_at" | "pick" | "place" | "open" | "close")
        );
        let otherwise = if moves || self.skill.is_some() {
            ErrorCode::SkillFailed
        } else {
            ErrorCode::BackendError
        };
        let code =
            ErrorCode::parse(named).or_else(|| told().or_else(|| ErrorCode::from_message(named)));
        let text = [answer.text.as_str(), named, "the call failed"]
            .into_iter()
            .find(|text| !text.is_empty());
        Outcome::error(code.unwrap_or(otherwise), text.unwrap_or_default())
    }
}

/// The robot at a moment; the state learns its position.
fn robot(state: &mut ObservedState, moment: &PoseSample) -> RobotState {
    state.position = moment.pose.map(|pose| [pose.x as f32, pose.y as f32, 0.0]);
    let yaw = moment.pose.map_or(0.0, |pose| pose.yaw as f32);
    RobotState {
        yaw,
        path_length_m: moment.path_m as f32,
        ..state.robot()
    }
}

fn is_tool(call: &ToolCall, name: &str) -> bool {
    ToolSpec::by_name(&call.name).is_some_and(|spec| spec.paper_name == name)
}
