//! Preset `real-trainer`: what the published trainer (REAL's gspo branch, its environment and
//! scheduler) pays for an episode, step by step, and where it stops.
//!
//! The registry scores, objects count as their categories, and the texts of the results are read. A
//! step pays, in this order:
//! - an answer without a call: -0.5, and nothing else;
//! - `finish`: +2.0 if no target remains, else -1.0 + completion - 3.0; the episode is done;
//! - any other call: -0.3 if the hand forbids it; -0.5 or -0.3 for the first listed text that
//!   occurs in the result; the reward class (`src/difference_reward.rs`) on the categories of the
//!   graph; its terms for `ask` and `pick`; and -1.0 at the step limit while targets remain.
//!
//! The corners:
//! - The hand counts as occupied after any `pick`, and as empty after any `place`, whose text is
//!   not listed, whatever is held.
//! - Several candidates are seen when, after `walk_around` or `show_object_by_category`,
//!   more than one *name* in the marker map contains the target's category. Runtime names do
//!   so by accident only.
//! - An answer counts if it names a marker: the words are those that reached the policy, not those
//!   of the simulated user. A text that begins with a brace reaches nobody.
//! - A `pick` without a listed text forgets candidates and answers before it is judged, so that
//!   only picks that fail earn `used_marker_from_answer` or cost `blind_pick`.
//! - A graph with an untranslated name, or with over three objects more or fewer than the last one
//!   that was taken, is refused: what changed shows in the next graph that is taken.
//! - The episode is done when no target remains, after `finish`, at the step limit, at
//!   the scheduler's turn limit, and after a call that failed for good. Later steps of
//!   the record pay nothing.
//!
//! # A worked example
//! The task and the calls of the example in `paper.rs`: two apples on `table_1`, one of them goes
//! to `fridge_0`. Which one is nothing to the trainer: `{-apple@table_1, +apple@fridge_0}`, and a
//! match gives 1.5 + 2.0/2 = 2.5.
//!
//! | step | call | terms | sum |
//! |---|---|---|---|
//! | 0 | `nav_to` table_1 | | 0 |
//! | 1 | `walk_around`: marks both | | 0 |
//! | 2 | `ask`: "marker 1" | ask 1.0 | 1.0 |
//! | 3 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 4 | `open` | step_penalty -0.03 | -0.03 |
//! | 5 | `nav_to` table_1 again | step_penalty -0.03 | -0.03 |
//! | 6 | `pick` green | 2.5, pick_correct_object 0.3, step_penalty -0.03 | 2.77 |
//! | 7 | `place` it back on table_1 | wrong_diff -0.5, step_penalty -0.03 | -0.53 |
//! | 8 | `pick` red | step_penalty -0.03 | -0.03 |
//! | 9 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 10 | `place` on an unknown marker | listed_moderate -0.3, step_penalty -0.03 | -0.33 |
//! | 11 | `place` into fridge_0 | 2.5, perfect_match 2.0, step_penalty -0.03 | 4.47 |
//! | 12 | `finish` | | 0 |
//!
//! In all 7.23; done with step 11. The test `worked_example_of_the_trainer` takes these steps.

use crate::{
    difference_reward::{Dialogue, DifferenceReward},
    facts::{
        Change, Delivery, Identity, KindChange, MarkerReferent, StartFacts, StepFacts, StepHead,
        TaskFacts, ToolKind,
    },
    real_repo::named_marker,
    score::{Cause, TermSink},
    terms::Term,
    trainer::{GraphRejection, GraphSize, HandViolation, graph_rejection},
};

/// Why the trainer is done with an episode.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TrainerEnd {
    /// Every target of the task was reached.
    Complete,
    /// The model called `finish`.
    Finished,
    /// The environment's step limit.
    StepLimit,
    /// The scheduler's turn limit.
    TurnLimit,
    /// A call failed for good.
    CallFailed,
}

impl TrainerEnd {
    /// As it stands in reports.
    pub fn as_str(self) -> &'static str {
        match self {
            TrainerEnd::Complete => "complete",
            TrainerEnd::Finished => "finished",
            TrainerEnd::StepLimit => "step_limit",
            TrainerEnd::TurnLimit => "turn_limit",
            TrainerEnd::CallFailed => "call_failed",
        }
    }
}

