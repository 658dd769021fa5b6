//! Preset `real-repo`: the reward of the published code (REAL's gspo branch), number for number, by the definitions of SPEC
//! section 5.
//!
//! The registry scores, and objects count as their assets. What is repeated here is the published *reward class*; where the
//! words of the definitions and that class can be read differently, the class decides:
//! - Targets are the differences of the task's goal and initial graph by (asset, place, add/remove), doors apart. A step's
//!   differences are net: an asset that leaves a place while another of it arrives has not changed it.
//! - An element is matched as often as the targets hold it. An `add` at the right place whose target is used up already is
//!   neutral, and so costs the -2.0 of a wrong place too.
//! - Completion is 0 before the first step, also where there are no targets: such a task pays +2.0 twice on its first step.
//! - On steps at whose end something is held: +0.3 once an asset; +0.5 once an asset whose first place (in identifier order)
//!   is neither that of its first target `remove` nor that of its first `add`, whatever is held.
//! - Recovery as published: the wrong object is the first one held that no target names, for ever; it counts as returned
//!   when its `add` at its origin is among the changes of a step at whose end something is held. One gripper cannot do that
//!   in one call, so it pays only for records in which a place and the next pick are one step.
//! - `ask` and `pick` count when they are called with good arguments, whether or not they succeed. So do the anti-exploit terms.
//! - A step is a decision of the record, also `finish` and calls that are none.
//!
//! What the class is told by its environment is derived so:
//! - Several were seen: after `walk_around` or `show_object_by_category` the marker map held more than one object whose
//!   category contains the target's. A successful pick forgets it.
//! - The answer names a marker: the longest number of the current marker map that occurs in it (the smallest of equally long
//!   ones); without a map, what follows `marker`. It stays until another answer names one or a pick succeeds.
//! - An `ask` followed: any `ask` since several were seen first.
//! - A pick is judged by what was known before it. (The published environment forgets that before it judges, so that there
//!   only picks that fail can earn or cost; and only an answer that names a marker counts. `pick_clears_first` does the same.)
//!
//! Left out, because they are the environment's and not terms of the reward: its penalties for errors (-0.5, -0.3) and for a
//! full or empty hand (-0.3), -1.0 at the horizon, and its own sum for `finish`. It also translates assets into categories
//! where it knows them, so that two assets of one category are one thing there; here they are two, as in the definitions.
//!
//! # A worked example
//! The task and the calls of the example in `paper.rs`: a red and a green apple on `table_1`, the red one goes to `fridge_0`.
//! Targets: `{-red@table_1, +red@fridge_0}`, so that a match gives 1.5 (diff_match) + 2.0/2 (progress_shaping) = 2.5.
//!
//! | step | call | terms | sum |
//! |---|---|---|---|
//! | 0 | `nav_to` table_1 | | 0 |
//! | 1 | `walk_around`: marks both | | 0 |
//! | 2 | `ask`: "marker 1" | ask 1.0, ask_when_ambiguous 0.5 | 1.5 |
//! | 3 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 4 | `open` | step_penalty -0.03 | -0.03 |
//! | 5 | `nav_to` table_1 again | step_penalty -0.03 | -0.03 |
//! | 6 | `pick` green | step_penalty -0.03 | -0.03 |
//! | 7 | `place` it back on table_1 | step_penalty -0.03 | -0.03 |
//! | 8 | `pick` red | 2.5, pick_correct_object 0.3, partial_move 0.5, step_penalty -0.03 | 3.27 |
//! | 9 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 10 | `place` on an unknown marker | step_penalty -0.03 | -0.03 |
//! | 11 | `place` into fridge_0 | 2.5, perfect_match 2.0, step_penalty -0.03 | 4.47 |
//! | 12 | `finish` | step_penalty -0.03 | -0.03 |
//!
//! In all 9.0. The green apple is not what the answer named, but somebody was asked, so that pick costs nothing; and it forgets
//! the answer. With the anti-exploit terms: +1.0 (step 1, red has a marker), +0.3 each in steps 0 and 3,
//! -0.2 each in steps 5 and 9. The test `worked_example_of_the_published_code` takes these steps.

use crate::{
    facts::{AssetChange, AssetKey, Called, Change, Counts, Marked, PlaceKey, StartFacts, StepFacts, TaskFacts},
    score::{Cause, Paid},
    terms::Term,
};

