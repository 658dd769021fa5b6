//! The policy that plays a perturbation: competent play, and operators that intervene. It notes
//! when each operator intervened first. Never what comes of it.

use std::{collections::VecDeque, sync::Arc};

use rand_chacha::ChaCha8Rng;
use reel_episode::Privileged;
use reel_world::{
    ErrorCode, ReceptacleId, Scene, Task, Tool, ToolCall,
    record::{Marker, PolicyInfo, StepInput},
};
use serde::{Deserialize, Serialize};

use super::{
    Base, Operator, OperatorFamily, OperatorKind, Perturbation, Reading, look_alike,
    script::{self, Scripted, resolve},
    words::{Claim, Words},
};
use crate::{
    GoalHint, Oracle, Planner, Policy, PolicyContext, ResponderError, mistaken_task, policy, random,
};

/// Decisions within which an operator with a free choice begins.
const BEGINS_WITHIN: f64 = 12.0;
/// Beliefs that may change before a call comes of it.
const TURNS_MAX: usize = 8;

/// What an operator did in an episode.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct OperatorEvent {
    /// Its place in the perturbation.
    pub operator: usize,
    /// The first call that it changed; none where it never came to that.
    pub onset: Option<u32>,
}

/// Competent play with operators that intervene.
#[derive(Debug)]
pub struct Perturbed {
    task: Arc<Task>,
    perturbation: Perturbation,
    states: Vec<OperatorState>,
    truthful: Competent,
    /// The operator whose belief is followed.
    believed: Option<usize>,
    queue: VecDeque<(usize, Scripted)>,
    showed: bool,
    words: Words,
    visited: Vec<ReceptacleId>,
    old: Vec<Marker>,
    current: Vec<Marker>,
    asked: bool,
    /// The operator that made each call.
    made_by: Vec<Option<usize>>,
}

#[derive(Debug)]
enum Competent {
    Planner(Box<Planner>),
    Oracle(Box<Oracle>, Option<ToolCall>),
}

#[derive(Debug)]
struct OperatorState {
    operator: Operator,
    rng: ChaCha8Rng,
    fired: bool,
    /// The competent play of who believes what the operator makes one believe.
    belief: Option<Box<Planner>>,
    reading: Option<Reading>,
    onset: Option<u32>,
    /// From this call on it counts failures, and finishes after so many.
    patience: Option<u32>,
    deceptions: u32,
}

/// What an operator makes of the moment.
enum Intervention {
    None,
    /// The belief changed: ask again.
    Again,
    Call(ToolCall),
}

impl Perturbed {
    /// The policy for an episode of this task.
    pub fn new(task: &Arc<Task>, scene: &Scene, perturbation: &Perturbation) -> Self {
        let planner = || Box::new(Planner::new(GoalHint::of_task(task), perturbation.seed));
        let states = perturbation.operators.iter().map(|operator| {
            let mut rng = random::stream(operator.seed, operator.kind.name(), 0);
            let (belief, reading) = belief(operator.kind, task, scene, &mut rng);
            OperatorState {
                operator: *operator,
                rng,
                fired: false,
                belief,
                reading,
                onset: None,
                patience: None,
                deceptions: 0,
            }
        });
        Self {
            task: task.clone(),
            states: states.collect(),
            truthful: match perturbation.base {
                Base::Planner => Competent::Planner(planner()),
                Base::Oracle => {
                    Competent::Oracle(Box::new(Oracle::new(task.clone(), perturbation.seed)), None)
                }
            },
            believed: None,
            queue: VecDeque::new(),
            showed: false,
            words: Words::new(perturbation.style),
            visited: Vec::new(),
            old: Vec::new(),
            current: Vec::new(),
            asked: false,
            made_by: Vec::new(),
            perturbation: perturbation.clone(),
        }
    }

    /// What the operators did, in their order.
    pub fn events(&self) -> Vec<OperatorEvent> {
        let event = |(operator, state): (usize, &OperatorState)| OperatorEvent {
            operator,
            onset: state.onset,
        };
        self.states.iter().enumerate().map(event).collect()
    }

