//! What speaks against a call that somebody else made, from what could be known then. Never
//! what came of it.

use super::{Belief, Move};

/// The capacity that failed where a call goes against what could be known.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Objection {
    /// Its look told it apart from what was meant.
    Perception,
    /// Several fitted, and nobody was asked.
    Communication,
    /// It was known already that this leads nowhere.
    Memory,
}

/// What a call takes for known that its agent had not found out.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Presumption {
    /// Which of several objects that fit is meant.
    Object,
    /// Which of several receptacles is the source.
    Source,
    /// Which of several receptacles is the destination.
    Destination,
}

impl Presumption {
    /// As a phrase that completes "it needs to know ...".
    pub fn phrase(self) -> &'static str {
        match self {
            Presumption::Object => "which of several objects is meant, and nobody had said so",
            Presumption::Source => "which of several receptacles is the source, before any look",
            Presumption::Destination => {
                "which of several receptacles is the destination, before any look"
            }
        }
    }
}

impl Belief {
    /// What this move takes for known without having found it out; none for the move of a
    /// competent agent.
    pub fn presumption(&self, made: &Move) -> Option<Presumption> {
        if *made == self.next() {
            return None;
        }
        let errands = || 0..self.errands.len();
        match made {
            Move::Pick(thing) => {
                let errand = errands().find(|errand| self.may_be(*thing, *errand))?;
                match self.source(errand) {
                    None => Some(Presumption::Source),
                    Some(_) => self.wants_to_ask(errand).then_some(Presumption::Object),
                }
            }
            Move::NavTo(to) if self.held.is_none() => errands()
                .any(|errand| {
                    self.source(errand).is_none() && self.open_sources(errand).any(|id| id == to)
                })
                .then_some(Presumption::Source),
            Move::Place(to) | Move::NavTo(to) => {
                let held = self.held?;
                let errand = errands().find(|errand| self.may_be(held, *errand))?;
                let open = self.open_destinations(errand).any(|id| id == to);
                (open && self.destination(errand).is_none()).then_some(Presumption::Destination)
            }
            _ => None,
        }
    }

    /// What speaks against making this move now; none where nothing does, or nothing of these.
    pub fn objection(&self, made: &Move) -> Option<Objection> {
        if *made == self.next() {
            return None;
        }
        let errands = || 0..self.errands.len();
        match made {
            Move::Pick(thing) => match errands().find(|errand| self.may_be(*thing, *errand)) {
                Some(errand) => self
                    .wants_to_ask(errand)
                    .then_some(Objection::Communication),
                None => self
                    .things
                    .contains_key(thing)
                    .then_some(Objection::Perception),
            },
            Move::Place(receptacle) => {
                let meant =
                    |errand: usize| self.open_destinations(errand).any(|id| id == receptacle);
                let held = self
                    .held
                    .and_then(|thing| errands().find(|errand| self.may_be(thing, *errand)))?;
                (!meant(held)).then_some(Objection::Perception)
            }
            Move::NavTo(receptacle) => self
                .visited
                .contains(receptacle)
                .then_some(Objection::Memory),
            Move::ShowReceptacles => {
                let here = self.at.as_ref();
                here.is_some_and(|here| self.receptacles.contains(here))
                    .then_some(Objection::Memory)
            }
            Move::WalkAround | Move::Find(_) => {
                let surveyed = self
                    .at
                    .as_ref()
                    .is_some_and(|here| self.surveyed.contains(here));
                (surveyed && !self.numbered.is_empty()).then_some(Objection::Memory)
            }
            Move::Gaze(thing) => (self.gazed == Some(*thing)).then_some(Objection::Memory),
            Move::Ask(_) => self.settled.then_some(Objection::Memory),
            Move::Open(_) | Move::Close(_) | Move::Finish(_) => None,
        }
    }
}
