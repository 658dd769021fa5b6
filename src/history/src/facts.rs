//! What was done, in the terms in which claims are judged: receptacles and objects by
//! index, and how the world stood at each moment. Moment m is after m deeds. Never looks at
//! a text of the agent.

use std::collections::BTreeMap;

use reel_world::{DoorState, GraphEvent};

use crate::{MarkerFacts, StepFacts, grammar::Act, names::Names};

/// One step, with its receptacles and objects resolved to indices.
#[derive(Clone, Debug)]
pub(crate) struct Fact {
    pub(crate) step_facts: StepFacts,
    /// What kind of deed the tool is; none for no tool.
    pub(crate) act: Option<Act>,
    /// The receptacle it acted on, or would have.
    pub(crate) place: Option<usize>,
    /// The object it acted on, or would have.
    pub(crate) object: Option<usize>,
    /// The marker number it was given.
    pub(crate) marker: Option<u32>,
    /// Where the robot stood afterwards: the landmark, and the receptacle of what
    /// it looks at closely.
    pub(crate) at: Vec<usize>,
    /// Objects in view, or told.
    pub(crate) seen: Vec<usize>,
    /// Objects with a marker.
    pub(crate) marked: Vec<usize>,
    /// Receptacles with a marker.
    pub(crate) marked_places: Vec<usize>,
    /// Whether the hand held anything afterwards, known by index or not.
    holding: bool,
    pub(crate) held: Option<usize>,
}

impl Fact {
    pub(crate) fn ok(&self) -> bool {
        self.step_facts.error.is_none()
    }

    pub(crate) fn error(&self) -> &str {
        self.step_facts.error.as_deref().unwrap_or("")
    }

    /// Whether it came to something: looking in vain is looking too.
    pub(crate) fn done(&self) -> bool {
        self.ok() || self.found_nothing()
    }

    pub(crate) fn found_nothing(&self) -> bool {
        self.error() == "nothing_found"
            && matches!(self.act, Some(Act::Search | Act::Explore | Act::Mark))
    }
}

/// Everything that was done, and how the world stood.
pub(crate) struct Facts {
    pub(crate) all: Vec<Fact>,
    /// By object: from which moment on it is where (none: in the hand, or unknown).
    whereabouts: Vec<Vec<(usize, Option<usize>)>>,
    /// By receptacle: from which moment on its door stands how.
    doors: Vec<Vec<(usize, DoorState)>>,
    landmark: Option<usize>,
    markers: Vec<MarkerFacts>,
}

impl Facts {
    pub(crate) fn new(names: &Names) -> Self {
        let setting = names.setting();
        let place = |id: &Option<String>| id.as_deref().and_then(|id| names.receptacle(id));
        Self {
            all: Vec::new(),
            whereabouts: setting
                .things
                .iter()
                .map(|thing| vec![(0, place(&thing.place))])
                .collect(),
            doors: setting
                .places
                .iter()
                .map(|place| place.door.iter().map(|door| (0, *door)).collect())
                .collect(),
            landmark: None,
            markers: Vec::new(),
        }
    }

    /// How many deeds there are: the moment now.
    pub(crate) fn now(&self) -> usize {
        self.all.len()
    }

    /// The step of a deed.
    pub(crate) fn step(&self, index: usize) -> Option<u32> {
        self.all.get(index).map(|fact| fact.step_facts.step)
    }

    /// Where an object was at a moment.
    pub(crate) fn place_of(&self, thing: usize, moment: usize) -> Option<usize> {
        at(&self.whereabouts[thing], moment).copied().flatten()
    }

    /// How a door stood at a moment; none where there is none.
    pub(crate) fn door(&self, place: usize, moment: usize) -> Option<DoorState> {
        at(&self.doors[place], moment).copied()
    }

    /// What the hand held at a moment.
    pub(crate) fn held(&self, moment: usize) -> Option<usize> {
        self.all.get(moment.checked_sub(1)?)?.held
    }

    /// Whether the hand held anything at a moment, known by index or not.
    pub(crate) fn holds(&self, moment: usize) -> bool {
        moment
            .checked_sub(1)
            .and_then(|index| self.all.get(index))
            .is_some_and(|fact| fact.holding)
    }