/// The state of the rules during one episode. The page of this module has the corners and a worked example.
#[derive(Clone, Debug, Default)]
pub(crate) struct RealRepo {
    /// Which targets were matched, and how many were not.
    matched: Vec<bool>,
    remaining: usize,
    initial: Counts,
    counts: Counts,
    /// As the step before left it.
    completion: f64,
    completed: bool,
    steps: u32,
    picked: Vec<AssetKey>,
    moved: Vec<AssetKey>,
    recovery: Recovery,
    asks: u32,
    ambiguous_asks: u32,
    dialogue: Dialogue,
    exploits: Exploits,
    /// The net changes of the step.
    diffs: Vec<AssetChange>,
}

#[derive(Clone, Copy, Debug, Default)]
enum Recovery {
    #[default]
    None,
    /// An object was held that no target names.
    Wrong { asset: AssetKey, origin: Option<PlaceKey>, returned: bool },
    /// Rewarded.
    Done,
}

/// What the environment tells of markers and answers.
#[derive(Clone, Debug, Default)]
struct Dialogue {
    map: Vec<(u32, Marked)>,
    /// Several objects of the target's category were seen.
    several: bool,
    asked: bool,
    /// The marker that the last answer with one named.
    named: Option<u32>,
}

/// What the anti-exploit terms remember.
#[derive(Clone, Debug, Default)]
struct Exploits {
    discovered: Vec<AssetKey>,
    visited: Vec<PlaceKey>,
    /// The last receptacles driven to.
    drives: Vec<PlaceKey>,
    perceived: Vec<Marked>,
    gazed_at: Option<u32>,
}

impl RealRepo {
    /// Takes in the state before the first decision.
    pub(crate) fn start(&mut self, facts: &TaskFacts, start: &StartFacts) {
        self.matched.clear();
        self.matched.resize(facts.asset_goal.len(), false);
        self.remaining = facts.asset_goal.len();
        self.counts.clone_from(&facts.initial_assets);
        apply(&mut self.counts, facts, start.registry);
        self.initial.clone_from(&self.counts);
        (self.completion, self.completed, self.steps) = (0.0, false, 0);
        self.picked.clear();
        self.moved.clear();
        self.recovery = Recovery::None;
        (self.asks, self.ambiguous_asks) = (0, 0);
        self.dialogue.clear();
        self.exploits.clear();
    }

    /// The share of the targets that was matched; 1 where there are none.
    pub(crate) fn completion(&self) -> f64 {
        if self.matched.is_empty() { 1.0 } else { 1.0 - self.remaining as f64 / self.matched.len() as f64 }
    }

    /// Pays the terms of the next step, in the order of the published code.
    pub(crate) fn step(&mut self, facts: &TaskFacts, step: &StepFacts, paid: &mut Paid) {
        let rules = paid.preset().rules;
        self.net_changes(facts, step.registry);
        apply(&mut self.counts, facts, step.registry);
        self.match_targets(facts, paid);
        let completion = self.completion();
        paid.times(Term::ProgressShaping, completion - self.completion, Cause::None);
        self.completion = completion;
        self.steps += 1;
        if self.steps > rules.free_steps {
            paid.once(Term::StepPenalty, Cause::Count(self.steps));
        }
        if let Some(held) = step.head.held {
            let held = facts.asset_of(held);
            self.partial_credit(facts, held, paid);
            self.recover(facts, held, paid);
        }
        if let Some(map) = step.markers {
            self.dialogue.map.clear();
            self.dialogue.map.extend_from_slice(map);
        }
        if rules.anti_exploit {
            self.exploits.step(facts, step, &self.dialogue.map, paid);
            if step.head.tool == Called::Finish && self.remaining > 0 {
                paid.once(Term::PrematureFinish, Cause::Count(self.remaining as u32));
            }
        }
        self.tools(facts, step, paid);
    }

    /// The differences of the graph by asset, without what cancels out.
    fn net_changes(&mut self, facts: &TaskFacts, changes: &[Change]) {
        self.diffs.clear();
        for change in changes {
            let (object, place, add) = match *change {
                Change::Add { object, place } => (object, place, true),
                Change::Remove { object, place } => (object, place, false),
                Change::Door { .. } => continue,
            };
            let diff = AssetChange { asset: facts.asset_of(object), place, add };
            match self.diffs.iter().position(|other| *other == AssetChange { add: !add, ..diff }) {
                Some(cancelled) => {
                    self.diffs.remove(cancelled);
                }
                None => self.diffs.push(diff),
            }
        }
    }

