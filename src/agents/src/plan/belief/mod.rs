//! What a competent agent knows in the middle of an episode, what it does next, and how many
//! decisions it needs at worst.
//!
//! It reads which of several like receptacles is meant before it relies on one, looks before it
//! picks, asks where several things fit, opens a destination while its hand is free, puts back what
//! was taken by mistake and closes what was opened. Never the truth: what the words of the
//! instruction mean is compared only with what was read or seen.

mod course;
mod imagine;
mod objection;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use reel_world::ReceptacleId;

pub use objection::{Objection, Presumption};

/// A thing that was seen, by a number of the agent's own: who follows things with the
/// eyes knows them again.
pub type ObjectIndex = u32;

/// One object to bring somewhere, as the words tell.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct DeliveryGoal {
    /// Where it may stand, before anything was read.
    pub sources: Vec<ReceptacleId>,
    /// The one of them that the words mean; it is known when it was read, or when no other is left.
    pub source: ReceptacleId,
    /// Where it may have to go, before anything was read.
    pub destinations: Vec<ReceptacleId>,
    /// The one of them that the words mean.
    pub destination: ReceptacleId,
    /// Whether the words leave open which object is meant.
    pub vague: bool,
}

/// What is known of a thing that was seen.
#[derive(Clone, PartialEq, Eq, Debug)]
struct Sighting {
    /// Where it is, as far as one knows; none: in the hand, or gone.
    place: Option<ReceptacleId>,
    /// Where it was seen first.
    origin: Option<ReceptacleId>,
    /// For each errand whether the words fit it, those of the answers included.
    fits: Vec<bool>,
}

/// What is in the image, or was told, after a call.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct PerceivedView {
    /// Things, with their places and whether the words fit them.
    pub objects: Vec<(ObjectIndex, Option<ReceptacleId>, Vec<bool>)>,
    /// Those of them that have a number.
    pub numbered: BTreeSet<ObjectIndex>,
    /// Receptacles that have a number.
    pub receptacles: BTreeSet<ReceptacleId>,
}

/// What a call did. One that failed and taught nothing is none of these.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum CallEffect {
    /// Stands at the receptacle.
    NavTo(ReceptacleId),
    /// Has the receptacles in view numbered, and so read.
    ShowReceptacles,
    /// Looked for one category.
    Find,
    /// Took stock of all that is where it stands.
    WalkAround,
    /// Stands before the thing.
    Gaze(ObjectIndex),
    /// Picked the object up and holds it.
    Pick(ObjectIndex),
    /// Put what it held there.
    Place(ReceptacleId),
    /// Opened the door of the receptacle.
    Open(ReceptacleId),
    /// Closed the door of the receptacle.
    Close(ReceptacleId),
    /// Was answered; whether the answer tells the meant object from the others that fit.
    Ask(bool),
    /// Found the door closed when it wanted to use what is behind it.
    DoorClosed(ReceptacleId),
    /// Found that there is no door to open or close.
    NoDoor(ReceptacleId),
    /// Found that this receptacle is of no use: nobody can stand there, or nothing be put there.
    Useless(ReceptacleId),
    /// Could not take the thing from there: it has to be looked for again.
    Lost(ObjectIndex),
}

/// What to do next, in the agent's own terms.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Move {
    /// Call `nav_to` to drive to the receptacle.
    NavTo(ReceptacleId),
    /// Call `show_receptacles` to number the receptacles in view.
    ShowReceptacles,
    /// `show_object_by_category`, of the category of that thing.
    Find(ObjectIndex),
    /// Call `walk_around` to survey the receptacle where the robot stands.
    WalkAround,
    /// Call `gaze_at` to stand before the object.
    Gaze(ObjectIndex),
    /// Call `pick` to take the object.
    Pick(ObjectIndex),
    /// Call `place` to put the held object on the receptacle.
    Place(ReceptacleId),
    /// Call `open` to open the door of the receptacle.
    Open(ReceptacleId),
    /// Call `close` to close the door of the receptacle.
    Close(ReceptacleId),
    /// `ask` which object this errand is about.
    Ask(usize),
    /// `finish`, and whether everything is done; else it gives up.
    Finish(bool),
}

/// What an agent knows.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Belief {
    errands: Vec<DeliveryGoal>,
    /// Receptacle where the robot stands; `None` before the first drive.
    at: Option<ReceptacleId>,
    held: Option<ObjectIndex>,
    /// Where it has been.
    visited: BTreeSet<ReceptacleId>,
    /// Receptacles whose look and name were brought together.
    read: BTreeSet<ReceptacleId>,
    /// Receptacles of which all that stands there is known.
    surveyed: BTreeSet<ReceptacleId>,
    /// Of no use, as it turned out.
    useless: BTreeSet<ReceptacleId>,
    /// Closed, as far as it knows.
    closed: BTreeSet<ReceptacleId>,
    /// Open, and closed at the start.
    opened: BTreeSet<ReceptacleId>,
    /// Receptacles that turned out to have no door.
    doorless: BTreeSet<ReceptacleId>,
    things: BTreeMap<ObjectIndex, Sighting>,
    /// Things that were in the hand.
    taken: BTreeSet<ObjectIndex>,
    in_view: BTreeSet<ObjectIndex>,
    numbered: BTreeSet<ObjectIndex>,
    receptacles: BTreeSet<ReceptacleId>,
    gazed: Option<ObjectIndex>,
    /// Things that it could not take when it tried.
    lost: BTreeSet<ObjectIndex>,
    /// Whether an answer told the object of the vague errand from the others.
    settled: bool,
    asks: u32,
}

