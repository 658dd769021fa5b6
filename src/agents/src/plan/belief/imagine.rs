//! The worst that can come of each move, as far as one knows, and so how many decisions are needed
//! at worst. Never what physics may spoil: a call that can succeed succeeds.

use std::collections::BTreeSet;

use reel_world::{HORIZON, ReceptacleId};

use super::{Belief, Move, ObjectIndex, Sighting};

impl Belief {
    /// The moves to the end if every open question is answered at its worst, `finish` included;
    /// none where something is in the way for good, or no end comes in sight.
    pub fn worst_case(&self) -> Option<Vec<Move>> {
        let mut imagined = self.clone();
        let mut moves = Vec::new();
        // What is needed at worst is far less than this.
        while moves.len() < 4 * HORIZON as usize {
            let next = imagined.next();
            moves.push(next.clone());
            match next {
                Move::Finish(done) => return done.then_some(moves),
                next => imagined.assume_worst(&next),
            }
        }
        None
    }

    /// Decisions to the end at worst.
    pub fn cost_to_go(&self) -> Option<u32> {
        self.worst_case().map(|moves| moves.len() as u32)
    }

    fn assume_worst(&mut self, next: &Move) {
        match next {
            Move::NavTo(receptacle) => {
                self.go(receptacle);
                self.see_nothing();
            }
            Move::ShowReceptacles => {
                self.see_nothing();
                if let Some(here) = self.at.clone() {
                    self.receptacles = BTreeSet::from([here.clone()]);
                    let found = self
                        .closed
                        .contains(&here)
                        .then(|| self.read_as_meant(&here));
                    self.read_at_worst(&here);
                    // Behind a closed door it is worse to find what one looks for than to go on.
                    if let Some(found) = found.filter(|found| found.effort() > self.effort()) {
                        *self = found;
                    }
                }
            }
            Move::Find(thing) => self.look_at_worst(Some(*thing)),
            Move::WalkAround => self.look_at_worst(None),
            Move::Gaze(thing) => self.gazed = Some(*thing),
            Move::Pick(thing) => self.take(*thing),
            Move::Place(receptacle) => self.put(receptacle),
            Move::Open(receptacle) => self.open(receptacle),
            Move::Close(receptacle) => self.close(receptacle),
            Move::Ask(errand) => self.answer_at_worst(*errand),
            Move::Finish(_) => {}
        }
    }

    fn see_nothing(&mut self) {
        self.in_view.clear();
        self.numbered.clear();
        self.receptacles.clear();
    }

    fn effort(&self) -> u32 {
        self.cost_to_go().unwrap_or(u32::MAX)
    }

    /// The world in which it is the one that is meant.
    fn read_as_meant(&self, here: &ReceptacleId) -> Self {
        let mut found = self.clone();
        for errand in 0..found.errands.len() {
            if self.open_sources(errand).any(|id| id == here) {
                found.errands[errand].source = here.clone();
            }
            if self.open_destinations(errand).any(|id| id == here) {
                found.errands[errand].destination = here.clone();
            }
        }
        found.read.insert(here.clone());
        found
    }

    /// It is not the one that is meant, unless no other is left.
    fn read_at_worst(&mut self, here: &ReceptacleId) {
        for errand in 0..self.errands.len() {
            // Source and destination are two places.
            let worst =
                |among: Vec<ReceptacleId>, but: &ReceptacleId, closed: &BTreeSet<ReceptacleId>| {
                    let others = || among.iter().rev().filter(|id| *id != here && *id != but);
                    others()
                        .find(|id| closed.contains(*id))
                        .or_else(|| others().next())
                        .cloned()
                };
            let sources: Vec<ReceptacleId> = self.open_sources(errand).cloned().collect();
            let destinations: Vec<ReceptacleId> = self.open_destinations(errand).cloned().collect();
            if sources.contains(here) {
                let source = worst(sources, &self.errands[errand].destination, &self.closed);
                self.errands[errand].source = source.unwrap_or_else(|| here.clone());
            }
            if destinations.contains(here) {
                let destination = worst(destinations, &self.errands[errand].source, &self.closed);
                self.errands[errand].destination = destination.unwrap_or_else(|| here.clone());
            }
        }
        self.read.insert(here.clone());
    }

    /// Nothing new is there, unless it must be: then it is there, and where the words leave it
    /// open another one too.
    fn look_at_worst(&mut self, found: Option<ObjectIndex>) {
        let Some(here) = self.at.clone() else { return };
        self.read_at_worst(&here);
        self.see_nothing();
        if found.is_none() && !self.closed.contains(&here) {
            self.surveyed.insert(here.clone());
        }
        for errand in 0..self.errands.len() {
            let there = self
                .candidates(errand)
                .any(|thing| self.things[&thing].place.as_ref() == Some(&here));
            let gone = || {
                self.candidates(errand)
                    .any(|thing| self.taken.contains(&thing))
            };
            if self.source(errand) != Some(&here) || self.errands[errand].destination == here {
                continue;
            }
            if !there && !gone() {
                self.imagine(errand, 0, &here);
            }
            if self.errands[errand].vague && !self.settled && self.candidates(errand).count() < 2 {
                self.imagine(errand, 1, &here);
            }
        }
        let here =
            |(_, sighting): &(&ObjectIndex, &Sighting)| sighting.place.as_ref() == Some(&here);
        self.in_view = self
            .things
            .iter()
            .filter(here)
            .map(|(thing, _)| *thing)
            .collect();
        self.numbered = match found {
            Some(thing) => BTreeSet::from([thing]),
            None => self.in_view.clone(),
        };
    }

    /// A thing that was not seen yet.
    fn imagine(&mut self, errand: usize, number: u32, place: &ReceptacleId) {
        let fits = (0..self.errands.len())
            .map(|other| other == errand)
            .collect();
        let sighting = Sighting {
            place: Some(place.clone()),
            origin: Some(place.clone()),
            fits,
        };
        self.things
            .insert(ObjectIndex::MAX - 2 * errand as u32 - number, sighting);
    }

    /// What was taken is not what was meant.
    fn answer_at_worst(&mut self, errand: usize) {
        self.settled = true;
        let candidates: Vec<ObjectIndex> = self.candidates(errand).collect();
        let meant = candidates
            .iter()
            .copied()
            .find(|thing| !self.taken.contains(thing));
        let source = self.source(errand).cloned();
        if let Some(source) = source.filter(|_| meant.is_none()) {
            self.imagine(errand, 0, &source);
        }
        for thing in candidates {
            if let Some(fits) = self
                .things
                .get_mut(&thing)
                .and_then(|sighting| sighting.fits.get_mut(errand))
            {
                *fits = Some(thing) == meant;
            }
        }
    }
}
