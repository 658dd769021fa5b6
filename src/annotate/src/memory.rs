//! What the agent could know before a decision: everything that calls, outcomes, images and
//! replies told so far, and nothing else. Never looks ahead.

use std::collections::BTreeMap;

use reel_world::{ErrorCode, language};

use crate::{
    english,
    step::{Call, MarkedItem, ObservedObject, Step},
    task::PublicTask,
};

/// What the agent can know before a decision, from earlier calls and outcomes.
#[derive(Debug)]
pub(crate) struct Memory<'a> {
    pub task: &'a PublicTask,
    /// How many decisions were made.
    pub step: usize,
    /// Where the robot stands.
    pub at: Option<&'a str>,
    /// Every place it went to, in order.
    pub visited: Vec<&'a str>,
    /// Markers after the last call: each number and what it stands for.
    pub markers: Vec<(u32, MarkedItem<'a>)>,
    /// What the last image or inventory showed.
    pub in_view: Vec<ObservedObject<'a>>,
    /// Everything that was ever seen.
    pub observed: Vec<ObservedObject<'a>>,
    /// Keys of what was marked when the robot searched for what shall be moved, in the
    /// words of the instruction.
    pub matched: Vec<&'a str>,
    /// What is in the hand.
    pub held: Option<ObservedObject<'a>>,
    /// From where it was taken, where that is known.
    pub held_from: Option<&'a str>,
    /// What was put where, the last one last.
    pub placed: Vec<(ObservedObject<'a>, &'a str)>,
    /// Doors that were moved: whether they are open.
    pub doors: BTreeMap<&'a str, bool>,
    /// Places whose door was found closed.
    pub shut: Vec<&'a str>,
    /// What the user said.
    pub replies: Vec<&'a str>,
    /// Whether the user was asked.
    pub asked: bool,
    pub last: Option<Last<'a>>,
    /// How often the last call was made in a row without success.
    pub failures_in_a_row: usize,
}

/// The last call, with its error code if it failed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Last<'a> {
    pub call: Call<'a>,
    /// How it failed, if it did.
    pub error: Option<ErrorCode>,
}

impl<'a> Memory<'a> {
    /// Before the first decision.
    pub fn new(task: &'a PublicTask) -> Self {
        Memory {
            task,
            step: 0,
            at: None,
            visited: Vec::new(),
            markers: Vec::new(),
            in_view: Vec::new(),
            observed: Vec::new(),
            matched: Vec::new(),
            held: None,
            held_from: None,
            placed: Vec::new(),
            doors: BTreeMap::new(),
            shut: Vec::new(),
            replies: Vec::new(),
            asked: false,
            last: None,
            failures_in_a_row: 0,
        }
    }

    /// Takes in what a decision came to.
    pub fn learn(&mut self, step: &'a Step<'a>) {
        let call = step.call();
        let target = self.marked(call);
        let again = self.last.is_some_and(|last| last.call == call);
        match step.error {
            None => {
                self.failures_in_a_row = 0;
                self.succeed(step, target);
            }
            Some(code) => {
                self.failures_in_a_row = if again { self.failures_in_a_row + 1 } else { 1 };
                if let (ErrorCode::DoorClosed, Some(MarkedItem::Receptacle(id))) = (code, target) {
                    self.shut.push(id);
                }
            }
        }
        self.markers.clone_from(&step.markers);
        self.held = step.held;
        self.last = Some(Last {
            call,
            error: step.error,
        });
        self.step += 1;
    }

    fn succeed(&mut self, step: &'a Step<'a>, target: Option<MarkedItem<'a>>) {
        let place = match target {
            Some(MarkedItem::Receptacle(id)) => Some(id),
            _ => step.receptacle,
        };
        match step.tool {
            "nav_to" => {
                self.at = step.receptacle.or(step.argument.as_deref());
                self.visited.extend(self.at);
            }
            "gaze_at" => {
                if let Some(MarkedItem::Receptacle(id)) = target {
                    self.at = Some(id);
                    self.visited.push(id);
                }
            }
            "show_object_by_category"
                if language::quotes(&self.task.object, step.call().argument) =>
            {
                self.matched
                    .extend(step.markers.iter().filter_map(|(_, marked)| match marked {
                        MarkedItem::Object(thing) => Some(thing.key),
                        MarkedItem::Receptacle(_) => None,
                    }));
            }
            "pick" => self.held_from = step.receptacle,
            "place" => self.placed.extend(self.held.zip(place)),
            "open" => self.doors.extend(place.map(|id| (id, true))),
            "close" => self.doors.extend(place.map(|id| (id, false))),
            "ask" => {
                self.asked = true;
                self.replies.extend(step.reply);
            }
            _ => {}
        }
        if !["ask", "finish", "list_receptacles", "list_tasks"].contains(&step.tool) {
            self.in_view.clone_from(&step.visible);
            for thing in &step.visible {
                if !self.observed.contains(thing) {
                    self.observed.push(*thing);
                }
            }
        }
    }