    /// How a failure by this operator alone reads in the taxonomy.
    pub fn reading(&self, operator: usize) -> Reading {
        let state = &self.states[operator];
        state
            .reading
            .unwrap_or_else(|| state.operator.kind.reading())
    }

    /// The perturbation that this policy plays.
    pub fn perturbation(&self) -> &Perturbation {
        &self.perturbation
    }

    /// The operator that made each call, where one did.
    pub fn made_by(&self) -> &[Option<usize>] {
        &self.made_by
    }

    fn advice(&mut self, context: &PolicyContext<'_>) -> (ToolCall, Option<usize>) {
        if let Some(index) = self.believed
            && let Some(belief) = &mut self.states[index].belief
        {
            let call = belief.advice(context).to_call();
            let differs = match &mut self.truthful {
                Competent::Planner(planner) => planner.advice(context).to_call() != call,
                Competent::Oracle(..) => true,
            };
            return (call, differs.then_some(index));
        }
        let call = match &mut self.truthful {
            Competent::Planner(planner) => planner.advice(context).to_call(),
            Competent::Oracle(oracle, next) => next
                .get_or_insert_with(|| oracle.next_tool(context).to_call())
                .clone(),
        };
        (call, None)
    }

    /// Makes whoever is followed believe that it made this call and that it went well.
    fn deceive(&mut self, context: &PolicyContext<'_>, call: &ToolCall) {
        let input = StepInput::from_call(call.clone());
        match (
            self.believed
                .and_then(|index| self.states[index].belief.as_mut()),
            &mut self.truthful,
        ) {
            (Some(belief), _) => belief.observe(context, &input),
            (None, Competent::Planner(planner)) => planner.observe(context, &input),
            (None, Competent::Oracle(..)) => {}
        }
    }

    fn decide(
        &mut self,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
    ) -> (ToolCall, Option<usize>) {
        for index in 0..self.states.len() {
            if let Some(call) = self.gives_up(index, context) {
                return (call, Some(index));
            }
        }
        while let Some((index, scripted)) = self.queue.front().cloned() {
            let rng = &mut self.states[index].rng;
            if let Some((call, stays)) = resolve(&scripted, truth, &self.old, self.showed, rng) {
                self.showed = stays;
                if !stays {
                    self.queue.pop_front();
                }
                return (call, Some(index));
            }
            self.showed = false;
            self.queue.pop_front();
            if scripted == Scripted::Believe {
                self.believed = Some(index);
            }
        }
        for _ in 0..TURNS_MAX {
            let (proposed, by) = self.advice(context);
            let mut again = false;
            for index in 0..self.states.len() {
                if !self.states[index].operator.enabled {
                    continue;
                }
                match self.intervene(index, &proposed, context, truth) {
                    Intervention::None => {}
                    Intervention::Again => {
                        again = true;
                        break;
                    }
                    Intervention::Call(call) => return (call, Some(index)),
                }
            }
            if !again {
                return (proposed, by);
            }
        }
        (
            Tool::Finish.to_call(),
            self.believed
                .or_else(|| self.states.iter().position(|state| state.fired)),
        )
    }

    /// Who tried in vain often enough finishes.
    fn gives_up(&mut self, index: usize, context: &PolicyContext<'_>) -> Option<ToolCall> {
        let state = &mut self.states[index];
        let kind = state.operator.kind;
        let counts = match kind.family() {
            OperatorFamily::Skill => context.observation.error == Some(ErrorCode::SkillFailed),
            _ => state.fired && context.observation.error.is_some(),
        };
        if !state.operator.enabled || !counts {
            return None;
        }
        if kind.family() == OperatorFamily::Skill {
            state.onset.get_or_insert(context.step.saturating_sub(1));
        }
        let left = state.patience.as_mut()?;
        *left = left.saturating_sub(1);
        (*left == 0).then(|| Tool::Finish.to_call())
    }