    fn match_targets(&mut self, facts: &TaskFacts, paid: &mut Paid) {
        let targets = &facts.asset_goal;
        for diff in &self.diffs {
            let cause = Cause::AssetChange(*diff);
            if let Some(found) = targets.iter().zip(&self.matched).position(|(target, matched)| !matched && target == diff) {
                self.matched[found] = true;
                self.remaining -= 1;
                paid.once(Term::DiffMatch, cause);
            } else if targets.contains(&AssetChange { add: !diff.add, ..*diff }) {
                paid.once(Term::WrongDiff, cause);
            } else if diff.add && targets.iter().any(|target| target.add && target.asset == diff.asset) {
                paid.once(Term::PlaceWrongFurniture, cause);
            }
        }
        if self.remaining == 0 && !self.completed {
            self.completed = true;
            paid.once(Term::PerfectMatch, Cause::None);
        }
    }

    fn partial_credit(&mut self, facts: &TaskFacts, held: AssetKey, paid: &mut Paid) {
        let targets = &facts.asset_goal;
        if !self.picked.contains(&held) && targets.iter().any(|target| !target.add && target.asset == held) {
            self.picked.push(held);
            paid.once(Term::PickCorrectObject, Cause::Asset(held));
        }
        for target in targets {
            let asset = target.asset;
            if self.moved.contains(&asset) {
                continue;
            }
            let first =
                |add: bool| targets.iter().find(|other| other.asset == asset && other.add == add).map(|found| found.place);
            let (Some(source), Some(goal)) = (first(false), first(true)) else { continue };
            let place = facts.first_place(&self.counts, asset.0);
            if place != Some(source) && place != Some(goal) {
                self.moved.push(asset);
                paid.once(Term::PartialMove, Cause::Asset(asset));
            }
        }
    }

    fn recover(&mut self, facts: &TaskFacts, held: AssetKey, paid: &mut Paid) {
        let is_target = facts.asset_goal.iter().any(|target| target.asset == held);
        if matches!(self.recovery, Recovery::None) && !is_target {
            let removed = self.diffs.iter().find(|diff| diff.asset == held && !diff.add).map(|diff| diff.place);
            let origin = removed.or_else(|| facts.first_place(&self.initial, held.0));
            self.recovery = Recovery::Wrong { asset: held, origin, returned: false };
        }
        let Recovery::Wrong { asset, origin, returned } = &mut self.recovery else { return };
        let back = |diff: &AssetChange| diff.add && diff.asset == *asset && origin.is_none_or(|origin| origin == diff.place);
        *returned |= self.diffs.iter().any(back);
        if *returned && is_target {
            paid.once(Term::ReplanRecoverPick, Cause::Asset(*asset));
            self.recovery = Recovery::Done;
        }
    }

    /// The terms of `ask` and `pick`.
    fn tools(&mut self, facts: &TaskFacts, step: &StepFacts, paid: &mut Paid) {
        let rules = paid.preset().rules;
        let dialogue = &mut self.dialogue;
        let picked = step.head.succeeded(Called::Pick);
        if picked && rules.pick_clears_first {
            dialogue.forget();
        }
        match step.head.tool {
            Called::WalkAround | Called::ShowObjectByCategory => dialogue.perceive(facts),
            Called::Ask => {
                if self.asks < rules.ask_limit {
                    self.asks += 1;
                    paid.once(Term::AskTool, Cause::Count(self.asks));
                }
                if dialogue.several && self.ambiguous_asks < rules.ambiguous_ask_limit {
                    self.ambiguous_asks += 1;
                    paid.once(Term::AskWhenAmbiguous, Cause::Count(self.ambiguous_asks));
                }
                let named = step.head.reply.and_then(|reply| dialogue.named_in(facts.reply_text(reply)));
                dialogue.asked |= named.is_some() || !rules.pick_clears_first;
                dialogue.named = named.or(dialogue.named);
            }
            Called::Pick => match (dialogue.named, step.head.marker) {
                (Some(named), Some(marker)) if named == marker => paid.once(Term::UsedMarkerFromAnswer, Cause::Count(marker)),
                _ if dialogue.several && !dialogue.asked => paid.once(Term::BlindPick, Cause::None),
                _ => {}
            },
            _ => {}
        }
        if picked {
            dialogue.forget();
        }
    }
}

