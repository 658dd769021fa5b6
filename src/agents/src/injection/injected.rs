//! The policy that acts an injection out: it goes through a course, and notes when a fault begins
//! and when it is corrected. Never tells the trace what is wrong with it.

use std::{collections::VecDeque, sync::Arc};

use crate::plan::Intent;
use rand_chacha::ChaCha8Rng;
use reel_episode::Privileged;
use reel_world::{
    InstanceId, ReceptacleId, Scene, Task, Tool, ToolCall,
    record::{Marker, MarkerTarget, PolicyInfo, StepInput},
};

use super::{
    FaultLabel, Injection, InjectionError, Label, Primary, choices,
    plan::{FaultTrigger, InjectionPlan},
    scripted_call::{MarkerMemory, PlanSegment, ScriptedCall, Until},
    voice::NarrationStyle,
};
use crate::{Oracle, Policy, PolicyContext, ResponderError, faults::mistaken_task, policy, random};

/// Legs and deeds that may be passed over between two calls; a course has far fewer.
const PASSES_MAX: usize = 200;
/// Agents that look for what the instruction names rather than for what they take for
/// it, in a hundred.
const BY_INSTRUCTION: usize = 60;
const NAME: &str = "injected";

/// An agent in which something goes wrong, as an [`Injection`] says.
#[derive(Debug)]
pub struct Injected {
    task: Arc<Task>,
    injection: Injection,
    legs: VecDeque<PlanSegment>,
    watches: Vec<FaultTrigger>,
    rng: ChaCha8Rng,
    voice: NarrationStyle,
    /// Who acts in the leg at hand, where that is the oracle.
    oracle: Option<Oracle>,
    /// Actions of the leg at hand that were done or passed over, and whether any was done.
    done: usize,
    thought: Option<String>,
    asked: bool,
    follows_published_plan: bool,
    /// It looks for what the instruction names even where it takes something else for it.
    by_instruction: bool,
    memory: MarkerMemory,
    /// The fault that begins with the next call.
    beginning: Option<usize>,
    marks: Vec<FaultProgress>,
    /// What it takes for the target since it took it by an old number, and what it ever took so.
    adopted: Option<InstanceId>,
    taken: Option<InstanceId>,
    /// At its last decision: what it held, and where the target was.
    held: Option<InstanceId>,
    target_at: Option<ReceptacleId>,
    gave_up: Option<String>,
}

/// What came of a fault so far.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
struct FaultProgress {
    began: Option<u32>,
    repaired: bool,
}

impl Injected {
    /// An agent for a task.
    ///
    /// # Errors
    /// When the task does not admit the injection.
    pub fn new(
        task: &Arc<Task>,
        scene: &Scene,
        injection: &Injection,
    ) -> Result<Self, InjectionError> {
        let InjectionPlan { legs, watches } = InjectionPlan::new(task, scene, injection)?;
        let mut rng = random::stream(injection.seed, "injected", 0);
        Ok(Self {
            task: task.clone(),
            injection: injection.clone(),
            legs: legs.into(),
            watches,
            voice: NarrationStyle::new(random::below(&mut rng, 3)),
            follows_published_plan: random::below(&mut rng, 2) == 0,
            by_instruction: random::below(&mut rng, 100) < BY_INSTRUCTION,
            rng,
            oracle: None,
            done: 0,
            thought: None,
            asked: false,
            memory: MarkerMemory::default(),
            beginning: None,
            marks: vec![FaultProgress::default(); injection.faults.len()],
            adopted: None,
            taken: None,
            held: None,
            target_at: None,
            gave_up: None,
        })
    }

    /// What came of the injection; to be asked after the episode, of which `success` says whether
    /// it reached its goal.
    pub fn label(&self, episode_id: &str, success: bool) -> Label {
        let faults: Vec<FaultLabel> = (0..self.marks.len())
            .map(|index| self.fault_label(index))
            .collect();
        Label {
            episode_id: episode_id.to_owned(),
            task_id: self.task.task_id.clone(),
            seed: self.injection.seed,
            policy: self.info(),
            injection: self.injection.clone(),
            primary: Primary::of(&faults, success),
            faults,
        }
    }

