//! The published reward class: what it pays for a change of the world graph, for what is held, for
//! questions and picks, and (switched on) against exploits. Presets `real-repo` and `real-trainer`
//! hand it graphs by asset and by category; what else its environment does is theirs.
//!
//! - Targets are the differences of the task's goal and initial graph by (kind, place, add/remove),
//!   doors apart. A step's differences are net: a kind that leaves a place while another object of
//!   it arrives has not changed it.
//! - An element is matched as often as the targets hold it. An `add` at the right place whose
//!   target is used up already is neutral, and so costs the -2.0 of a wrong place too.
//! - Completion is 0 before the first step, also where there are no targets: such a task pays +2.0
//!   twice on its first step.
//! - On steps at whose end something is held: +0.3 once a kind; +0.5 once a kind whose first place
//!   (in the order of the scene) is neither that of its first target `remove` nor that of its first
//!   `add`, whatever is held.
//! - Recovery: the wrong object is the first one held that no target names, for ever; it counts as
//!   returned when its `add` at its origin is among the changes of a step at whose end something is
//!   held. One gripper cannot do that in one call, so it pays only where a graph came late.
//! - `ask` and `pick` count whether or not they succeed. So do the anti-exploit terms.

use crate::{
    facts::{
        Change, Counts, Identity, KindChange, KindKey, MarkerReferent, ReceptacleKey, StepHead,
        TaskFacts, TextKey, ToolKind,
    },
    score::{Cause, TermSink},
    terms::Term,
};

/// The state of the class during one episode.
#[derive(Clone, Debug)]
pub(crate) struct DifferenceReward {
    identity: Identity,
    /// Which targets were matched, and how many were not.
    matched: Vec<bool>,
    remaining: usize,
    initial: Counts,
    counts: Counts,
    /// As the step before left it.
    completion: f64,
    completed: bool,
    steps: u32,
    picked: Vec<KindKey>,
    moved: Vec<KindKey>,
    recovery: Recovery,
    asks: u32,
    ambiguous_asks: u32,
    exploits: Exploits,
    /// The net changes of the step.
    diffs: Vec<KindChange>,
}

#[derive(Clone, Copy, Debug, Default)]
enum Recovery {
    #[default]
    None,
    /// An object was held that no target names.
    Wrong {
        kind: KindKey,
        origin: Option<ReceptacleKey>,
        returned: bool,
    },
    /// The recovery was paid; it is paid once.
    Done,
}

/// What the environment tells the class of candidates and answers.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Dialogue {
    /// Several objects like the target were seen.
    pub(crate) ambiguous: bool,
    /// Somebody was asked since.
    pub(crate) asked: bool,
    /// The marker that the last answer with one named.
    pub(crate) named: Option<TextKey>,
}

impl Dialogue {
    /// Several objects like the target are seen: answers to earlier questions do not settle
    /// which one is meant.
    pub(crate) fn see_several(&mut self) {
        self.asked &= self.ambiguous;
        self.ambiguous = true;
    }
}

/// What the anti-exploit terms remember.
#[derive(Clone, Debug, Default)]
struct Exploits {
    discovered: Vec<KindKey>,
    visited: Vec<ReceptacleKey>,
    /// The last receptacles driven to.
    drives: Vec<ReceptacleKey>,
    perceived: Vec<MarkerReferent>,
    gazed_at: Option<TextKey>,
}

impl DifferenceReward {
    pub(crate) fn new(identity: Identity) -> Self {
        Self {
            identity,
            matched: Vec::new(),
            remaining: 0,
            initial: Counts::default(),
            counts: Counts::default(),
            completion: 0.0,
            completed: false,
            steps: 0,
            picked: Vec::new(),
            moved: Vec::new(),
            recovery: Recovery::None,
            asks: 0,
            ambiguous_asks: 0,
            exploits: Exploits::default(),
            diffs: Vec::new(),
        }
    }

    /// Takes in the graph before the first decision: the task's initial one, changed.
    pub(crate) fn start(&mut self, facts: &TaskFacts, changes: &[Change]) {
        let kinds = facts.kinds(self.identity);
        self.matched.clear();
        self.matched.resize(kinds.goal.len(), false);
        self.remaining = kinds.goal.len();
        self.counts.clone_from(&kinds.initial);
        self.apply(facts, changes);
        self.initial.clone_from(&self.counts);
        (self.completion, self.completed, self.steps) = (0.0, false, 0);
        self.picked.clear();
        self.moved.clear();
        self.recovery = Recovery::None;
        (self.asks, self.ambiguous_asks) = (0, 0);
        self.exploits.clear();
    }

    /// The share of the targets that was matched; 1 where there are none.
    pub(crate) fn completion(&self) -> f64 {
        if self.matched.is_empty() {
            1.0
        } else {
            1.0 - self.remaining as f64 / self.matched.len() as f64
        }
    }

