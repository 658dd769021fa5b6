//! Calls that an operator makes itself, resolved to numbers and arguments when they are due. Never
//! when they are due.

use rand_chacha::ChaCha8Rng;
use reel_episode::Privileged;
use reel_world::{
    InstanceId, ReceptacleId, Tool, ToolCall,
    record::{Marker, MarkerTarget},
};
use serde_json::{Value, json};

use super::{OperatorKind, look_alike::usable};
use crate::random;

/// One call to come.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Scripted {
    /// A call that is known already.
    Call(ToolCall),
    /// Looks around in one of several ways.
    Look,
    /// Gazes at something that has a number.
    Gaze,
    /// Picks the object by its number, where it has one.
    PickObject(InstanceId),
    /// Places on the receptacle by its number, after marking the furniture if need be.
    PlaceOn(ReceptacleId),
    /// Opens the receptacle likewise.
    Open(ReceptacleId),
    /// Closes the receptacle likewise.
    Close(ReceptacleId),
    /// Picks by a number that the object had before, or else one of no map.
    PickOld,
    /// Adopts the operator's belief from here on; no call.
    Believe,
}

/// A call of a tool.
pub(super) fn call(tool: &Tool) -> Scripted {
    Scripted::Call(tool.to_call())
}

/// Goes to a receptacle.
pub(super) fn nav(receptacle: &ReceptacleId) -> Scripted {
    call(&Tool::NavTo {
        receptacle: receptacle.clone(),
    })
}

/// The call that comes of it now; none where the moment has nothing for it. The second value says
/// whether the script stays where it is.
pub(super) fn resolve(
    scripted: &Scripted,
    truth: &Privileged<'_>,
    old: &[Marker],
    showed: bool,
    rng: &mut ChaCha8Rng,
) -> Option<(ToolCall, bool)> {
    let number = |target: &MarkerTarget| {
        truth
            .markers
            .iter()
            .find(|marker| marker.target == *target)
            .map(|marker| marker.id)
    };
    let of = |receptacle: &ReceptacleId, tool: &dyn Fn(u32) -> Tool| match number(
        &MarkerTarget::Receptacle(receptacle.clone()),
    ) {
        Some(marker) => Some((tool(marker).to_call(), false)),
        None => (!showed).then(|| (Tool::ShowReceptacles.to_call(), true)),
    };
    let any = |rng: &mut ChaCha8Rng| random::choose(rng, truth.markers).map(|marker| marker.id);
    match scripted {
        Scripted::Call(call) => Some((call.clone(), false)),
        Scripted::Look => {
            let look = match random::below(rng, 3) {
                0 => Tool::ShowReceptacles,
                1 => any(rng).map_or(Tool::ShowReceptacles, |marker| Tool::GazeAt { marker }),
                _ => Tool::WalkAround,
            };
            Some((look.to_call(), false))
        }
        Scripted::Gaze => {
            let tool = any(rng).map_or(Tool::WalkAround, |marker| Tool::GazeAt { marker });
            Some((tool.to_call(), false))
        }
        Scripted::PickObject(object) => {
            let marker = number(&MarkerTarget::Object(object.clone()))?;
            Some((Tool::Pick { marker }.to_call(), false))
        }
        Scripted::PlaceOn(receptacle) => of(receptacle, &|marker| Tool::Place { marker }),
        Scripted::Open(receptacle) => of(receptacle, &|marker| Tool::Open { marker }),
        Scripted::Close(receptacle) => of(receptacle, &|marker| Tool::Close { marker }),
        Scripted::PickOld => {
            let target = &truth.task.target;
            let other = |marker: &&Marker| {
                let now = number(&marker.target);
                now != Some(marker.id)
                    && Some(marker.id) != number(&MarkerTarget::Object(target.clone()))
            };
            let marker = old.iter().find(other).map_or(23, |marker| marker.id);
            Some((Tool::Pick { marker }.to_call(), false))
        }
        Scripted::Believe => None,
    }
}

