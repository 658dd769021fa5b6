//! What a course is made of: stretches in which the oracle acts on a belief, and single deeds
//! that the fault or the detour wants. Turns a deed into a call for the moment it is due.
//! Never decides which come.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use reel_episode::Privileged;
use reel_world::{
    InstanceId, ObjectInstance, ReceptacleId, Task, Tool, ToolCall,
    record::{Marker, MarkerTarget},
};
use serde_json::{Value, json};

use crate::{PolicyContext, oracle::OracleOptions, random};

/// One stretch of a course.
#[derive(Clone, Debug)]
pub(super) enum PlanSegment {
    /// The oracle acts, believing this task, until it comes to that point (which it does not pass).
    Follow {
        task: Arc<Task>,
        options: OracleOptions,
        until: Until,
    },
    /// The deeds in turn, so many in all; none: until the horizon.
    Do {
        calls: Vec<ScriptedCall>,
        times: Option<usize>,
    },
    /// The fault of this index begins with the next call.
    Begin(usize),
    /// The fault of this index is corrected from here on.
    Repaired(usize),
    /// The History claims this from now on.
    Claim(String),
    /// It does so no more.
    Unclaim,
    /// What the next calls are made for, in the agent's words.
    Think(String),
    /// What is taken for the target from here on; none: the target. Only in a draft.
    Object(Option<ObjectInstance>),
    /// What is taken for the destination from here on; none: the destination. Only in a draft.
    Place(Option<ReceptacleId>),
    /// The habits from here on. Only in a draft.
    Options(OracleOptions),
    /// The oracle as far as that, on what is believed then. Only in a draft.
    Go(Until),
}

impl PlanSegment {
    /// A segment that makes one call once.
    pub fn one(deed: ScriptedCall) -> PlanSegment {
        PlanSegment::Do {
            calls: vec![deed],
            times: Some(1),
        }
    }

    /// These deeds, once each.
    pub fn each(deeds: Vec<ScriptedCall>) -> PlanSegment {
        let times = Some(deeds.len());
        PlanSegment::Do {
            calls: deeds,
            times,
        }
    }
}

/// How far the oracle goes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum Until {
    /// Nothing was done yet.
    Start,
    /// It stands where it wants to look for the object.
    Looking,
    /// It asked, or is about to pick.
    Asked,
    /// It is about to pick.
    Found,
    /// It has what it wanted in its hand.
    Held,
    /// It stands where it wants to place.
    AtDestination,
    /// It is about to finish.
    Placed,
    /// The oracle calls `finish`, which ends the episode.
    End,
}

/// A single call to make, resolved to arguments when it is due.
#[derive(Clone, Debug)]
pub(super) enum ScriptedCall {
    /// A call whose arguments are known.
    Call(Tool),
    /// Something that is no call of a tool, or one with arguments that nothing fits.
    Raw(ToolCall),
    /// Output that is not a valid tool call, drawn from the random stream.
    Nonsense,
    /// `gaze_at` something on the current map.
    Gaze,
    /// `pick` the first number of the current map.
    PickAny,
    /// `pick` a piece of furniture on the current map.
    PickFurniture,
    /// `open` furniture that has no door.
    OpenDoorless,
    /// `place` on this receptacle, by its number; by some number of the map where it has none.
    PlaceOn(ReceptacleId),
    /// By a number that the object had on an earlier map; where `other`, one that now stands for
    /// another object, else one that stands for nothing.
    Old {
        object: InstanceId,
        tool: StaleMarkerTool,
        other: bool,
    },
    /// Looks, unless the object has a number of an earlier map that now stands for another one.
    Renumber { object: InstanceId, tool: Tool },
    /// `pick` by a number that is on no map yet (one too high), as one misreads it.
    Misread,
    /// A call that succeeds and leads nowhere.
    Idle,
}

/// What is done with a number of an earlier map.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum StaleMarkerTool {
    Gaze,
    Pick,
    Place,
}

/// The numbers a policy remembers: the last maps of objects and of furniture
/// before the current one.
#[derive(Clone, Debug, Default)]
pub(super) struct MarkerMemory {
    maps: Vec<Vec<Marker>>,
}

impl MarkerMemory {
    /// Takes in the current map.
    pub fn learn(&mut self, markers: &[Marker]) {
        if !markers.is_empty() && self.maps.last().is_none_or(|last| last != markers) {
            self.maps.push(markers.to_vec());
        }
    }

    /// A number the object had on an earlier map, and which now stands for nothing; where
    /// `other`, for another object.
    pub fn old_number(&self, object: &InstanceId, current: &[Marker], other: bool) -> Option<u32> {
        let is_it =
            |marker: &&Marker| matches!(&marker.target, MarkerTarget::Object(id) if id == object);
        let olds = self
            .maps
            .iter()
            .rev()
            .filter_map(|map| map.iter().find(is_it))
            .map(|marker| marker.id);
        let mut olds = olds.chain(self.object_numbers().filter(|_| !other));
        olds.find(
            |old| match current.iter().find(|marker| marker.id == *old) {
                Some(Marker {
                    target: MarkerTarget::Object(id),
                    ..
                }) => other && id != object,
                Some(_) => false,
                None => !other,
            },
        )
    }

    /// A furniture number of an earlier map that stands for nothing now.
    pub fn old_furniture(&self, current: &[Marker]) -> Option<u32> {
        let numbers = self.maps.iter().rev().flatten().map(|marker| marker.id);
        numbers
            .into_iter()
            .find(|old| current.iter().all(|marker| marker.id != *old))
    }

