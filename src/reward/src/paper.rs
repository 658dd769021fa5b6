//! Preset `paper`: the reward of the paper's Detailed Reward Configuration, by
//! the definitions of docs/spec.md#reward-preset-paper.
//!
//! The physical graph scores. Where the definitions leave a corner, it is decided so:
//! - `Delta_task` is a set union: an aux element that is a goal change already (a door to be
//!   opened and left open) is not counted twice, and source and destination that are one
//!   receptacle give one visit.
//! - Matching reads the changes of the step, so an element that happens to hold before the first
//!   decision is never matched; the +2.0 looks at the state and can be had all the same. A task
//!   without goal changes has no +2.0.
//! - `achieved` means matched in an earlier step. Only elements of `Delta_goal` can be reversed at
//!   a cost: closing a door that only had to be opened on the way is free.
//! - The -2.0 goes by where physics says the placed object came to rest. The floor is a place but
//!   no receptacle. Putting a goal object back on its source is a reversal (-0.5) and a wrong
//!   receptacle (-2.0): both rules apply.
//! - In transit: the gripper holds the instance at the end of the step and it is in no place at
//!   all. Only an instance that has both a source and a destination in `Delta_goal`.
//! - Recovery: any wrong instance put back where it lay before its pick, then any goal instance
//!   picked, in this order.
//! - Ask: candidates were seen before the question, and equal assets count as one, since words
//!   cannot tell them apart. An `ask` that fails earns nothing and costs no budget.
//! - Time: the fourth decision is the first that costs.
//!
//! # A worked example
//! A red and a green apple stand on `table_1`; "Take an apple from the table and put it into the
//! fridge" means the red one; the door of `fridge_0` is closed. `Delta_goal = {-red@table_1,
//! +red@fridge_0}`; `Delta_aux = {nav_to(table_1), nav_to(fridge_0), (fridge_0, open)}`. So
//! `|Delta_task| = 5`, and a match gives 1.5 (task) + 2.0/5 (prog) = 1.9. One distractor of the
//! category: `B_ask = 1`.
//!
//! | step | call | terms | sum |
//! |---|---|---|---|
//! | 0 | `nav_to` table_1 | 1.9 | 1.9 |
//! | 1 | `walk_around`: lists both | | 0 |
//! | 2 | `ask`: "the red one" | ask 1.0 | 1.0 |
//! | 3 | `nav_to` fridge_0 | 1.9, time -0.03 | 1.87 |
//! | 4 | `open` | 1.9, time -0.03 | 1.87 |
//! | 5 | `nav_to` table_1 again | time -0.03 | -0.03 |
//! | 6 | `pick` green | time -0.03 | -0.03 |
//! | 7 | `place` it back on table_1 | time -0.03 | -0.03 |
//! | 8 | `pick` red | 1.9, phys 0.3 + 0.5 + 1.0, time -0.03 | 3.67 |
//! | 9 | `nav_to` fridge_0 | time -0.03 | -0.03 |
//! | 10 | `place` on an unknown marker | safe -0.5, time -0.03 | -0.53 |
//! | 11 | `place` into fridge_0 | 1.9, task 2.0, time -0.03 | 3.87 |
//! | 12 | `finish` | time -0.03 | -0.03 |
//!
//! In all 13.5. The test `worked_example` takes these steps.

use reel_world::{DoorState, ErrorClass};

use crate::{
    facts::{
        Change, Counts, ObjectKey, ReceptacleKey, StartFacts, StepFacts, StepHead, Target,
        TaskFacts, ToolKind,
    },
    preset::Preset,
    score::{Cause, TermSink},
    terms::Term,
};

/// The state of the rules during one episode. The page of this module has the corners
/// and a worked example.
#[derive(Clone, Debug, Default)]
pub(crate) struct Paper {
    /// Which elements of `Delta_task` were matched, and how many were not.
    matched: Vec<bool>,
    remaining: usize,
    counts: Counts,
    doors: Vec<Option<DoorState>>,
    /// Whether the graph changed since the goal was last compared with it.
    changed: bool,
    all_held: bool,
    decisions: u32,
    valid_picks: Vec<ObjectKey>,
    transits: Vec<ObjectKey>,
    recovery: Recovery,
    /// Whether each object has been seen so far, by object number.
    seen: Vec<bool>,
    /// Candidates that fit the replies so far.
    left: Vec<bool>,
    /// `B_ask` less the questions that earned something.
    budget: u32,
}

