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

impl Belief {
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
