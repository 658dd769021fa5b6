//! What was said, in the order of time, as episodes: which calls belong together, what came
//! of each, what was measured and shown meanwhile. Knows neither files nor encodings.

mod records;

use reel_trace::robot::{Alignment, Odometry, PrimitiveOutcome, RobotLog, VlaLatency};
use reel_world::{
    ToolCall, ToolSpec, WorldGraph,
    record::{PolicyOutput, UserReply},
};
use serde_json::json;

pub(crate) use self::records::AssembledEpisode;
use super::{
    align::RobotMap,
    event::{CallEvent, EpisodeEvent, Event, EventPayload, ResultEvent, SensorEvent},
    mapping::{Kind, Mapping},
    sensors::SensorSource,
};
use crate::ObservedState;

/// Where an image stands: file, and number of its message.
pub(crate) type ImageLocation = [u64; 2];

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
}

fn is_tool(call: &ToolCall, name: &str) -> bool {
    ToolSpec::by_name(&call.name).is_some_and(|spec| spec.paper_name == name)
}