/// What the trainer holds of an episode after a step.
#[derive(Clone, PartialEq, Debug)]
pub struct TrainerState {
    /// Whether its hand counts as occupied.
    pub hand_occupied: bool,
    /// What the hand forbade in the last call.
    pub hand_violation: Option<HandViolation>,
    /// Why the last graph was refused.
    pub refusal: Option<GraphRejection>,
    /// The share of the targets that was matched.
    pub completion: f64,
    /// Targets that remain: category, receptacle, whether it is an addition.
    pub remaining: Vec<(String, String, bool)>,
    /// The last graph that was taken, as category, receptacle and how many stand there, sorted.
    pub graph: Vec<(String, String, u32)>,
    /// Whether several objects like the target were seen.
    pub ambiguous: bool,
    /// Whether an answer named a marker since.
    pub asked: bool,
    /// The marker that it named.
    pub named_marker: Option<String>,
    /// Why the episode is done.
    pub ending: Option<TrainerEnd>,
}

/// The state of the rules during one episode. The page of this module has the corners
/// and a worked example.
#[derive(Clone, Debug)]
pub(crate) struct RealTrainer {
    reward: DifferenceReward,
    /// Of the last graph that was taken.
    taken: GraphSize,
    /// Of the last graph.
    shown: GraphSize,
    refusal: Option<GraphRejection>,
    /// How the last graph differs from the one that was taken.
    pending: Vec<Change>,
    occupied: bool,
    violation: Option<HandViolation>,
    map: Vec<(u32, MarkerReferent)>,
    dialogue: Dialogue,
    steps: u32,
    ending: Option<TrainerEnd>,
}

impl RealTrainer {
    pub(crate) fn new() -> Self {
        Self {
            reward: DifferenceReward::new(Identity::Category),
            taken: GraphSize::default(),
            shown: GraphSize::default(),
            refusal: None,
            pending: Vec::new(),
            occupied: false,
            violation: None,
            map: Vec::new(),
            dialogue: Dialogue::default(),
            steps: 0,
            ending: None,
        }
    }

    /// Takes in the state before the first decision. How the registry differs from the task shows
    /// in the first graph.
    pub(crate) fn start(&mut self, facts: &TaskFacts, start: &StartFacts) {
        self.reward.start(facts, &[]);
        (self.taken, self.shown) = (facts.initial_size, facts.initial_size);
        (self.refusal, self.violation, self.occupied) = (None, None, false);
        self.pending.clear();
        self.show(facts, start.registry);
        self.map.clear();
        self.dialogue = Dialogue::default();
        (self.steps, self.ending) = (0, None);
    }

    /// The share of the targets that was matched; 1 where there are none.
    pub(crate) fn completion(&self) -> f64 {
        self.reward.completion()
    }

    pub(crate) fn ending(&self) -> Option<TrainerEnd> {
        self.ending
    }

    pub(crate) fn state(&self, facts: &TaskFacts) -> TrainerState {
        let kinds = facts.kinds(Identity::Category);
        let target = |target: KindChange| {
            (
                kinds.name(target.kind).to_owned(),
                facts.place_name(target.place).to_owned(),
                target.add,
            )
        };
        let standing = self.reward.counts().entries();
        let mut graph: Vec<(String, String, u32)> = standing
            .map(|(kind, place, count)| {
                (
                    kinds.name(crate::facts::KindKey(kind)).to_owned(),
                    facts.place_name(place).to_owned(),
                    count,
                )
            })
            .collect();
        graph.sort();
        TrainerState {
            hand_occupied: self.occupied,
            hand_violation: self.violation,
            refusal: self.refusal,
            completion: self.reward.completion_so_far(),
            remaining: self
                .reward
                .remaining_targets(facts)
                .into_iter()
                .map(target)
                .collect(),
            graph,
            ambiguous: self.dialogue.ambiguous,
            asked: self.dialogue.asked,
            named_marker: self
                .dialogue
                .named
                .map(|marker| facts.text_of(marker).to_owned()),
            ending: self.ending,
        }
    }

    /// Pays the terms of the next step; nothing once the episode is done.
    pub(crate) fn step(&mut self, facts: &mut TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        if self.ending.is_some() {
            return;
        }
        self.steps += 1;
        self.violation = None;
        self.show(facts, step.registry);
        if let Some(map) = step.markers {
            self.map.clear();
            self.map.extend_from_slice(map);
        }
        match step.head.delivery {
            Delivery::Unreadable => paid.once(Term::UnreadableAnswer, Cause::None),
            Delivery::TimedOut => {
                paid.once(Term::CallTimeout, Cause::None);
                // as published: the class sees the old graph, and nobody adds up what it pays
                let mut unpaid = Vec::new();
                self.take_graph(
                    facts,
                    &step.head,
                    &mut TermSink::new(paid.preset(), &mut unpaid),
                );
            }
            Delivery::Failed => {
                self.perceive(facts, step.head.named);
                paid.once(Term::CallFailed, Cause::None);
                self.ending = Some(TrainerEnd::CallFailed);
            }
            Delivery::Executed if step.head.named == ToolKind::Finish => self.finish(paid),
            Delivery::Executed => self.call(facts, &step.head, paid),
        }
        if self.ending.is_none() && self.steps >= paid.preset().rules.max_turns {
            paid.once(Term::TurnLimit, Cause::Count(self.steps));
            self.ending = Some(TrainerEnd::TurnLimit);
        }
    }