    /// What the number of a call stands for.
    pub fn marked(&self, call: Call<'_>) -> Option<MarkedItem<'a>> {
        let number = call.marker()?;
        self.markers
            .iter()
            .find(|(marker, _)| *marker == number)
            .map(|(_, marked)| *marked)
    }

    /// Iterates over the markers that stand for objects.
    pub fn numbered(&self) -> impl Iterator<Item = (u32, ObservedObject<'a>)> {
        self.markers
            .iter()
            .filter_map(|(number, marked)| match marked {
                MarkedItem::Object(thing) => Some((*number, *thing)),
                MarkedItem::Receptacle(_) => None,
            })
    }

    /// Whether a thing may be the one to move, by the instruction and what the user said.
    pub fn may_be_meant(&self, thing: &ObservedObject<'_>) -> bool {
        match self
            .replies
            .iter()
            .rev()
            .find(|reply| language::names_object(reply))
        {
            Some(reply) => {
                thing.fits(reply, None)
                    && (self.fits_instruction(thing) || language::quotes(reply, thing.category))
            }
            None => self.fits_instruction(thing),
        }
    }

    /// Things seen that fit the instruction, whatever was said since.
    pub fn candidates(&self) -> Vec<ObservedObject<'a>> {
        self.observed
            .iter()
            .filter(|thing| self.fits_instruction(thing))
            .copied()
            .collect()
    }

    fn fits_instruction(&self, thing: &ObservedObject<'_>) -> bool {
        self.matched.contains(&thing.key)
            || thing.fits(&self.task.instruction, self.task.purpose.as_deref())
    }

    /// Whether what shall be moved lies where it shall go, as far as one can tell.
    pub fn is_done(&self) -> bool {
        let right = |(thing, place): &&(ObservedObject<'_>, &str)| {
            self.task.destination.may_be(place)
                && self.may_be_meant(thing)
                && self.held.is_none_or(|held| held.key != thing.key)
        };
        self.placed.iter().filter(right).count() >= self.task.moves
    }

    /// Whether the hand holds what shall be moved.
    pub fn holds_it(&self) -> bool {
        self.held.is_some_and(|held| self.may_be_meant(&held))
    }

    /// Whether a place has a door that is shut, as far as one knows: some kinds of furniture have
    /// one as a rule.
    pub fn wants_opening(&self, id: &str) -> bool {
        let usual = self.is_of_kind(
            id,
            &[
                "refrigerator",
                "fridge",
                "microwave",
                "oven",
                "dishwasher",
                "wardrobe",
                "washing machine",
            ],
        );
        self.doors
            .get(id)
            .map_or(usual || self.shut.contains(&id), |open| !open)
    }

    /// Whether a place may have a door that has to be opened.
    pub fn may_have_a_door(&self, id: &str) -> bool {
        self.wants_opening(id)
            || (!self.doors.contains_key(id)
                && self.is_of_kind(id, &["cabinet", "cupboard", "closet", "drawer"]))
    }

    fn is_of_kind(&self, id: &str, kinds: &[&str]) -> bool {
        self.task
            .receptacle(id)
            .is_some_and(|place| kinds.contains(&place.kind().as_str()))
    }
}

/// A thing by its looks: `large beige oval bread`, or by its category.
pub(crate) fn appearance(thing: &ObservedObject<'_>) -> String {
    english::noun(thing.caption.unwrap_or(thing.category))
}

/// Its looks, with the category where they do not say it.
pub(crate) fn description(thing: &ObservedObject<'_>) -> String {
    let looks = appearance(thing);
    if language::quotes(&looks, thing.category) {
        looks
    } else {
        format!("{looks} ({})", english::noun(thing.category))
    }
}