    /// As the last step left it: 0 before the first one.
    pub(crate) fn completion_so_far(&self) -> f64 {
        self.completion
    }

    /// Whether no target remained after a step.
    pub(crate) fn is_complete(&self) -> bool {
        self.completed
    }

    /// How many targets were not matched.
    pub(crate) fn remaining(&self) -> usize {
        self.remaining
    }

    /// The targets that were not matched.
    pub(crate) fn remaining_targets(&self, facts: &TaskFacts) -> Vec<KindChange> {
        let targets = facts.kinds(self.identity).goal.iter().zip(&self.matched);
        targets
            .filter(|(_, matched)| !**matched)
            .map(|(target, _)| *target)
            .collect()
    }

    /// How many objects of each kind stand on each receptacle.
    pub(crate) fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Pays for a graph: how it changed, what is held at its end, what has a marker then.
    pub(crate) fn step(
        &mut self,
        facts: &mut TaskFacts,
        changes: &[Change],
        held: Option<KindKey>,
        map: &[(u32, MarkerReferent)],
        paid: &mut TermSink,
    ) {
        let rules = paid.preset().rules;
        self.net_changes(facts, changes);
        self.apply(facts, changes);
        self.match_targets(facts, paid);
        let completion = self.completion();
        paid.times(
            Term::ProgressShaping,
            completion - self.completion,
            Cause::None,
        );
        self.completion = completion;
        self.steps += 1;
        if self.steps > rules.free_steps {
            paid.once(Term::StepPenalty, Cause::Count(self.steps));
        }
        if let Some(held) = held {
            self.partial_credit(facts, held, paid);
            self.recover(facts, held, paid);
        }
        if rules.anti_exploit {
            self.discover(facts, map, paid);
        }
    }

    /// Pays for a call's pattern: only against exploits.
    pub(crate) fn track(
        &mut self,
        facts: &TaskFacts,
        head: &StepHead,
        map: &[(u32, MarkerReferent)],
        paid: &mut TermSink,
    ) {
        if paid.preset().rules.anti_exploit {
            self.exploits.track(facts, self.identity, head, map, paid);
        }
    }

    /// Pays for questions and picks.
    pub(crate) fn tools(
        &mut self,
        tool: ToolKind,
        marker: Option<TextKey>,
        dialogue: Dialogue,
        paid: &mut TermSink,
    ) {
        let rules = paid.preset().rules;
        match tool {
            ToolKind::Ask => {
                if self.asks < rules.ask_limit {
                    self.asks += 1;
                    paid.once(Term::AskTool, Cause::Count(self.asks));
                }
                if dialogue.ambiguous && self.ambiguous_asks < rules.ambiguous_ask_limit {
                    self.ambiguous_asks += 1;
                    paid.once(Term::AskWhenAmbiguous, Cause::Count(self.ambiguous_asks));
                }
            }
            ToolKind::Pick => match dialogue.named {
                Some(named) if marker == Some(named) => {
                    paid.once(Term::UsedMarkerFromAnswer, Cause::Text(named))
                }
                _ if dialogue.ambiguous && !dialogue.asked => {
                    paid.once(Term::BlindPick, Cause::None)
                }
                _ => {}
            },
            _ => {}
        }
    }

    fn apply(&mut self, facts: &TaskFacts, changes: &[Change]) {
        for change in changes {
            match *change {
                Change::Add { object, place } => self
                    .counts
                    .add(facts.kind_of(self.identity, object).0, place),
                Change::Remove { object, place } => self
                    .counts
                    .remove(facts.kind_of(self.identity, object).0, place),
                Change::Door { .. } => {}
            }
        }
    }

    /// The differences of the graph by kind, without what cancels out.
    fn net_changes(&mut self, facts: &TaskFacts, changes: &[Change]) {
        self.diffs.clear();
        for change in changes {
            let (object, place, add) = match *change {
                Change::Add { object, place } => (object, place, true),
                Change::Remove { object, place } => (object, place, false),
                Change::Door { .. } => continue,
            };
            let diff = KindChange {
                kind: facts.kind_of(self.identity, object),
                place,
                add,
            };
            match self.diffs.iter().position(|other| *other == diff.reverse()) {
                Some(cancelled) => {
                    self.diffs.remove(cancelled);
                }
                None => self.diffs.push(diff),
            }
        }
    }

