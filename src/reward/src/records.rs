//! Records as facts, and the reasons that people read. The one place of this crate that knows both.

use reel_world::{
    ErrorCode, GraphEvent, Scene, Task,
    record::{Marker, MarkerTarget, RewardTerm, StartRecord, StepRecord},
};

use crate::{
    Rewarder,
    facts::{Authority, Change, EpisodeFacts, Identity, MarkerReferent, StepHead, TaskFacts},
    preset::Preset,
    score::{AppliedTerm, Cause, Scorer},
    terms::{Base, Term},
};

/// A preset that reads records as they come.
#[derive(Debug)]
pub(crate) struct RecordRewarder {
    facts: TaskFacts,
    scorer: Scorer,
    task: Task,
    /// The start, and after it the current step alone.
    moment: EpisodeFacts,
    markers: Vec<Marker>,
    fired: Vec<AppliedTerm>,
}

impl RecordRewarder {
    pub(crate) fn new(preset: &Preset, task: &Task, scene: &Scene) -> Self {
        Self {
            facts: TaskFacts::new(task, scene),
            scorer: Scorer::new(preset),
            task: task.clone(),
            moment: EpisodeFacts::default(),
            markers: Vec::new(),
            fired: Vec::new(),
        }
    }
}

impl Rewarder for RecordRewarder {
    fn start(&mut self, start: &StartRecord) {
        self.facts.begin(&mut self.moment);
        self.markers.clear();
        self.moment.record_start(&mut self.facts, &self.task, start);
        self.scorer.start(&self.facts, &self.moment.start());
    }

    fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm> {
        self.moment.clear();
        self.moment
            .record_step(&mut self.facts, &self.markers, step);
        self.markers.clone_from(&step.markers);
        self.fired.clear();
        for moment in self.moment.steps() {
            self.scorer.step(&mut self.facts, &moment, &mut self.fired);
        }
        let term = |fired: &AppliedTerm| RewardTerm {
            component: fired.term.component().to_owned(),
            value: fired.value,
            reason: self
                .facts
                .reason(self.scorer.preset(), fired, step.outcome.error),
        };
        self.fired.iter().map(term).collect()
    }
}

impl EpisodeFacts {
    /// The facts of a recorded episode, in place of what was here.
    pub fn record(
        &mut self,
        facts: &mut TaskFacts,
        task: &Task,
        start: &StartRecord,
        steps: &[StepRecord],
    ) {
        facts.begin(self);
        self.record_start(facts, task, start);
        let mut markers: &[Marker] = &[];
        for step in steps {
            self.record_step(facts, markers, step);
            markers = &step.markers;
        }
    }

    fn record_start(&mut self, facts: &mut TaskFacts, task: &Task, start: &StartRecord) {
        self.record_changes(
            facts,
            Authority::Physics,
            &start.graphs.physics.difference(&task.initial),
        );
        self.record_changes(
            facts,
            Authority::Registry,
            &start.graphs.registry.difference(&task.initial),
        );
        for seen in &start.visible {
            self.push_visible(facts.object(seen.object.as_str()));
        }
    }

    fn record_step(&mut self, facts: &mut TaskFacts, markers_before: &[Marker], step: &StepRecord) {
        self.step(head(facts, step));
        self.record_changes(facts, Authority::Physics, &step.changes.physics);
        self.record_changes(facts, Authority::Registry, &step.changes.registry);
        for object in step
            .visible
            .iter()
            .map(|seen| &seen.object)
            .chain(&step.listed)
        {
            self.push_visible(facts.object(object.as_str()));
        }
        if step.markers != markers_before {
            self.set_markers();
            for marker in &step.markers {
                let target = match &marker.target {
                    MarkerTarget::Object(object) => {
                        MarkerReferent::Object(facts.object(object.as_str()))
                    }
                    MarkerTarget::Receptacle(receptacle) => {
                        MarkerReferent::Receptacle(facts.receptacle(receptacle.as_str()))
                    }
                };
                self.mark(marker.id, target);
            }
        }
    }

    fn record_changes(
        &mut self,
        facts: &mut TaskFacts,
        authority: Authority,
        events: &[GraphEvent],
    ) {
        for event in events {
            self.change(authority, facts.event(event));
        }
    }
}