/// How far the recovery from a wrong pick is.
#[derive(Clone, Debug)]
enum Recovery {
    /// Wrong instances and where they lay before their pick.
    Open {
        origins: Vec<(ObjectKey, ReceptacleKey)>,
    },
    /// One of them was put back.
    PutBack { object: ObjectKey },
    /// The recovery was rewarded, which happens once per episode at most.
    Done,
}

impl Default for Recovery {
    fn default() -> Self {
        Recovery::Open {
            origins: Vec::new(),
        }
    }
}

impl Paper {
    /// Takes in the state before the first decision.
    pub(crate) fn start(&mut self, preset: &Preset, facts: &TaskFacts, start: &StartFacts) {
        refill(&mut self.matched, facts.targets.len(), false);
        self.remaining = facts.targets.len();
        self.counts.clone_from(&facts.initial);
        self.doors.clone_from(&facts.initial_doors);
        self.apply(start.physics);
        (self.changed, self.all_held, self.decisions) = (true, false, 0);
        self.valid_picks.clear();
        self.transits.clear();
        match &mut self.recovery {
            Recovery::Open { origins } => origins.clear(),
            other => *other = Recovery::default(),
        }
        refill(&mut self.seen, facts.object_count(), false);
        refill(&mut self.left, facts.candidates.len(), true);
        self.budget = facts.ask_budget.min(preset.rules.ask_limit);
        self.see(start.visible);
    }

    /// `rho`: the share of `Delta_task` that was matched, which always holds a visit.
    pub(crate) fn progress(&self) -> f64 {
        1.0 - self.remaining as f64 / self.matched.len() as f64
    }

    /// Pays the terms of the next step.
    pub(crate) fn step(&mut self, facts: &mut TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        let progress_before = self.progress();
        self.reversals(facts, step, paid);
        let recovered = self.recover(facts, step);
        self.apply(step.physics);
        self.match_targets(facts, step, paid);
        paid.times(
            Term::Progress,
            self.progress() - progress_before,
            Cause::None,
        );
        self.handling(facts, step, recovered, paid);
        self.ask(facts, step, paid);
        self.decisions += 1;
        if self.decisions > paid.preset().rules.free_steps {
            paid.once(Term::Time, Cause::Count(self.decisions));
        }
        match step.head.error {
            Some(ErrorClass::Severe) => paid.once(Term::Severe, Cause::None),
            Some(ErrorClass::Moderate) => paid.once(Term::Moderate, Cause::None),
            None => {}
        }
        paid.sort();
    }

    fn apply(&mut self, changes: &[Change]) {
        self.changed |= !changes.is_empty();
        for change in changes {
            match *change {
                Change::Remove { object, place } => self.counts.remove(object.0, place),
                Change::Add { object, place } => self.counts.add(object.0, place),
                Change::Door { place, to, .. } => {
                    let at = place.0 as usize;
                    if self.doors.len() <= at {
                        self.doors.resize(at + 1, None);
                    }
                    self.doors[at] = Some(to);
                }
            }
        }
    }

    fn see(&mut self, objects: &[ObjectKey]) {
        for object in objects {
            let at = object.0 as usize;
            if self.seen.len() <= at {
                self.seen.resize(at + 1, false);
            }
            self.seen[at] = true;
        }
    }

    /// For each event that undoes an achieved goal change.
    fn reversals(&self, facts: &TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        for change in step.physics {
            let undone = Target::Goal(change.reverse());
            if facts
                .targets
                .iter()
                .zip(&self.matched)
                .any(|(target, matched)| *matched && *target == undone)
            {
                paid.once(Term::Reversed, Cause::Change(*change));
            }
        }
    }

    /// Follows wrong picks; true when this step completes a recovery. Reads the
    /// graph before the step.
    fn recover(&mut self, facts: &TaskFacts, step: &StepFacts) -> bool {
        let picked = step
            .head
            .object
            .filter(|_| step.head.succeeded(ToolKind::Pick));
        match &mut self.recovery {
            Recovery::Open { origins } => {
                let back = step.physics.iter().find_map(|change| match *change {
                    Change::Add { object, place } if origins.contains(&(object, place)) => {
                        Some(object)
                    }
                    _ => None,
                });
                if let Some(object) = back {
                    self.recovery = Recovery::PutBack { object };
                } else if let Some(object) = picked
                    && !facts.of(object).in_goal
                    && let Some(origin) = facts.first_place(&self.counts, object.0)
                {
                    origins.retain(|(other, _)| *other != object);
                    origins.push((object, origin));
                }
                false
            }
            Recovery::PutBack { .. } => picked.is_some_and(|object| facts.of(object).moves_away),
            Recovery::Done => false,
        }
    }