    fn fault_label(&self, index: usize) -> FaultLabel {
        let (kind, mark) = (self.injection.faults[index].kind, &self.marks[index]);
        // to notice it is not yet to repair it: what was taken has to be out of the hand, and the
        // target off the wrong place
        let stands = self.watches.iter().any(|watch| match watch {
            FaultTrigger::Picks(other, object) => {
                *other == index && self.held.as_ref() == Some(object)
            }
            FaultTrigger::PicksOther(other, _) => {
                *other == index && self.held.is_some() && self.held == self.taken
            }
            FaultTrigger::PlacesOn(other, place) => {
                *other == index && self.target_at.as_ref() == Some(place)
            }
        });
        let taken = || self.taken.as_ref().and_then(|id| self.task.object(id));
        let sub_class = kind
            .sub_class()
            .or_else(|| choices::mistake(&self.task, taken()?).sub_class());
        FaultLabel {
            kind,
            class: kind.class(),
            sub_class: sub_class.unwrap_or("wrong_attribute").to_owned(),
            step: mark.began,
            repaired: mark.repaired && !stands,
        }
    }

    fn decide(&mut self, context: &PolicyContext<'_>, truth: &Privileged<'_>) -> ToolCall {
        self.memory.learn(truth.markers);
        for _ in 0..PASSES_MAX {
            let Some(leg) = self.legs.front().cloned() else {
                break;
            };
            match leg {
                PlanSegment::Follow {
                    task,
                    options: habits,
                    until,
                } => {
                    let oracle = self.oracle.get_or_insert_with(|| {
                        let task = match self.adopted.as_ref().and_then(|id| task.object(id)) {
                            Some(taken) => Arc::new(mistaken_task(&task, Some(taken), None)),
                            None => task.clone(),
                        };
                        let oracle = Oracle::faulty(NAME, task, habits, self.injection.seed);
                        if context.step == 0 && self.follows_published_plan {
                            oracle
                        } else {
                            oracle.resumed(self.asked)
                        }
                    });
                    let tool = oracle.next_tool(context);
                    if let Some(reason) = oracle.gave_up() {
                        self.gave_up = Some(reason);
                        return tool.to_call();
                    }
                    let intents = oracle.intents().clone();
                    let name = self.named().map(str::to_owned);
                    self.voice.intend(&intents, name.as_deref());
                    if !is_reached(until, intents.front(), truth, self.asked) {
                        return match (tool, name) {
                            (Tool::ShowObjectByCategory { .. }, Some(name)) => {
                                Tool::ShowObjectByCategory { category: name }
                            }
                            (tool, _) => tool,
                        }
                        .to_call();
                    }
                    self.pass();
                }
                PlanSegment::Do {
                    calls: deeds,
                    times,
                } => match self.next_deed(&deeds, times) {
                    Some(deed) => {
                        if let Some(call) = deed.call(context, truth, &self.memory, &mut self.rng) {
                            return call;
                        }
                    }
                    None => {
                        // What the moment had nothing for did not begin.
                        if !deeds.is_empty() {
                            self.beginning = None;
                        }
                        self.pass();
                    }
                },
                PlanSegment::Begin(index) => {
                    self.beginning = Some(index);
                    self.pass();
                }
                PlanSegment::Repaired(index) => {
                    self.marks[index].repaired = self.marks[index].began.is_some();
                    if self.watches.iter().any(
                        |watch| matches!(watch, FaultTrigger::PicksOther(other, _) if *other == index),
                    ) {
                        self.adopted = None;
                    }
                    self.pass();
                }
                PlanSegment::Claim(claim) => {
                    self.voice.claim(&claim, context.observation);
                    self.pass();
                }
                PlanSegment::Unclaim => {
                    self.voice.unclaim();
                    self.pass();
                }
                PlanSegment::Think(thought) => {
                    self.pass();
                    self.thought = Some(thought);
                }
                PlanSegment::Object(_)
                | PlanSegment::Place(_)
                | PlanSegment::Options(_)
                | PlanSegment::Go(_) => self.pass(),
            }
        }
        Tool::Finish.to_call()
    }