impl TaskFacts {
    /// Why a term of a preset paid, for people: which event or rule. The code of the step's error
    /// is for the terms of errors.
    pub fn reason(&self, preset: &Preset, fired: &AppliedTerm, error: Option<ErrorCode>) -> String {
        let identity = if preset.base() == Base::RealTrainer {
            Identity::Category
        } else {
            Identity::Asset
        };
        let kinds = self.kinds(identity);
        let what = match fired.cause {
            Cause::None => String::new(),
            Cause::Change(change) => self.change_text(change),
            Cause::Kind(change) => {
                let sign = if change.add { '+' } else { '-' };
                format!(
                    "{sign}{}@{}",
                    kinds.name(change.kind),
                    self.place_name(change.place)
                )
            }
            Cause::Visited(place) | Cause::Opened(place) => self.place_name(place).to_owned(),
            Cause::Object(object) => self.object_name(object).to_owned(),
            Cause::Held(kind) => kinds.name(kind).to_owned(),
            Cause::Count(count) => count.to_string(),
            Cause::Text(text) => self.text_of(text).to_owned(),
            Cause::Hand(violation) => violation.as_str().to_owned(),
            Cause::Listed(error) => error.pattern().to_owned(),
        };
        match (fired.term, fired.cause) {
            (Term::Matched, Cause::Visited(_)) => format!("first visit of {what}"),
            (Term::Matched, Cause::Opened(_)) => format!("opened {what}"),
            (Term::Matched, _) => format!("goal change {what}"),
            (Term::AllHold, _) => "all goal changes hold".to_owned(),
            (Term::Progress | Term::ProgressShaping, _) => "progress".to_owned(),
            (Term::Reversed, _) => format!("reversed: {what}"),
            (Term::WrongReceptacle, _) => format!("wrong receptacle: {what}"),
            (Term::ValidPick, _) => format!("valid pick of {what}"),
            (Term::InTransit, _) => format!("{what} in transit"),
            (Term::Recovery, _) => format!("recovery: {what} was put back"),
            (Term::Ask, _) => format!("asked among {what} candidates"),
            (Term::Time, _) => format!("decision {what}"),
            (Term::Severe | Term::Moderate, _) => {
                let class = if fired.term == Term::Severe {
                    "severe"
                } else {
                    "moderate"
                };
                error.map_or_else(
                    || format!("{class} error"),
                    |code| format!("{class} error {code}"),
                )
            }
            (Term::DiffMatch, _) => format!("target {what}"),
            (Term::NeutralDiff, _) => format!("no target: {what}"),
            (Term::WrongDiff, _) => format!("reverse of a target: {what}"),
            (Term::PlaceWrongFurniture, _) => format!("wrong place: {what}"),
            (Term::PerfectMatch, _) => "no target remains".to_owned(),
            (Term::StepPenalty, _) => format!("step {what}"),
            (Term::PickCorrectObject, _) => format!("{what} is held"),
            (Term::PartialMove, _) => format!("{what} is on its way"),
            (Term::ReplanRecoverPick, _) => format!("{what} was returned"),
            (Term::TargetFirstDiscovered, _) => format!("{what} has a marker"),
            (Term::FirstVisitTargetFurniture, _) => format!("first drive to {what}"),
            (Term::NavRevisitWindow, _) => format!("drove to {what} before"),
            (Term::RepeatedPerception, _) => "the same markers again".to_owned(),
            (Term::RepeatedGaze, _) => "the same marker again".to_owned(),
            (Term::PrematureFinish, _) => format!("{what} targets remain"),
            (Term::AskTool | Term::AskWhenAmbiguous, _) => format!("question {what}"),
            (Term::UsedMarkerFromAnswer, _) => format!("the answer named marker {what}"),
            (Term::BlindPick, _) => "several were seen and nobody was asked".to_owned(),
            (Term::HandViolation, _) => what,
            (Term::ListedSevere | Term::ListedModerate, _) => format!("the answer says '{what}'"),
            (Term::FinishComplete, _) => "finished with no target left".to_owned(),
            (Term::FinishIncomplete | Term::FinishCompletion, _) => {
                format!("finished while {what} targets remain")
            }
            (Term::UnreadableAnswer, _) => "the model's answer holds no call".to_owned(),
            (Term::CallTimeout, _) => "the call took too long".to_owned(),
            (Term::CallFailed, _) => "the call failed for good".to_owned(),
            (Term::StepLimit, _) => format!("step limit after {what} steps"),
            (Term::TurnLimit, _) => format!("turn limit after {what} steps"),
        }
    }

    fn change_text(&self, change: Change) -> String {
        match change {
            Change::Remove { object, place } => {
                format!("-{}@{}", self.object_name(object), self.place_name(place))
            }
            Change::Add { object, place } => {
                format!("+{}@{}", self.object_name(object), self.place_name(place))
            }
            Change::Door { place, from, to } => {
                format!("{}.door: {from} -> {to}", self.place_name(place))
            }
        }
    }
}

fn head(facts: &mut TaskFacts, step: &StepRecord) -> StepHead {
    let error = step.outcome.error.map(ErrorCode::as_str);
    let called = facts.head_of_call(
        step.tool_name(),
        error,
        step.input.call.argument().as_deref(),
    );
    StepHead {
        trainer_reading: facts.trainer_reading(&called, &step.outcome.text),
        error: step.outcome.error.map(ErrorCode::class),
        object: step
            .object
            .as_ref()
            .map(|object| facts.object(object.as_str())),
        receptacle: step
            .receptacle
            .as_ref()
            .map(|receptacle| facts.receptacle(receptacle.as_str())),
        held: step
            .held
            .as_ref()
            .map(|object| facts.object(object.as_str())),
        reply: step.reply.as_ref().map(|reply| facts.text(&reply.text)),
        ..called
    }
}