impl Dialogue {
    fn clear(&mut self) {
        self.map.clear();
        self.forget();
    }

    fn forget(&mut self) {
        (self.several, self.asked, self.named) = (false, false, None);
    }

    /// Looks whether the marker map holds several objects like the target.
    fn perceive(&mut self, facts: &TaskFacts) {
        let like = |target: &Marked| matches!(target, Marked::Object(object) if facts.of(*object).like_target);
        if self.map.iter().filter(|(_, target)| like(target)).count() > 1 {
            self.asked &= self.several;
            self.several = true;
        }
    }

    /// The marker that an answer names.
    fn named_in(&self, reply: &str) -> Option<u32> {
        if self.map.is_empty() {
            return after_marker(reply);
        }
        let named = self.map.iter().map(|(number, _)| *number).filter(|number| reply.contains(&number.to_string()));
        named.min_by_key(|number| (u32::MAX - number.checked_ilog10().unwrap_or(0), *number))
    }
}

/// The number after the word `marker`, where one comes at once.
fn after_marker(reply: &str) -> Option<u32> {
    let lower = reply.to_lowercase();
    let (_, rest) = lower.match_indices("marker").map(|(at, word)| lower.split_at(at + word.len())).find(|(_, rest)| {
        let mut letters = rest.chars();
        letters.next().is_some_and(|letter| letter == '_' || letter.is_whitespace())
            && letters.next().is_some_and(|letter| letter == '_' || letter.is_alphanumeric())
    })?;
    let word = rest[rest.chars().next()?.len_utf8()..].split(|letter: char| letter != '_' && !letter.is_alphanumeric()).next()?;
    word.parse().ok()
}

impl Exploits {
    fn clear(&mut self) {
        self.discovered.clear();
        self.visited.clear();
        self.drives.clear();
        self.perceived.clear();
        self.gazed_at = None;
    }

    fn step(&mut self, facts: &TaskFacts, step: &StepFacts, map: &[(u32, Marked)], paid: &mut Paid) {
        for (_, target) in map {
            let Marked::Object(object) = target else { continue };
            let asset = facts.asset_of(*object);
            if facts.asset_goal.iter().any(|target| target.asset == asset) && !self.discovered.contains(&asset) {
                self.discovered.push(asset);
                paid.once(Term::TargetFirstDiscovered, Cause::Asset(asset));
            }
        }
        match step.head.tool {
            Called::NavTo => self.drive(facts, step.head.driven_to, paid),
            Called::WalkAround | Called::ShowObjectByCategory if !map.is_empty() => {
                let mut marked: Vec<Marked> = map.iter().map(|(_, target)| *target).collect();
                marked.sort();
                marked.dedup();
                if marked == self.perceived {
                    paid.once(Term::RepeatedPerception, Cause::None);
                }
                self.perceived = marked;
            }
            Called::GazeAt => {
                if step.head.marker.is_some() && step.head.marker == self.gazed_at {
                    paid.once(Term::RepeatedGaze, Cause::None);
                }
                self.gazed_at = step.head.marker;
            }
            _ => {}
        }
    }

    fn drive(&mut self, facts: &TaskFacts, to: Option<PlaceKey>, paid: &mut Paid) {
        let Some(to) = to else { return };
        if facts.asset_goal.iter().any(|target| target.place == to) && !self.visited.contains(&to) {
            self.visited.push(to);
            paid.once(Term::FirstVisitTargetFurniture, Cause::Visited(to));
        }
        let times = self.drives.iter().filter(|other| **other == to).count();
        paid.times(Term::NavRevisitWindow, times as f64, Cause::Visited(to));
        self.drives.push(to);
        if self.drives.len() > paid.preset().rules.nav_window as usize {
            self.drives.remove(0);
        }
    }
}

fn apply(counts: &mut Counts, facts: &TaskFacts, changes: &[Change]) {
    for change in changes {
        match *change {
            Change::Add { object, place } => counts.add(facts.asset_of(object).0, place),
            Change::Remove { object, place } => counts.remove(facts.asset_of(object).0, place),
            Change::Door { .. } => {}
        }
    }
}