    fn pass(&mut self) {
        self.legs.pop_front();
        self.oracle = None;
        self.done = 0;
    }

    /// The next deed of the leg at hand.
    fn next_deed(&mut self, deeds: &[ScriptedCall], times: Option<usize>) -> Option<ScriptedCall> {
        if times.is_some_and(|times| self.done >= times) || deeds.is_empty() {
            return None;
        }
        let deed = deeds[self.done % deeds.len()].clone();
        self.done += 1;
        Some(deed)
    }

    /// The oracle looks for what a thing is; an agent that was told a category or a purpose
    /// may look for that.
    fn named(&self) -> Option<&str> {
        let told = match &self.task.purpose {
            Some(purpose) if self.task.fuzzy => (!self.asked).then_some(purpose),
            _ => Some(&self.task.target_object().category),
        };
        told.filter(|_| self.by_instruction).map(String::as_str)
    }

    /// Notes what begins with this call.
    fn note(&mut self, call: &ToolCall, context: &PolicyContext<'_>, truth: &Privileged<'_>) {
        if let Some(index) = self.beginning.take() {
            self.marks[index].began.get_or_insert(context.step);
        }
        let Ok(tool) = Tool::parse(call) else { return };
        self.asked |= matches!(tool, Tool::Ask { .. });
        let of_number = |number: u32| {
            truth
                .markers
                .iter()
                .find(|marker| marker.id == number)
                .map(|Marker { target, .. }| target)
        };
        for watch in &self.watches {
            let index = match (watch, &tool) {
                (FaultTrigger::Picks(index, object), Tool::Pick { marker }) => {
                    match of_number(*marker) {
                        Some(MarkerTarget::Object(id)) if id == object => *index,
                        _ => continue,
                    }
                }
                (FaultTrigger::PicksOther(index, object), Tool::Pick { marker }) => {
                    match of_number(*marker) {
                        Some(MarkerTarget::Object(id))
                            if id != object
                                && truth.held.is_none()
                                && !self.marks[*index].repaired =>
                        {
                            self.adopted = Some(id.clone());
                            self.taken = Some(id.clone());
                            *index
                        }
                        _ => continue,
                    }
                }
                (FaultTrigger::PlacesOn(index, receptacle), Tool::Place { marker }) => {
                    match of_number(*marker) {
                        Some(MarkerTarget::Receptacle(id)) if id == receptacle => *index,
                        _ => continue,
                    }
                }
                _ => continue,
            };
            self.marks[index].began.get_or_insert(context.step);
        }
    }
}

impl Policy for Injected {
    fn info(&self) -> PolicyInfo {
        policy::info(NAME, self.injection.seed)
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let Some(truth) = context.truth else {
            return Ok(StepInput::from_call(Tool::Finish.to_call()));
        };
        self.held = truth.held.cloned();
        self.target_at = truth.graph.receptacle_of(&self.task.target).cloned();
        let call = self.decide(context, truth);
        self.note(&call, context, truth);
        let thought = self.thought.take();
        let output = self
            .voice
            .narrate(&call, thought.as_deref(), context.observation);
        Ok(StepInput::with_policy_output(call, output))
    }

    fn gave_up(&self) -> Option<String> {
        self.gave_up.clone()
    }
}

/// Whether the oracle, which has this in mind next, has come so far.
fn is_reached(until: Until, next: Option<&Intent>, truth: &Privileged<'_>, asked: bool) -> bool {
    let holds = truth.held.is_some();
    let reached = match next {
        Some(Intent::Place(_)) if holds => Until::AtDestination,
        Some(Intent::Find { .. }) if !holds => Until::Looking,
        Some(Intent::Pick(_)) if !holds => Until::Found,
        Some(Intent::Finish) | None => Until::Placed,
        _ if holds => Until::Held,
        _ => Until::Start,
    };
    reached >= until || (until == Until::Asked && asked)
}