    fn object_numbers(&self) -> impl Iterator<Item = u32> {
        let objects = self
            .maps
            .iter()
            .rev()
            .flatten()
            .filter(|marker| matches!(marker.target, MarkerTarget::Object(_)));
        objects.map(|marker| marker.id)
    }
}

impl ScriptedCall {
    /// The call, or none where the moment has nothing for it.
    pub fn call(
        &self,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
        memory: &MarkerMemory,
        rng: &mut ChaCha8Rng,
    ) -> Option<ToolCall> {
        let current = truth.markers;
        let furniture = || {
            current
                .iter()
                .filter(|marker| matches!(marker.target, MarkerTarget::Receptacle(_)))
        };
        let tool = match self {
            ScriptedCall::Call(tool) => tool.clone(),
            ScriptedCall::Raw(call) => return Some(call.clone()),
            ScriptedCall::Nonsense => return Some(nonsense(context, rng)),
            ScriptedCall::Gaze => Tool::GazeAt {
                marker: any(rng, current)?,
            },
            ScriptedCall::PickAny => Tool::Pick {
                marker: current.first().map_or(1, |marker| marker.id),
            },
            ScriptedCall::PickFurniture => Tool::Pick {
                marker: furniture().next()?.id,
            },
            ScriptedCall::OpenDoorless => {
                let doorless = |marker: &&Marker| match &marker.target {
                    MarkerTarget::Receptacle(id) => truth.graph.door(id).is_none(),
                    MarkerTarget::Object(_) => true,
                };
                Tool::Open {
                    marker: current.iter().find(doorless)?.id,
                }
            }
            ScriptedCall::PlaceOn(receptacle) => {
                let is_it = |marker: &&Marker| matches!(&marker.target, MarkerTarget::Receptacle(id) if id == receptacle);
                Tool::Place {
                    marker: current
                        .iter()
                        .find(is_it)
                        .or(furniture().next())
                        .map_or(1, |marker| marker.id),
                }
            }
            ScriptedCall::Old {
                object,
                tool: StaleMarkerTool::Gaze,
                other,
            } => Tool::GazeAt {
                marker: memory.old_number(object, current, *other)?,
            },
            ScriptedCall::Old {
                object,
                tool: StaleMarkerTool::Pick,
                other,
            } => Tool::Pick {
                marker: memory.old_number(object, current, *other)?,
            },
            ScriptedCall::Old {
                tool: StaleMarkerTool::Place,
                ..
            } => Tool::Place {
                marker: memory.old_furniture(current)?,
            },
            ScriptedCall::Renumber { object, .. }
                if memory.old_number(object, current, true).is_some() =>
            {
                return None;
            }
            ScriptedCall::Renumber { tool, .. } => tool.clone(),
            ScriptedCall::Misread => Tool::Pick {
                marker: current.iter().map(|marker| marker.id).max()? + 1,
            },
            ScriptedCall::Idle => idle(truth, rng),
        };
        Some(tool.to_call())
    }
}

fn any(rng: &mut ChaCha8Rng, markers: &[Marker]) -> Option<u32> {
    random::choose(rng, markers).map(|marker| marker.id)
}

/// Looks once more at what is here, or drives up to it again: it succeeds where
/// something is in view.
fn idle(truth: &Privileged<'_>, rng: &mut ChaCha8Rng) -> Tool {
    let gaze = any(rng, truth.markers);
    let stands_by_objects = truth.landmark.is_some_and(|id| {
        truth.graph.door(id) != Some(reel_world::DoorState::Closed)
            && !truth.graph.objects_on(id).is_empty()
    });
    match (random::below(rng, 4), gaze, truth.landmark) {
        (0 | 1, Some(marker), _) => Tool::GazeAt { marker },
        (2, ..) if stands_by_objects => Tool::WalkAround,
        (2, _, Some(here)) => Tool::NavTo {
            receptacle: here.clone(),
        },
        _ => Tool::ShowReceptacles,
    }
}

/// What comes out of a model that lost the format.
fn nonsense(context: &PolicyContext<'_>, rng: &mut ChaCha8Rng) -> ToolCall {
    let receptacles = &context.briefing.receptacles;
    let place = random::choose(rng, receptacles).map_or("table_1", |(id, ..)| id.as_str());
    let number = random::below(rng, 6);
    let calls = [
        ToolCall::new("", Value::Null),
        ToolCall::new(
            "move_forward",
            json!({ "distance": 0.25 * (number + 1) as f64 }),
        ),
        ToolCall::new("grasp", json!({ "object": "target" })),
        ToolCall::new("goto", json!({ "receptacle_name": place })),
        ToolCall::new("look_at", json!({ "marker_id": number })),
        ToolCall::new("nav_to", json!([place])),
        ToolCall::new("nav_to", json!({ "location": place })),
        ToolCall::new("pick", json!({ "marker_id": "the one on the left" })),
        ToolCall::new("pick", json!({})),
        ToolCall::new("place", json!({ "marker_id": null })),
        ToolCall::new("gaze_at", json!({ "marker_id": [number, number + 1] })),
        ToolCall::new("show_object_by_category", json!({ "category": "object" })),
        ToolCall::new(
            "tool_call",
            json!({ "name": "nav_to", "arguments": { "receptacle_name": place } }),
        ),
    ];
    calls[random::below(rng, calls.len())].clone()
}
