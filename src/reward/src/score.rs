//! From facts to rewards: the engine that runs a preset over an episode, and what it paid. Never
//! reads a record or a word.

use crate::{
    facts::{
        Change, EpisodeFacts, KindChange, KindKey, ObjectKey, ReceptacleKey, StartFacts, StepFacts,
        TaskFacts, TextKey,
    },
    metrics::discounted_return,
    paper::Paper,
    preset::Preset,
    real_repo::RealRepo,
    real_trainer::{RealTrainer, TrainerEnd, TrainerState},
    terms::{Base, Term},
    trainer::{HandViolation, TextError},
};

/// Runs a preset over episodes of any task, one after the other. Give each step once, in order.
#[derive(Clone, Debug)]
pub struct Scorer {
    preset: Preset,
    rules: Box<State>,
}

/// The state of the rules of one base.
#[derive(Clone, Debug)]
enum State {
    Paper(Paper),
    RealRepo(RealRepo),
    RealTrainer(RealTrainer),
}

/// One term that a step paid.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct AppliedTerm {
    /// Term of the preset that paid in this step.
    pub term: Term,
    /// What it paid; never zero.
    pub value: f64,
    /// Why the term paid, from which [`TaskFacts::reason`] makes its text.
    pub(crate) cause: Cause,
}

/// Why a term paid.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Cause {
    None,
    Change(Change),
    Kind(KindChange),
    Visited(ReceptacleKey),
    Opened(ReceptacleKey),
    Object(ObjectKey),
    Held(KindKey),
    Count(u32),
    Text(TextKey),
    Hand(HandViolation),
    Listed(TextError),
}

/// The rewards of one episode. A buffer for [`Scorer::score`].
#[derive(Clone, PartialEq, Debug, Default)]
pub struct EpisodeReward {
    fired: Vec<AppliedTerm>,
    /// Where each step ends in `fired`.
    ends: Vec<usize>,
    totals: Vec<f64>,
    total: f64,
    discounted_return: f64,
    ending: Option<(u32, TrainerEnd)>,
}

/// Where the terms of a step go.
#[derive(Debug)]
pub(crate) struct TermSink<'a> {
    preset: &'a Preset,
    terms: &'a mut Vec<AppliedTerm>,
    /// Where this step begins.
    from: usize,
}

impl Scorer {
    /// An engine for a preset.
    pub fn new(preset: &Preset) -> Self {
        let rules = match preset.base() {
            Base::Paper => State::Paper(Paper::default()),
            Base::RealRepo => State::RealRepo(RealRepo::new()),
            Base::RealTrainer => State::RealTrainer(RealTrainer::new()),
        };
        Self {
            preset: preset.clone(),
            rules: Box::new(rules),
        }
    }

    /// The reward preset by which this scorer scores episodes.
    pub fn preset(&self) -> &Preset {
        &self.preset
    }

    /// Takes in the state before the first decision of another episode.
    pub fn start(&mut self, facts: &TaskFacts, start: &StartFacts) {
        match &mut *self.rules {
            State::Paper(rules) => rules.start(&self.preset, facts, start),
            State::RealRepo(rules) => rules.start(facts, start),
            State::RealTrainer(rules) => rules.start(facts, start),
        }
    }

    /// Appends the terms of the next step; those that are zero are left out. A task without a goal
    /// has none.
    pub fn step(&mut self, facts: &mut TaskFacts, step: &StepFacts, terms: &mut Vec<AppliedTerm>) {
        if !facts.has_goal {
            return;
        }
        let mut paid = TermSink::new(&self.preset, terms);
        match &mut *self.rules {
            State::Paper(rules) => rules.step(facts, step, &mut paid),
            State::RealRepo(rules) => rules.step(facts, step, &mut paid),
            State::RealTrainer(rules) => rules.step(facts, step, &mut paid),
        }
    }

    /// The share of the targets that was matched so far, once an episode started: `rho` of preset
    /// `paper`, the completion of `real-repo` and `real-trainer`.
    pub fn progress(&self) -> f64 {
        match &*self.rules {
            State::Paper(rules) => rules.progress(),
            State::RealRepo(rules) => rules.completion(),
            State::RealTrainer(rules) => rules.completion(),
        }
    }

