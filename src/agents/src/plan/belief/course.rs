//! What a competent agent does next with what it knows. One move at a time; never what comes of it.

use reel_world::ReceptacleId;

use super::{Belief, DeliveryGoal, Move, ObjectIndex};

/// Questions after which it takes what fits best.
const ASKS_MAX: u32 = 3;

impl Belief {
    /// Chooses the next move from what is believed so far.
    pub fn next(&self) -> Move {
        if let Some(errand) = self.doubtful() {
            return Move::Ask(errand);
        }
        if let Some(held) = self.held {
            return self.bring(held);
        }
        let undone = (0..self.errands.len()).find(|errand| !self.is_done(*errand));
        if let Some(errand) = undone {
            return self
                .open_destination(errand)
                .unwrap_or_else(|| self.fetch(errand));
        }
        if let Some((thing, place)) = self.displaced() {
            return self.take_from(thing, &place);
        }
        match self
            .opened
            .iter()
            .find(|id| self.at.as_ref() == Some(id))
            .or_else(|| self.opened.first())
        {
            Some(door) => self.at_number(door, Move::Close(door.clone())),
            None => Move::Finish(true),
        }
    }

    /// The errand whose object is not settled although something was taken for it that is not the
    /// only one to fit.
    fn doubtful(&self) -> Option<usize> {
        let taken = |errand: &usize| {
            let one = self
                .taken
                .iter()
                .any(|thing| self.may_be(*thing, *errand) && self.moved(*thing));
            one && self.wants_to_ask(*errand)
        };
        (0..self.errands.len()).find(taken)
    }

    fn moved(&self, thing: ObjectIndex) -> bool {
        let sighting = &self.things[&thing];
        self.held == Some(thing) || sighting.place != sighting.origin
    }

    /// Whether the words leave open which thing is meant. Even where one alone seems to fit,
    /// they may mean another.
    pub(super) fn wants_to_ask(&self, errand: usize) -> bool {
        self.errands[errand].vague && !self.settled && self.asks < ASKS_MAX
    }

    /// Whether a thing may be the one that is meant: the words fit, and it comes from where the
    /// words say, as far as read.
    pub(super) fn may_be(&self, thing: ObjectIndex, errand: usize) -> bool {
        let Some(sighting) = self.things.get(&thing) else {
            return false;
        };
        let from = |origin: &ReceptacleId| self.open_sources(errand).any(|id| id == origin);
        sighting.fits.get(errand) == Some(&true) && sighting.origin.as_ref().is_some_and(from)
    }

    pub(super) fn candidates(&self, errand: usize) -> impl Iterator<Item = ObjectIndex> {
        self.things
            .keys()
            .copied()
            .filter(move |thing| self.may_be(*thing, errand))
    }

    /// The sources that were not read to be others.
    pub(super) fn open_sources(&self, errand: usize) -> impl Iterator<Item = &ReceptacleId> {
        let DeliveryGoal {
            sources, source, ..
        } = &self.errands[errand];
        let read = self.read.contains(source);
        sources.iter().filter(move |id| {
            if read {
                *id == source
            } else {
                !self.read.contains(*id)
            }
        })
    }

    /// The source, where it is known which one it is.
    pub(super) fn source(&self, errand: usize) -> Option<&ReceptacleId> {
        only(self.open_sources(errand))
    }

    pub(super) fn open_destinations(&self, errand: usize) -> impl Iterator<Item = &ReceptacleId> {
        let DeliveryGoal {
            destinations,
            destination,
            ..
        } = &self.errands[errand];
        let read = self.read.contains(destination);
        destinations.iter().filter(move |id| {
            if read {
                *id == destination
            } else {
                !self.read.contains(*id)
            }
        })
    }

    pub(super) fn destination(&self, errand: usize) -> Option<&ReceptacleId> {
        only(self.open_destinations(errand))
    }

    fn is_done(&self, errand: usize) -> bool {
        let Some(destination) = self.destination(errand) else {
            return false;
        };
        let there = |thing: ObjectIndex| {
            self.taken.contains(&thing) && self.things[&thing].place.as_ref() == Some(destination)
        };
        self.candidates(errand).any(there)
    }

    /// A thing that was taken by mistake and stands elsewhere than before.
    fn displaced(&self) -> Option<(ObjectIndex, ReceptacleId)> {
        let stray = |thing: &&ObjectIndex| self.moved(**thing) && self.errand_of(**thing).is_none();
        let found = self
            .taken
            .iter()
            .filter(stray)
            .find_map(|thing| Some((*thing, self.things[thing].place.clone()?)));
        found.filter(|(_, place)| !self.useless.contains(place))
    }

    /// The errand that a taken thing is for: the first undone one that it may be meant by, or
    /// the one it did.
    fn errand_of(&self, thing: ObjectIndex) -> Option<usize> {
        let place = self.things[&thing].place.as_ref();
        let fits = |errand: &usize| self.may_be(thing, *errand);
        let did =
            |errand: &usize| fits(errand) && place.is_some() && self.destination(*errand) == place;
        let all = || 0..self.errands.len();
        all()
            .find(did)
            .or_else(|| all().find(|errand| fits(errand) && !self.is_done(*errand)))
    }