    fn match_targets(&mut self, facts: &TaskFacts, paid: &mut TermSink) {
        let targets = &facts.kinds(self.identity).goal;
        for diff in &self.diffs {
            let cause = Cause::Kind(*diff);
            if let Some(found) = targets
                .iter()
                .zip(&self.matched)
                .position(|(target, matched)| !matched && target == diff)
            {
                self.matched[found] = true;
                self.remaining -= 1;
                paid.once(Term::DiffMatch, cause);
                continue;
            }
            if targets.contains(&diff.reverse()) {
                paid.once(Term::WrongDiff, cause);
                continue;
            }
            paid.once(Term::NeutralDiff, cause);
            if diff.add
                && targets
                    .iter()
                    .any(|target| target.add && target.kind == diff.kind)
            {
                paid.once(Term::PlaceWrongFurniture, cause);
            }
        }
        if self.remaining == 0 && !self.completed {
            self.completed = true;
            paid.once(Term::PerfectMatch, Cause::None);
        }
    }

    fn partial_credit(&mut self, facts: &TaskFacts, held: KindKey, paid: &mut TermSink) {
        let targets = &facts.kinds(self.identity).goal;
        if !self.picked.contains(&held)
            && targets
                .iter()
                .any(|target| !target.add && target.kind == held)
        {
            self.picked.push(held);
            paid.once(Term::PickCorrectObject, Cause::Held(held));
        }
        for target in targets {
            let kind = target.kind;
            if self.moved.contains(&kind) {
                continue;
            }
            let first = |add: bool| {
                targets
                    .iter()
                    .find(|other| other.kind == kind && other.add == add)
                    .map(|found| found.place)
            };
            let (Some(source), Some(goal)) = (first(false), first(true)) else {
                continue;
            };
            let place = facts.first_place(&self.counts, kind.0);
            if place != Some(source) && place != Some(goal) {
                self.moved.push(kind);
                paid.once(Term::PartialMove, Cause::Held(kind));
            }
        }
    }

    fn recover(&mut self, facts: &TaskFacts, held: KindKey, paid: &mut TermSink) {
        let is_target = facts
            .kinds(self.identity)
            .goal
            .iter()
            .any(|target| target.kind == held);
        if matches!(self.recovery, Recovery::None) && !is_target {
            let removed = self
                .diffs
                .iter()
                .find(|diff| diff.kind == held && !diff.add)
                .map(|diff| diff.place);
            let origin = removed.or_else(|| facts.first_place(&self.initial, held.0));
            self.recovery = Recovery::Wrong {
                kind: held,
                origin,
                returned: false,
            };
        }
        let Recovery::Wrong {
            kind,
            origin,
            returned,
        } = &mut self.recovery
        else {
            return;
        };
        let back = |diff: &KindChange| {
            diff.add && diff.kind == *kind && origin.is_none_or(|origin| origin == diff.place)
        };
        *returned |= self.diffs.iter().any(back);
        if *returned && is_target {
            paid.once(Term::ReplanRecoverPick, Cause::Held(*kind));
            self.recovery = Recovery::Done;
        }
    }

    fn discover(
        &mut self,
        facts: &mut TaskFacts,
        map: &[(u32, MarkerReferent)],
        paid: &mut TermSink,
    ) {
        for (_, marked) in map {
            for kind in facts.mentions(*marked).targets(self.identity) {
                if !self.exploits.discovered.contains(kind) {
                    self.exploits.discovered.push(*kind);
                    paid.once(Term::TargetFirstDiscovered, Cause::Held(*kind));
                }
            }
        }
    }
}

impl Exploits {
    fn clear(&mut self) {
        self.discovered.clear();
        self.visited.clear();
        self.drives.clear();
        self.perceived.clear();
        self.gazed_at = None;
    }

    fn track(
        &mut self,
        facts: &TaskFacts,
        identity: Identity,
        head: &StepHead,
        map: &[(u32, MarkerReferent)],
        paid: &mut TermSink,
    ) {
        match head.tool {
            ToolKind::NavTo => self.drive(facts, identity, head.driven_to, paid),
            ToolKind::WalkAround | ToolKind::ShowObjectByCategory if !map.is_empty() => {
                let mut marked: Vec<MarkerReferent> =
                    map.iter().map(|(_, target)| *target).collect();
                marked.sort();
                marked.dedup();
                if marked == self.perceived {
                    paid.once(Term::RepeatedPerception, Cause::None);
                }
                self.perceived = marked;
            }
            ToolKind::GazeAt => {
                // as published: a first gaze without a marker repeats the gaze that was not there
                if head.marker == self.gazed_at {
                    paid.once(Term::RepeatedGaze, Cause::None);
                }
                self.gazed_at = head.marker;
            }
            _ => {}
        }
    }

    fn drive(
        &mut self,
        facts: &TaskFacts,
        identity: Identity,
        to: Option<ReceptacleKey>,
        paid: &mut TermSink,
    ) {
        let Some(to) = to else { return };
        if facts
            .kinds(identity)
            .goal
            .iter()
            .any(|target| target.place == to)
            && !self.visited.contains(&to)
        {
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