    /// Why the rules are done with the episode, so that later steps pay nothing; `None` if they go
    /// on. Only those of `real-trainer` end before the record does.
    pub fn ending(&self) -> Option<TrainerEnd> {
        match &*self.rules {
            State::Paper(_) | State::RealRepo(_) => None,
            State::RealTrainer(rules) => rules.ending(),
        }
    }

    /// What the trainer holds of the episode; `None` for other presets than `real-trainer`.
    pub fn trainer_state(&self, facts: &TaskFacts) -> Option<TrainerState> {
        match &*self.rules {
            State::Paper(_) | State::RealRepo(_) => None,
            State::RealTrainer(rules) => Some(rules.state(facts)),
        }
    }

    /// Scores a whole episode into a buffer; the sums are bit-equal to those of [`crate::metrics`].
    pub fn score(
        &mut self,
        facts: &mut TaskFacts,
        episode: &EpisodeFacts,
        reward: &mut EpisodeReward,
    ) {
        reward.fired.clear();
        reward.ends.clear();
        reward.totals.clear();
        reward.ending = None;
        self.start(facts, &episode.start());
        for step in episode.steps() {
            let from = reward.fired.len();
            self.step(facts, &step, &mut reward.fired);
            reward.ends.push(reward.fired.len());
            reward
                .totals
                .push(reward.fired[from..].iter().map(|fired| fired.value).sum());
            if reward.ending.is_none() {
                reward.ending = self
                    .ending()
                    .map(|ending| (reward.totals.len() as u32 - 1, ending));
            }
        }
        reward.total = reward.totals.iter().sum();
        reward.discounted_return = discounted_return(&reward.totals, self.preset.gamma());
    }
}

impl EpisodeReward {
    /// The reward of each step.
    pub fn steps(&self) -> &[f64] {
        &self.totals
    }

    /// Cumulative reward of the episode: the undiscounted sum over its steps.
    pub fn total(&self) -> f64 {
        self.total
    }

    /// Discounted by the preset's gamma.
    pub fn discounted_return(&self) -> f64 {
        self.discounted_return
    }

    /// The step (from 0) with which the rules were done, and why; `None` if they read the
    /// record to its end.
    pub fn ending(&self) -> Option<(u32, TrainerEnd)> {
        self.ending
    }

    /// What a step paid; nothing after the last one.
    pub fn terms(&self, step: usize) -> &[AppliedTerm] {
        let Some(end) = self.ends.get(step) else {
            return &[];
        };
        let from = step.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.fired[from..*end]
    }

    /// The sum of a component over the episode.
    pub fn component(&self, name: &str) -> f64 {
        self.fired
            .iter()
            .filter(|fired| fired.term.component() == name)
            .map(|fired| fired.value)
            .sum()
    }

    /// Everything that was paid, in order.
    pub fn applied_terms(&self) -> &[AppliedTerm] {
        &self.fired
    }
}

impl<'a> TermSink<'a> {
    pub(crate) fn preset(&self) -> &'a Preset {
        self.preset
    }

    /// Pays the weight of a term.
    pub(crate) fn once(&mut self, term: Term, cause: Cause) {
        self.pay(term, self.preset.weight(term), cause);
    }

    /// Pays a multiple of the weight of a term.
    pub(crate) fn times(&mut self, term: Term, factor: f64, cause: Cause) {
        self.pay(term, self.preset.weight(term) * factor, cause);
    }

    /// Pays into a list.
    pub(crate) fn new(preset: &'a Preset, terms: &'a mut Vec<AppliedTerm>) -> Self {
        Self {
            from: terms.len(),
            preset,
            terms,
        }
    }

    /// Puts the terms of the step into the order of [`Term::ALL`].
    pub(crate) fn sort(&mut self) {
        self.terms[self.from..].sort_by_key(|fired| fired.term);
    }

    fn pay(&mut self, term: Term, value: f64, cause: Cause) {
        if value != 0.0 {
            self.terms.push(AppliedTerm { term, value, cause });
        }
    }
}