    fn intervene(
        &mut self,
        index: usize,
        proposed: &ToolCall,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
    ) -> Intervention {
        let tool = Tool::parse(proposed).ok();
        let state = &mut self.states[index];
        let Operator {
            kind,
            position,
            strength,
            ..
        } = state.operator;
        let held = truth.held.is_some();
        let due = f64::from(context.step) >= position * BEGINS_WITHIN;
        let early = position < 0.5;
        let tool = tool.as_ref();
        let is_pick = matches!(tool, Some(Tool::Pick { .. }));
        let is_place = matches!(tool, Some(Tool::Place { .. }));
        let is_open = matches!(tool, Some(Tool::Open { .. }));
        let is_ask = matches!(tool, Some(Tool::Ask { .. }));
        let is_finish = matches!(tool, Some(Tool::Finish) | None);
        // a door may be passed over more than once, everything else once
        let again =
            matches!(kind, OperatorKind::SkipOpen) && is_open && state.deceptions < strength.min(3);
        if state.fired && !again {
            return Intervention::None;
        }
        let begins = match kind {
            OperatorKind::SkipAsk | OperatorKind::AskBesides => is_ask,
            OperatorKind::IgnoreReply | OperatorKind::ForgetReply => self.asked && !is_ask && !held,
            OperatorKind::SkipPick | OperatorKind::ClaimsPicked => is_pick,
            OperatorKind::SkipPlace | OperatorKind::ClaimsPlaced => is_place,
            OperatorKind::SkipOpen => is_open,
            OperatorKind::SkipClose => matches!(tool, Some(Tool::Close { .. })),
            OperatorKind::SkipSearch => !held && context.step < 4 && (due || context.step > 1),
            OperatorKind::SkipRest => held && (due || is_place),
            OperatorKind::SameCategory
            | OperatorKind::OtherCategory
            | OperatorKind::AnyObjectThere => {
                !held && (early || is_pick || matches!(tool, Some(Tool::GazeAt { .. })))
            }
            OperatorKind::SimilarReceptacle
            | OperatorKind::UnrelatedReceptacle
            | OperatorKind::NearReceptacle => early || held,
            OperatorKind::BackOnSource | OperatorKind::UndoSuccess | OperatorKind::NeverFinish => {
                match kind {
                    OperatorKind::BackOnSource => held,
                    _ => is_finish,
                }
            }
            OperatorKind::StaleNumber | OperatorKind::RandomNumber => is_pick,
            OperatorKind::DoorAgain => due && !held && !is_finish,
            OperatorKind::FinishSoon => match random::below(&mut state.rng, 3) {
                0 => is_pick || is_place,
                _ => is_place || is_open,
            },
            OperatorKind::FlakySkills | OperatorKind::SkillsAndNoRetry => true,
            OperatorKind::EarlyFinish => due,
            _ => due && !is_finish,
        };
        if !begins {
            return Intervention::None;
        }
        state.fired = true;
        let finish = script::call(&Tool::Finish);
        let dest = look_alike::destination(&self.task).clone();
        match kind {
            OperatorKind::FlakySkills => {
                state.patience = Some(1 + strength % 3);
                Intervention::None
            }
            OperatorKind::SkillsAndNoRetry => {
                state.patience = Some(1);
                Intervention::None
            }
            OperatorKind::SkipAsk
            | OperatorKind::IgnoreReply
            | OperatorKind::SameCategory
            | OperatorKind::OtherCategory
            | OperatorKind::AnyObjectThere
            | OperatorKind::SimilarReceptacle
            | OperatorKind::UnrelatedReceptacle
            | OperatorKind::NearReceptacle
            | OperatorKind::BackOnSource => {
                if state.belief.is_none() {
                    return Intervention::None;
                }
                self.believed = Some(index);
                Intervention::Again
            }
            OperatorKind::AskBesides | OperatorKind::ForgetReply => {
                if state.belief.is_none() {
                    return Intervention::None;
                }
                let questions = [
                    "Is it all right if I start?",
                    "What time is it?",
                    "Which room do you like best?",
                ];
                let question = questions[random::below(&mut state.rng, 3)].to_owned();
                let mut first = Scripted::Call(Tool::Ask { question }.to_call());
                if kind == OperatorKind::ForgetReply {
                    let places: Vec<_> = look_alike::usable(truth.scene)
                        .map(|one| one.id.clone())
                        .collect();
                    let place = random::choose(&mut state.rng, &places)
                        .cloned()
                        .unwrap_or(dest);
                    first = script::nav(&place);
                }
                self.queue
                    .extend([(index, first), (index, Scripted::Believe)]);
                self.next_scripted(truth)
            }
            OperatorKind::SkipPick
            | OperatorKind::SkipOpen
            | OperatorKind::SkipPlace
            | OperatorKind::SkipClose => {
                state.deceptions += 1;
                state.onset.get_or_insert(context.step);
                state.patience = Some(1 + strength % 4);
                self.deceive(context, proposed);
                Intervention::Again
            }
            OperatorKind::ClaimsPlaced | OperatorKind::ClaimsPicked => {
                let number = random::below(&mut state.rng, 6);
                state.onset.get_or_insert(context.step);
                state.patience = Some(1 + strength % 4);
                let placed = kind == OperatorKind::ClaimsPlaced;
                let claim = if placed { Claim::Placed } else { Claim::Picked };
                self.words
                    .claim(claim, &self.task.target_object().category.clone(), number);
                if placed && early {
                    return Intervention::Call(Tool::Finish.to_call());
                }
                self.deceive(context, proposed);
                Intervention::Again
            }
            OperatorKind::IdleClaims | OperatorKind::Intentions => {
                let number = random::below(&mut state.rng, 6);
                let claim = if kind == OperatorKind::IdleClaims {
                    Claim::Idle
                } else {
                    Claim::Intention
                };
                self.words
                    .claim(claim, &self.task.target_object().category.clone(), number);
                Intervention::None
            }
            OperatorKind::SkipSearch => {
                let mut calls = vec![script::nav(&dest)];
                if early {
                    calls.push(Scripted::PlaceOn(dest));
                }
                calls.push(finish);
                self.queue.extend(calls.into_iter().map(|one| (index, one)));
                self.next_scripted(truth)
            }
            OperatorKind::SkipRest => {
                if !early {
                    self.queue.push_back((index, script::nav(&dest)));
                }
                self.queue.push_back((index, finish));
                self.next_scripted(truth)
            }
            OperatorKind::EarlyFinish | OperatorKind::FinishSoon => {
                Intervention::Call(Tool::Finish.to_call())
            }
            OperatorKind::UndoSuccess => {
                let places: Vec<_> = look_alike::usable(truth.scene)
                    .map(|one| one.id.clone())
                    .filter(|id| *id != dest)
                    .collect();
                let category = self.task.target_object().category.clone();
                let mut calls = vec![
                    script::call(&Tool::ShowObjectByCategory { category }),
                    Scripted::PickObject(self.task.target.clone()),
                ];
                if let Some(place) = random::choose(&mut state.rng, &places).filter(|_| early) {
                    calls.extend([script::nav(place), Scripted::PlaceOn(place.clone())]);
                }
                calls.push(finish);
                self.queue.extend(calls.into_iter().map(|one| (index, one)));
                self.next_scripted(truth)
            }
            OperatorKind::StaleNumber | OperatorKind::RandomNumber => {
                state.patience = Some(1 + strength % 4);
                let mut calls = match kind {
                    OperatorKind::StaleNumber => vec![Scripted::PickOld; 1 + strength as usize % 5],
                    _ => {
                        let count = 1 + strength as usize % 5;
                        let pick = |rng: &mut ChaCha8Rng| Tool::Pick {
                            marker: 1 + random::below(rng, 30) as u32,
                        };
                        (0..count)
                            .map(|_| script::call(&pick(&mut state.rng)))
                            .collect()
                    }
                };
                // half of them correct themselves
                if early {
                    state.patience = None;
                } else {
                    calls.extend([script::nav(&dest), Scripted::PlaceOn(dest), finish]);
                }
                self.queue.extend(calls.into_iter().map(|one| (index, one)));
                self.next_scripted(truth)
            }
            _ => {
                let length = strength as usize;
                let mut calls = script::series(kind, length, truth, &self.visited, &mut state.rng);
                let gives_up = kind != OperatorKind::NeverFinish
                    && length > 2
                    && random::below(&mut state.rng, 4) == 0;
                if gives_up && !calls.is_empty() {
                    calls.push(finish);
                }
                self.queue.extend(calls.into_iter().map(|one| (index, one)));
                self.next_scripted(truth)
            }
        }
    }