    /// For each newly matched element, and the first time that all goal changes hold.
    fn match_targets(&mut self, facts: &TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        for change in step.physics {
            self.match_target(facts, Target::Goal(*change), Cause::Change(*change), paid);
        }
        for change in step.physics {
            if let Change::Door {
                place,
                to: DoorState::Open,
                ..
            } = *change
            {
                self.match_target(facts, Target::Opening(place), Cause::Opened(place), paid);
            }
        }
        if step.head.succeeded(ToolKind::NavTo)
            && let Some(place) = step.head.receptacle
        {
            self.match_target(facts, Target::Visit(place), Cause::Visited(place), paid);
        }
        if self.changed && !self.all_held && !facts.goal.is_empty() {
            self.changed = false;
            self.all_held = facts.goal.iter().all(|goal| match goal.change {
                Change::Remove { object, place } => {
                    goal.was.saturating_sub(self.counts.count(object.0, place)) > goal.earlier
                }
                Change::Add { object, place } => {
                    self.counts.count(object.0, place).saturating_sub(goal.was) > goal.earlier
                }
                Change::Door { place, to, .. } => {
                    self.doors.get(place.0 as usize) == Some(&Some(to))
                }
            });
            if self.all_held {
                paid.once(Term::AllHold, Cause::None);
            }
        }
    }

    fn match_target(
        &mut self,
        facts: &TaskFacts,
        event: Target,
        cause: Cause,
        paid: &mut TermSink,
    ) {
        let found = facts
            .targets
            .iter()
            .zip(&self.matched)
            .position(|(target, matched)| !matched && *target == event);
        if let Some(found) = found {
            self.matched[found] = true;
            self.remaining -= 1;
            paid.once(Term::Matched, cause);
        }
    }

    /// Picks, transit, recovery and wrong places. Reads the graph after the step.
    fn handling(
        &mut self,
        facts: &TaskFacts,
        step: &StepFacts,
        recovered: bool,
        paid: &mut TermSink,
    ) {
        let StepHead { object, held, .. } = step.head;
        if let Some(object) = object.filter(|_| step.head.succeeded(ToolKind::Place)) {
            let wrong = step
                .physics
                .iter()
                .find(|change| is_wrong_place(facts, **change, object));
            if let Some(change) = wrong {
                paid.once(Term::WrongReceptacle, Cause::Change(*change));
            }
        }
        if let Some(object) = object.filter(|_| step.head.succeeded(ToolKind::Pick))
            && facts.of(object).moves_away
            && !self.valid_picks.contains(&object)
        {
            self.valid_picks.push(object);
            paid.once(Term::ValidPick, Cause::Object(object));
        }
        if let Some(object) = held
            && facts.of(object).moves_away
            && facts.of(object).has_destination
            && !self.transits.contains(&object)
            && self.counts.places_of(object.0).next().is_none()
        {
            self.transits.push(object);
            paid.once(Term::InTransit, Cause::Object(object));
        }
        if recovered
            && let Recovery::PutBack { object } =
                std::mem::replace(&mut self.recovery, Recovery::Done)
        {
            paid.once(Term::Recovery, Cause::Object(object));
        }
    }

    /// For a question while it is needed and the budget lasts.
    fn ask(&mut self, facts: &mut TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        if step.head.succeeded(ToolKind::Ask) {
            let among = self.candidates_in_view(facts);
            for (left, fits) in self.left.iter_mut().zip(facts.fits(step.head.reply)) {
                *left &= fits;
            }
            if among >= 2 && self.budget > 0 {
                self.budget -= 1;
                paid.once(Term::Ask, Cause::Count(among));
            }
        }
        self.see(step.visible);
    }

    /// How many candidates were seen and fit what was said; those of one asset count as one.
    fn candidates_in_view(&self, facts: &TaskFacts) -> u32 {
        let (mut among, mut last) = (0, None);
        for (candidate, left) in facts.candidates.iter().zip(&self.left) {
            let seen = self.seen.get(candidate.object.0 as usize) == Some(&true);
            if *left && seen && last != Some(candidate.asset) {
                last = Some(candidate.asset);
                among += 1;
            }
        }
        among
    }
}

fn is_wrong_place(facts: &TaskFacts, change: Change, placed: ObjectKey) -> bool {
    let Change::Add { object, place } = change else {
        return false;
    };
    object == placed
        && place != facts.floor
        && facts.of(object).has_destination
        && !facts.goal.iter().any(|goal| goal.change == change)
}

fn refill(flags: &mut Vec<bool>, length: usize, value: bool) {
    flags.clear();
    flags.resize(length, value);
}