    /// Brings what it holds where it belongs.
    fn bring(&self, held: ObjectIndex) -> Move {
        let origin = || {
            self.things[&held]
                .origin
                .clone()
                .or_else(|| self.at.clone())
        };
        let to = match self.errand_of(held) {
            None => origin(),
            Some(errand) => match self.destination(errand) {
                // A hand must be free to open a door.
                Some(destination) if self.closed.contains(destination) => origin(),
                Some(destination) => Some(destination.clone()),
                None => self.next_unread(self.open_destinations(errand)).cloned(),
            },
        };
        match to.filter(|to| !self.useless.contains(to)) {
            Some(to) => self.at_number(&to, Move::Place(to.clone())),
            None => Move::Finish(false),
        }
    }

    /// Where there is a door at the destination it is opened before the hand is full.
    fn open_destination(&self, errand: usize) -> Option<Move> {
        let is_closed =
            |id: &&ReceptacleId| self.closed.contains(*id) && !self.useless.contains(*id);
        self.open_destinations(errand)
            .any(|id| is_closed(&id))
            .then_some(())?;
        match self.destination(errand) {
            Some(destination) => Some(self.at_number(destination, Move::Open(destination.clone()))),
            None => self
                .next_unread(self.open_destinations(errand))
                .map(|to| self.at_number(to, Move::ShowReceptacles)),
        }
    }

    fn fetch(&self, errand: usize) -> Move {
        let source = self.source(errand);
        let known = source.and_then(|_| {
            let mut found: Vec<(ObjectIndex, ReceptacleId)> = self
                .candidates(errand)
                .filter_map(|thing| Some((thing, self.things[&thing].place.clone()?)))
                .collect();
            // What is at hand comes first, and last what could not be taken when it tried.
            let at_hand =
                |thing: &ObjectIndex| (self.gazed != Some(*thing), !self.numbered.contains(thing));
            found.sort_by_key(|(thing, _)| (self.lost.contains(thing), at_hand(thing)));
            found.into_iter().next()
        });
        if let Some((thing, place)) = known {
            let must_survey =
                self.errands[errand].vague && !self.surveyed.contains(&place) && !self.settled;
            if must_survey && self.at.as_ref() == Some(&place) && !self.closed.contains(&place) {
                return Move::WalkAround;
            }
            if self.at.as_ref() == Some(&place) && self.wants_to_ask(errand) && !must_survey {
                return Move::Ask(errand);
            }
            return self.take_from(thing, &place);
        }
        // Nothing there is called what is wanted: then one does not know what is meant.
        if source.is_some_and(|source| self.surveyed.contains(source)) && self.wants_to_ask(errand)
        {
            return Move::Ask(errand);
        }
        let place = source.filter(|source| !self.surveyed.contains(*source));
        let place = place.or_else(|| {
            self.next_unread(self.open_sources(errand))
                .filter(|_| source.is_none())
        });
        match place.filter(|place| !self.useless.contains(*place)) {
            Some(place) => self.look_on(place, errand),
            // It must be there, and was not seen: there may be a door that one did not expect.
            None => match source.filter(|source| self.may_have_door(source)) {
                Some(source) => self.at_number(source, Move::Open(source.clone())),
                None => Move::Finish(false),
            },
        }
    }

    fn may_have_door(&self, receptacle: &ReceptacleId) -> bool {
        let known = [&self.opened, &self.doorless, &self.useless];
        !known.iter().any(|set| set.contains(receptacle))
    }

    /// Looks for the errand's object there.
    fn look_on(&self, place: &ReceptacleId, errand: usize) -> Move {
        if self.at.as_ref() != Some(place) {
            return Move::NavTo(place.clone());
        }
        if self.closed.contains(place) {
            return self.at_number(place, Move::Open(place.clone()));
        }
        let in_view = |thing: &ObjectIndex| {
            self.in_view.contains(thing) && self.things[thing].place.as_ref() == Some(place)
        };
        match self.candidates(errand).find(in_view) {
            Some(thing) if !self.errands[errand].vague => Move::Find(thing),
            _ => Move::WalkAround,
        }
    }

    /// Takes a thing that is known to be there.
    fn take_from(&self, thing: ObjectIndex, place: &ReceptacleId) -> Move {
        if self.at.as_ref() != Some(place) {
            return Move::NavTo(place.clone());
        }
        if self.closed.contains(place) {
            return self.at_number(place, Move::Open(place.clone()));
        }
        match () {
            () if self.numbered.contains(&thing) && self.gazed == Some(thing) => Move::Pick(thing),
            () if self.numbered.contains(&thing) => Move::Gaze(thing),
            () if self.in_view.contains(&thing) => Move::Find(thing),
            () => Move::WalkAround,
        }
    }

    /// Goes to the receptacle and gets it numbered before the move that wants its number.
    fn at_number(&self, receptacle: &ReceptacleId, then: Move) -> Move {
        if self.at.as_ref() != Some(receptacle) {
            Move::NavTo(receptacle.clone())
        } else if self.receptacles.contains(receptacle) {
            then
        } else {
            Move::ShowReceptacles
        }
    }

    /// Of several the one it stands at, else the first.
    fn next_unread<'a>(
        &'a self,
        among: impl Iterator<Item = &'a ReceptacleId>,
    ) -> Option<&'a ReceptacleId> {
        let useful: Vec<&ReceptacleId> = among.filter(|id| !self.useless.contains(*id)).collect();
        let here = useful.iter().find(|id| self.at.as_ref() == Some(**id));
        here.or(useful.first()).copied()
    }
}

fn only<'a>(mut among: impl Iterator<Item = &'a ReceptacleId>) -> Option<&'a ReceptacleId> {
    let first = among.next()?;
    among.next().is_none().then_some(first)
}