    /// The first call of the script that has just been written.
    fn next_scripted(&mut self, truth: &Privileged<'_>) -> Intervention {
        while let Some((index, scripted)) = self.queue.front().cloned() {
            if scripted == Scripted::Believe {
                self.queue.pop_front();
                self.believed = Some(index);
                return Intervention::Again;
            }
            let rng = &mut self.states[index].rng;
            if let Some((call, stays)) = resolve(&scripted, truth, &self.old, self.showed, rng) {
                self.showed = stays;
                if !stays {
                    self.queue.pop_front();
                }
                return Intervention::Call(call);
            }
            self.queue.pop_front();
        }
        Intervention::None
    }

    fn note(&mut self, context: &PolicyContext<'_>, call: &ToolCall, by: Option<usize>) {
        if let Some(index) = by {
            self.states[index].onset.get_or_insert(context.step);
        }
        self.made_by.push(by);
        let input = StepInput::from_call(call.clone());
        for belief in self
            .states
            .iter_mut()
            .filter_map(|state| state.belief.as_mut())
        {
            belief.observe(context, &input);
        }
        match &mut self.truthful {
            Competent::Planner(planner) => planner.observe(context, &input),
            Competent::Oracle(oracle, next) => {
                let own = next.take().is_some_and(|next| next == *call);
                if !own {
                    oracle.observe(context, &input);
                }
            }
        }
        match Tool::parse(call) {
            Ok(Tool::NavTo { receptacle }) if !self.visited.contains(&receptacle) => {
                self.visited.push(receptacle);
            }
            Ok(Tool::Ask { .. }) => self.asked = true,
            _ => {}
        }
    }
}