/// The calls of wandering, repeating and malformed output: `strength` of them, about.
pub(super) fn series(
    kind: OperatorKind,
    strength: usize,
    truth: &Privileged<'_>,
    seen: &[ReceptacleId],
    rng: &mut ChaCha8Rng,
) -> Vec<Scripted> {
    let mut places: Vec<ReceptacleId> = usable(truth.scene).map(|one| one.id.clone()).collect();
    random::shuffle(rng, &mut places);
    let here = truth.landmark.cloned();
    let looks = random::below(rng, 3);
    let round = |places: &[ReceptacleId], looks: usize| {
        let visit =
            |place: &ReceptacleId| [nav(place)].into_iter().chain(vec![Scripted::Look; looks]);
        places.iter().flat_map(visit).collect::<Vec<_>>()
    };
    let repeat = |round: Vec<Scripted>| -> Vec<Scripted> {
        round.into_iter().cycle().take(strength).collect()
    };
    let failing = |rng: &mut ChaCha8Rng| {
        let number = 40 + random::below(rng, 50) as u32;
        let tools = [
            Tool::Pick { marker: number },
            Tool::GazeAt { marker: number },
            Tool::Open { marker: number },
            Tool::Place { marker: number },
        ];
        call(&tools[random::below(rng, 4)])
    };
    match kind {
        OperatorKind::ToAndFro => {
            // two that it knows, where it knows two
            let mut known: Vec<ReceptacleId> = seen.to_vec();
            known.extend(places);
            known.dedup();
            known.truncate(2);
            repeat(round(&known, looks))
        }
        OperatorKind::Rounds => {
            places.truncate(3 + random::below(rng, 4));
            repeat(round(&places, looks))
        }
        OperatorKind::UnseenDetours => {
            places.retain(|place| !seen.contains(place));
            let mut all = round(&places, looks.min(1));
            all.truncate(strength);
            all
        }
        OperatorKind::DoorAgain => {
            let has_door = |place: &ReceptacleId| truth.graph.door(place).is_some();
            let door = here
                .filter(&has_door)
                .or_else(|| places.iter().find(|id| has_door(id)).cloned());
            let Some(door) = door else { return Vec::new() };
            let closed = truth.graph.door(&door) == Some(reel_world::DoorState::Closed);
            let (first, second) = match closed {
                true => (Scripted::Open(door.clone()), Scripted::Close(door.clone())),
                false => (Scripted::Close(door.clone()), Scripted::Open(door.clone())),
            };
            let toggles = vec![first, second]
                .into_iter()
                .cycle()
                .take(strength.max(2) / 2 * 2);
            [nav(&door)].into_iter().chain(toggles).collect()
        }
        OperatorKind::SameCall => {
            let one = match (random::below(rng, 3), here) {
                (0, Some(here)) => nav(&here),
                (1, _) => Scripted::Gaze,
                _ => call(&Tool::ShowReceptacles),
            };
            repeat(vec![one])
        }
        OperatorKind::NeverFinish => {
            let one = [Scripted::Look, Scripted::Gaze, call(&Tool::ShowReceptacles)];
            vec![one[random::below(rng, 3)].clone(); 30]
        }
        OperatorKind::SegmentAgain => repeat(vec![
            call(&Tool::ShowReceptacles),
            Scripted::Gaze,
            call(&Tool::WalkAround),
        ]),
        OperatorKind::FailingCall => repeat(vec![failing(rng)]),
        OperatorKind::FailuresInTurn => repeat(vec![failing(rng), failing(rng)]),
        OperatorKind::AskAgain => {
            let questions = [
                "Where should I look first?",
                "Are you sure about that?",
                "What does it look like?",
                "Is it in the kitchen?",
                "Should I hurry?",
            ];
            let ask = |question: &&str| {
                call(&Tool::Ask {
                    question: (*question).to_owned(),
                })
            };
            repeat(questions.iter().map(ask).collect())
        }
        OperatorKind::NoCall => repeat(vec![Scripted::Call(ToolCall::new("", Value::Null))]),
        OperatorKind::UnknownTool => {
            let names = ["grasp", "move_forward", "look_at", "goto"];
            let one = |name: &&str| Scripted::Call(ToolCall::new(*name, json!({ "x": 1 })));
            repeat(names.iter().skip(random::below(rng, 3)).map(one).collect())
        }
        OperatorKind::BadArguments => repeat(vec![
            Scripted::Call(ToolCall::new(
                "pick",
                json!({ "marker_id": "the left one" }),
            )),
            Scripted::Call(ToolCall::new("nav_to", json!({ "location": "table" }))),
            Scripted::Call(ToolCall::new("place", json!({}))),
        ]),
        OperatorKind::NoSuchReceptacle => {
            let names = ["table_77", "the green sofa", "shelf_above_desk"];
            let one = |name: &&str| {
                call(&Tool::NavTo {
                    receptacle: (*name).to_owned().into(),
                })
            };
            repeat(names.iter().skip(random::below(rng, 3)).map(one).collect())
        }
        _ => Vec::new(),
    }
}