impl Belief {
    /// Before the first call. `closed` are the receptacles that have a door, as far as one
    /// knows; all stand closed.
    pub fn new(errands: Vec<DeliveryGoal>, closed: BTreeSet<ReceptacleId>) -> Self {
        Self {
            errands,
            at: None,
            held: None,
            visited: BTreeSet::new(),
            read: BTreeSet::new(),
            surveyed: BTreeSet::new(),
            useless: BTreeSet::new(),
            closed,
            opened: BTreeSet::new(),
            doorless: BTreeSet::new(),
            things: BTreeMap::new(),
            taken: BTreeSet::new(),
            in_view: BTreeSet::new(),
            numbered: BTreeSet::new(),
            receptacles: BTreeSet::new(),
            gazed: None,
            lost: BTreeSet::new(),
            settled: false,
            asks: 0,
        }
    }

    /// Receptacle where the robot stands; `None` before the first drive.
    pub fn at(&self) -> Option<&ReceptacleId> {
        self.at.as_ref()
    }

    /// Takes in what is in view, without a call: before the first, or after one that failed.
    pub fn see(&mut self, view: &PerceivedView) {
        for (thing, place, fits) in &view.objects {
            let known = self.things.entry(*thing);
            let sighting = known.or_insert_with(|| Sighting {
                place: None,
                origin: place.clone(),
                fits: Vec::new(),
            });
            if self.held != Some(*thing) {
                sighting.place.clone_from(place);
            }
            sighting.fits.clone_from(fits);
        }
        self.in_view = view.objects.iter().map(|(thing, ..)| *thing).collect();
        self.numbered.clone_from(&view.numbered);
        self.receptacles.clone_from(&view.receptacles);
    }

    /// Takes in what a call did, and what is in view then.
    pub fn learn(&mut self, deed: &CallEffect, view: &PerceivedView) {
        let before = self.at.clone();
        self.see(view);
        match deed {
            CallEffect::NavTo(receptacle) => self.go(receptacle),
            CallEffect::ShowReceptacles => self.read.extend(view.receptacles.iter().cloned()),
            CallEffect::Find => self.read.extend(before),
            CallEffect::WalkAround => {
                let here =
                    |sighting: &Sighting| sighting.place.is_some() && sighting.place == before;
                for (thing, sighting) in &mut self.things {
                    if here(sighting) && !view.numbered.contains(thing) {
                        sighting.place = None;
                    }
                }
                self.read.extend(before.clone());
                // Behind a closed door there may be more.
                self.surveyed
                    .extend(before.filter(|here| !self.closed.contains(here)));
            }
            CallEffect::Gaze(thing) => self.gazed = Some(*thing),
            CallEffect::Pick(thing) => self.take(*thing),
            CallEffect::Place(receptacle) => self.put(receptacle),
            CallEffect::Open(receptacle) => self.open(receptacle),
            CallEffect::Close(receptacle) => self.close(receptacle),
            CallEffect::Ask(names_it) => {
                self.asks += 1;
                self.settled |= names_it;
            }
            CallEffect::DoorClosed(receptacle) => {
                self.closed.insert(receptacle.clone());
            }
            CallEffect::NoDoor(receptacle) => {
                self.closed.remove(receptacle);
                self.opened.remove(receptacle);
                self.doorless.insert(receptacle.clone());
            }
            CallEffect::Useless(receptacle) => {
                self.useless.insert(receptacle.clone());
                self.opened.remove(receptacle);
            }
            CallEffect::Lost(thing) => {
                self.gazed = None;
                self.numbered.remove(thing);
                self.in_view.remove(thing);
                self.lost.insert(*thing);
            }
        }
    }

    /// Changes what the words fit, after an answer.
    pub fn fits(&mut self, thing: ObjectIndex, fits: Vec<bool>) {
        if let Some(sighting) = self.things.get_mut(&thing) {
            sighting.fits = fits;
        }
    }

    fn go(&mut self, receptacle: &ReceptacleId) {
        self.at = Some(receptacle.clone());
        self.visited.insert(receptacle.clone());
        self.gazed = None;
    }

    fn take(&mut self, thing: ObjectIndex) {
        let here = self.at.clone();
        let fits = vec![false; self.errands.len()];
        let sighting = self.things.entry(thing).or_insert(Sighting {
            place: None,
            origin: here,
            fits,
        });
        sighting.place = None;
        self.held = Some(thing);
        self.taken.insert(thing);
        self.gazed = None;
        self.numbered.remove(&thing);
        self.in_view.remove(&thing);
    }

    fn put(&mut self, receptacle: &ReceptacleId) {
        if let Some(thing) = self.held.take()
            && let Some(sighting) = self.things.get_mut(&thing)
        {
            sighting.place = Some(receptacle.clone());
            sighting.origin.get_or_insert_with(|| receptacle.clone());
        }
        self.gazed = None;
    }

    fn open(&mut self, receptacle: &ReceptacleId) {
        self.closed.remove(receptacle);
        self.opened.insert(receptacle.clone());
        self.surveyed.remove(receptacle);
    }

    fn close(&mut self, receptacle: &ReceptacleId) {
        self.closed.insert(receptacle.clone());
        self.opened.remove(receptacle);
    }
}