/// What an operator makes one believe, if it does: the competent play of who believes it, and how a
/// failure by it reads.
fn belief(
    kind: OperatorKind,
    task: &Arc<Task>,
    scene: &Scene,
    rng: &mut ChaCha8Rng,
) -> (Option<Box<Planner>>, Option<Reading>) {
    let planner = |task: &Task| Box::new(Planner::new(GoalHint::of_task(task), 0));
    match kind.family() {
        OperatorFamily::Object | OperatorFamily::Dialogue => {
            let Some(object) = look_alike::object(kind, task, rng) else {
                return (None, None);
            };
            let mut believed = mistaken_task(task, Some(object), None);
            believed.fuzzy = false;
            let reading = (kind.family() == OperatorFamily::Object)
                .then(|| look_alike::look_alike(task, object));
            (Some(planner(&believed)), reading)
        }
        OperatorFamily::Receptacle => {
            let Some(place) = look_alike::receptacle(kind, task, scene, rng) else {
                return (None, None);
            };
            let mut believed = mistaken_task(task, None, Some(&place));
            believed.dest_distractors.clear();
            let reading = (kind == OperatorKind::NearReceptacle)
                .then(|| look_alike::misplacement(task, scene, &place));
            (Some(planner(&believed)), reading)
        }
        _ => (None, None),
    }
}

impl Policy for Perturbed {
    fn info(&self) -> PolicyInfo {
        policy::info("perturbed", self.perturbation.seed)
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let Some(truth) = context.truth else {
            return Ok(StepInput::from_call(Tool::Finish.to_call()));
        };
        if truth.markers != self.current.as_slice() && !self.current.is_empty() {
            self.old = std::mem::take(&mut self.current);
        }
        self.current = truth.markers.to_vec();
        let (call, by) = self.decide(context, truth);
        self.note(context, &call, by);
        let output = self.words.narrate(&call, context.observation);
        Ok(StepInput {
            policy: output,
            ..StepInput::from_call(call)
        })
    }
}