    fn finish(&mut self, paid: &mut TermSink) {
        if self.reward.remaining() == 0 {
            paid.once(Term::FinishComplete, Cause::None);
        } else {
            let remaining = Cause::Count(self.reward.remaining() as u32);
            paid.once(Term::FinishIncomplete, remaining);
            paid.times(
                Term::FinishCompletion,
                self.reward.completion_so_far(),
                remaining,
            );
            paid.once(Term::PrematureFinish, remaining);
        }
        self.ending = Some(TrainerEnd::Finished);
    }

    fn call(&mut self, facts: &mut TaskFacts, head: &StepHead, paid: &mut TermSink) {
        let error = head.trainer_reading.error;
        self.violation = violation(head.named, self.occupied);
        if let Some(violation) = self.violation {
            paid.once(Term::HandViolation, Cause::Hand(violation));
        }
        if let Some(error) = error {
            let term = if error.is_severe() {
                Term::ListedSevere
            } else {
                Term::ListedModerate
            };
            paid.once(term, Cause::Listed(error));
        }
        match head.named {
            ToolKind::Pick if error.is_none() => {
                self.occupied = true;
                self.dialogue = Dialogue::default();
            }
            ToolKind::Place if error.is_none() => self.occupied = false,
            ToolKind::Ask => {
                if let Some(named) = head
                    .trainer_reading
                    .words
                    .and_then(|words| named_marker(facts, words, &self.map))
                {
                    self.dialogue.asked = true;
                    self.dialogue.named = Some(named);
                }
            }
            called => self.perceive(facts, called),
        }
        self.take_graph(facts, head, paid);
        self.reward.track(facts, head, &self.map, paid);
        self.reward
            .tools(head.named, head.marker, self.dialogue, paid);
        if self.reward.is_complete() {
            self.ending = Some(TrainerEnd::Complete);
        } else if self.steps >= paid.preset().rules.max_steps {
            paid.once(Term::StepLimit, Cause::Count(self.steps));
            self.ending = Some(TrainerEnd::StepLimit);
        }
    }

    /// Follows the graph that the server shows.
    fn show(&mut self, facts: &TaskFacts, changes: &[Change]) {
        for change in changes {
            let (object, add) = match *change {
                Change::Add { object, .. } => (object, true),
                Change::Remove { object, .. } => (object, false),
                Change::Door { .. } => continue,
            };
            let unknown = usize::from(facts.of(object).is_unknown);
            let GraphSize {
                objects,
                unknown: all_unknown,
                ..
            } = &mut self.shown;
            if add {
                (*objects, *all_unknown) = (*objects + 1, *all_unknown + unknown);
            } else {
                (*objects, *all_unknown) = (
                    objects.saturating_sub(1),
                    all_unknown.saturating_sub(unknown),
                );
            }
            self.pending.push(*change);
        }
    }

    /// Hands the class the shown graph, or the one that it has if that is refused.
    fn take_graph(&mut self, facts: &mut TaskFacts, head: &StepHead, paid: &mut TermSink) {
        self.refusal = graph_rejection(&self.taken, &self.shown);
        let held = head
            .held
            .map(|held| facts.held_kind(Identity::Category, held));
        if self.refusal.is_some() {
            return self.reward.step(facts, &[], held, &self.map, paid);
        }
        self.taken = self.shown;
        self.reward
            .step(facts, &self.pending, held, &self.map, paid);
        self.pending.clear();
    }

    /// Looks whether the marker map holds several names with the target's category.
    fn perceive(&mut self, facts: &mut TaskFacts, called: ToolKind) {
        if !matches!(
            called,
            ToolKind::WalkAround | ToolKind::ShowObjectByCategory
        ) {
            return;
        }
        if self
            .map
            .iter()
            .filter(|(_, marked)| facts.mentions(*marked).target_category)
            .count()
            > 1
        {
            self.dialogue.see_several();
        }
    }
}

fn violation(called: ToolKind, occupied: bool) -> Option<HandViolation> {
    match called {
        ToolKind::Pick if occupied => Some(HandViolation::Pick),
        ToolKind::Place if !occupied => Some(HandViolation::Place),
        ToolKind::Open if occupied => Some(HandViolation::Open),
        ToolKind::Close if occupied => Some(HandViolation::Close),
        _ => None,
    }
}