    /// Appends a step and updates the tracked state of the world.
    pub(crate) fn push(&mut self, names: &Names, deed: StepFacts) {
        let moment = self.all.len() + 1;
        let act = act_of(&deed.tool);
        let place = |id: &Option<String>| id.as_deref().and_then(|id| names.receptacle(id));
        let thing = |key: &Option<String>| key.as_deref().and_then(|key| names.object(key));
        let takes_marker = matches!(
            act,
            Some(Act::Gaze | Act::Pick | Act::Place | Act::Open | Act::Close)
        );
        let marker = deed
            .argument
            .as_deref()
            .filter(|_| takes_marker)
            .and_then(|argument| argument.trim().parse().ok());
        let meant = self.markers.iter().find(|mark| Some(mark.number) == marker);
        let aimed_place = match act {
            Some(Act::Go) => place(&deed.argument),
            Some(Act::Explore) => self.landmark,
            _ => meant.and_then(|mark| place(&mark.receptacle)),
        };
        let aimed_thing = meant
            .and_then(|mark| thing(&mark.object))
            .filter(|_| act != Some(Act::Place));
        let acted_on = thing(&deed.object).or(aimed_thing);
        let before = moment - 1;
        let held_before = self.held(before);
        for change in &deed.changes {
            self.change(names, change, moment);
        }
        let receptacle = place(&deed.receptacle).or(aimed_place);
        if deed.error.is_none() {
            self.landmark = match act {
                Some(Act::Go) => receptacle,
                Some(Act::Gaze) => receptacle.or(self.landmark),
                _ => self.landmark,
            };
        }
        let near = match act {
            Some(Act::Gaze | Act::Pick) if deed.error.is_none() => {
                acted_on.and_then(|thing| self.place_of(thing, before))
            }
            _ => None,
        };
        let seen: Vec<usize> = deed
            .seen
            .iter()
            .filter_map(|key| names.object(key))
            .collect();
        let marked = deed
            .markers
            .iter()
            .filter_map(|mark| thing(&mark.object))
            .collect();
        let marked_places = deed
            .markers
            .iter()
            .filter_map(|mark| place(&mark.receptacle))
            .collect();
        let holding = match act {
            _ if names.setting().complete => deed.held.is_some(),
            Some(Act::Pick) if deed.error.is_none() => true,
            Some(Act::Place) if deed.error.is_none() => false,
            _ => deed.held.is_some() || self.holds(before),
        };
        self.markers.clone_from(&deed.markers);
        self.all.push(Fact {
            act,
            place: receptacle,
            object: if act == Some(Act::Place) {
                acted_on.or(held_before)
            } else {
                acted_on
            },
            marker,
            at: self.landmark.into_iter().chain(near).collect(),
            seen,
            marked,
            marked_places,
            holding,
            held: thing(&deed.held),
            step_facts: deed,
        });
    }

    fn change(&mut self, names: &Names, change: &GraphEvent, moment: usize) {
        let place = names.receptacle(change.receptacle().as_str());
        match change {
            GraphEvent::Door { to, .. } => {
                if let Some(place) = place {
                    self.doors[place].push((moment, *to));
                }
            }
            GraphEvent::Add { object, .. } | GraphEvent::Remove { object, .. } => {
                let Some(thing) = names.object(object.as_str()) else {
                    return;
                };
                let added = matches!(change, GraphEvent::Add { .. });
                let list = &mut self.whereabouts[thing];
                // an object that moves leaves one place and comes to another in the same
                // deed, in any order
                if added || list.last().is_none_or(|(since, _)| *since != moment) {
                    list.push((moment, place.filter(|_| added)));
                }
            }
        }
    }

    /// Receptacles that were driven to, and those that were gazed at besides.
    pub(crate) fn visited(&self) -> (Vec<usize>, Vec<usize>) {
        let mut counts: BTreeMap<usize, bool> = BTreeMap::new();
        for fact in self.all.iter().filter(|fact| fact.ok()) {
            match (fact.act, fact.place) {
                (Some(Act::Go), Some(place)) => *counts.entry(place).or_default() = true,
                (Some(Act::Gaze), Some(place)) => *counts.entry(place).or_default() |= false,
                _ => {}
            }
        }
        (
            counts
                .iter()
                .filter(|(_, driven)| **driven)
                .map(|(place, _)| *place)
                .collect(),
            counts.into_keys().collect(),
        )
    }
}

fn at<T>(list: &[(usize, T)], moment: usize) -> Option<&T> {
    list.iter()
        .rev()
        .find(|(since, _)| *since <= moment)
        .map(|(_, value)| value)
}

fn act_of(tool: &str) -> Option<Act> {
    Some(match tool {
        "nav_to" => Act::Go,
        "walk_around" => Act::Explore,
        "show_object_by_category" => Act::Search,
        "show_receptacles" => Act::Mark,
        "gaze_at" => Act::Gaze,
        "pick" => Act::Pick,
        "place" => Act::Place,
        "open" => Act::Open,
        "close" => Act::Close,
        "ask" => Act::Ask,
        "finish" => Act::Finish,
        _ => return None,
    })
}
