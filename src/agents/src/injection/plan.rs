//! An injection as a course: the legs an episode goes through if all comes as intended, made from
//! the task before it starts. Decides which fault comes where and in which order; what a fault
//! does is in `faults`.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use reel_world::{InstanceId, ObjectInstance, ReceptacleId, Scene, Task, Tool};

use super::{
    Detour, Fault, FaultKind, Injection, InjectionError, choices, faults,
    scripted_call::{PlanSegment, ScriptedCall, Until},
};
use crate::{faults::mistaken_task, oracle::OracleOptions, random};

/// In how many of a hundred episodes with a wrong deed the agent never comes to finish.
const NEVER_FINISHES: usize = 15;

/// The moments of an episode at which something may come in between, in their order.
pub(super) const POSITIONS: [Until; 6] = [
    Until::Start,
    Until::Looking,
    Until::Found,
    Until::Held,
    Until::AtDestination,
    Until::Placed,
];

/// What is to come, and what marks the beginning of a fault that is a wrong belief.
#[derive(Clone, Debug, Default)]
pub(super) struct InjectionPlan {
    pub legs: Vec<PlanSegment>,
    pub watches: Vec<FaultTrigger>,
}

/// The call at which the fault of this index begins.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum FaultTrigger {
    /// It picks this object.
    Picks(usize, InstanceId),
    /// It picks any but this object.
    PicksOther(usize, InstanceId),
    /// It places on this receptacle.
    PlacesOn(usize, ReceptacleId),
}

/// What a fault puts into the course.
#[derive(Clone, Debug)]
pub(super) struct InsertedCalls {
    /// Moment of the episode at which the segment is inserted.
    pub at: Until,
    /// Plan segments that are inserted at that moment, in order.
    pub legs: Vec<PlanSegment>,
    /// Whether nothing comes after it.
    pub last: bool,
}

/// A course being made.
pub(super) struct Draft<'a> {
    pub task: &'a Arc<Task>,
    pub scene: &'a Scene,
    pub rng: ChaCha8Rng,
    /// What is taken for the target, if it is another object.
    pub object: Option<ObjectInstance>,
    /// What is taken for the destination, if it is another receptacle.
    pub place: Option<ReceptacleId>,
    pub options: OracleOptions,
    /// Where a fault takes or puts something: another one must not mean the same place, or there is
    /// nothing left to do.
    pub engaged: Vec<ReceptacleId>,
    course: InjectionPlan,
}

impl InjectionPlan {
    /// The course of an injection in a task.
    pub fn new(
        task: &Arc<Task>,
        scene: &Scene,
        injection: &Injection,
    ) -> Result<InjectionPlan, InjectionError> {
        let mut draft = Draft {
            task,
            scene,
            rng: random::stream(injection.seed, "injection", 0),
            object: None,
            place: None,
            options: OracleOptions::default(),
            engaged: Vec::new(),
            course: InjectionPlan::default(),
        };
        check(&injection.faults)?;
        let mut inserts: Vec<(usize, InsertedCalls)> = Vec::new();
        for (index, fault) in injection.faults.iter().enumerate() {
            inserts.extend(
                faults::inserts(&mut draft, index, fault)?
                    .into_iter()
                    .map(|insert| (index, insert)),
            );
        }
        check_order(&injection.faults, &inserts)?;
        // A wrong object is put back before anything else is done with what is held.
        inserts.sort_by_key(|(index, _)| !is_of_object(injection.faults[*index].kind));
        let detours: Vec<InsertedCalls> = injection
            .detours
            .iter()
            .map(|detour| draft.detour(*detour))
            .collect();
        Ok(draft.assemble(
            &injection.faults,
            inserts
                .into_iter()
                .map(|(_, insert)| insert)
                .chain(detours)
                .collect(),
        ))
    }
}

impl Draft<'_> {
    /// Notes what the fault of this index begins with.
    pub fn watch(&mut self, watch: FaultTrigger) {
        self.course.watches.push(watch);
    }

    /// A number below that.
    pub fn draw(&mut self, bound: usize) -> usize {
        random::below(&mut self.rng, bound)
    }

    /// Whether the case comes that comes so often in a hundred.
    pub fn chance(&mut self, percent: usize) -> bool {
        self.draw(100) < percent
    }

    /// So many receptacles, in random order, that are none of these; fewer where there are no more.
    pub fn others(&mut self, but: &[&ReceptacleId], count: usize) -> Vec<ReceptacleId> {
        let mut all: Vec<ReceptacleId> = choices::usable(self.scene)
            .map(|other| other.id.clone())
            .filter(|id| !but.contains(&id))
            .collect();
        random::shuffle(&mut self.rng, &mut all);
        all.truncate(count);
        all
    }

    /// The oracle as far as that, on what is believed now.
    pub fn follow(&self, until: Until) -> PlanSegment {
        let task = match (&self.object, &self.place) {
            (None, None) => self.task.clone(),
            (object, place) => Arc::new(mistaken_task(self.task, object.as_ref(), place.as_ref())),
        };
        PlanSegment::Follow {
            task,
            options: self.options,
            until,
        }
    }

    fn assemble(mut self, faults: &[Fault], inserts: Vec<InsertedCalls>) -> InjectionPlan {
        for moment in POSITIONS {
            for insert in inserts.iter().filter(|insert| insert.at == moment) {
                if moment != Until::Start {
                    let leg = self.follow(moment);
                    self.course.legs.push(leg);
                }
                self.take(&insert.legs);
                if insert.last {
                    return self.course;
                }
            }
        }
        let wrong = faults.iter().any(|fault| !fault.repaired);
        if wrong && self.chance(NEVER_FINISHES) {
            let leg = self.follow(Until::Placed);
            self.course.legs.extend([
                leg,
                PlanSegment::Do {
                    calls: vec![ScriptedCall::Idle],
                    times: None,
                },
            ]);
        }
        let leg = self.follow(Until::End);
        self.course.legs.push(leg);
        self.course
    }

    /// Takes legs over, and from them what is believed afterwards.
    fn take(&mut self, legs: &[PlanSegment]) {
        for leg in legs {
            match leg {
                PlanSegment::Object(object) => self.object.clone_from(object),
                PlanSegment::Place(place) => self.place.clone_from(place),
                PlanSegment::Options(habits) => self.options = *habits,
                PlanSegment::Go(until) => {
                    let leg = self.follow(*until);
                    self.course.legs.push(leg);
                }
                other => self.course.legs.push(other.clone()),
            }
        }
    }

    fn detour(&mut self, detour: Detour) -> InsertedCalls {
        let category = self.task.target_object().category.clone();
        let [here, there] = [
            self.task.target_object().receptacle.clone(),
            choices::destination(self.task).clone(),
        ];
        let call = |tool| PlanSegment::one(ScriptedCall::Call(tool));
        let (at, legs) = match (detour, self.draw(2)) {
            (Detour::ExtraLook, 0) => (Until::AtDestination, vec![call(Tool::ShowReceptacles)]),
            (Detour::ExtraLook, _) => (Until::Looking, vec![call(Tool::WalkAround)]),
            (Detour::ThereAndBack, draw) => {
                let at = if draw == 0 {
                    Until::Held
                } else {
                    Until::Looking
                };
                (
                    at,
                    self.others(&[&here, &there], 1)
                        .into_iter()
                        .map(|receptacle| call(Tool::NavTo { receptacle }))
                        .collect(),
                )
            }
            (Detour::CorrectedSlip, 0) => {
                (Until::Found, vec![PlanSegment::one(ScriptedCall::Misread)])
            }
            (Detour::CorrectedSlip, _) => {
                let receptacle = faults::unknown_receptacle(self.scene, &there);
                (Until::Held, vec![call(Tool::NavTo { receptacle })])
            }
            (Detour::UnneededQuestion, _) => (
                Until::Held,
                vec![call(Tool::Ask {
                    question: format!("Where do you want the {category}?"),
                })],
            ),
            (Detour::ExtraGaze, 0) => (
                Until::AtDestination,
                vec![
                    call(Tool::ShowReceptacles),
                    PlanSegment::one(ScriptedCall::Gaze),
                ],
            ),
            (Detour::ExtraGaze, _) => (Until::Found, vec![PlanSegment::one(ScriptedCall::Gaze)]),
        };
        InsertedCalls {
            at,
            legs,
            last: false,
        }
    }
}

fn check(faults: &[Fault]) -> Result<(), InjectionError> {
    for (index, fault) in faults.iter().enumerate() {
        let Fault {
            kind,
            position,
            strength,
            repaired,
        } = *fault;
        if !(0.0..=1.0).contains(&position) || !(1..=3).contains(&strength) {
            return Err(InjectionError::Range {
                kind,
                position: position.to_string(),
                strength,
            });
        }
        if repaired && kind == FaultKind::PrematureFinish {
            return Err(InjectionError::NotRepairable { kind });
        }
        let is_same = |other: &&Fault| {
            other.kind == kind
                || (is_of_object(other.kind) && is_of_object(kind))
                || (is_of_place(other.kind) && is_of_place(kind))
        };
        if let Some(other) = faults[..index].iter().find(is_same) {
            return Err(InjectionError::Conflict {
                first: other.kind,
                second: kind,
            });
        }
    }
    Ok(())
}

/// What ends the episode must come after everything else, and a door is forgotten only
/// on the true way.
fn check_order(faults: &[Fault], inserts: &[(usize, InsertedCalls)]) -> Result<(), InjectionError> {
    for (last, end) in inserts.iter().filter(|(_, insert)| insert.last) {
        for (index, fault) in faults.iter().enumerate().filter(|(index, _)| index != last) {
            // A wrong belief shows when it picks or places.
            let shows = if is_of_object(fault.kind) {
                end.at > Until::Found
            } else if is_of_place(fault.kind) {
                end.at > Until::AtDestination
            } else {
                inserts
                    .iter()
                    .all(|(other, insert)| *other != index || insert.at < end.at)
            };
            if !shows {
                return Err(InjectionError::Conflict {
                    first: faults[*last].kind,
                    second: fault.kind,
                });
            }
        }
    }
    let door = faults
        .iter()
        .find(|fault| fault.kind == FaultKind::MissingOpen);
    let astray = faults
        .iter()
        .find(|fault| is_of_place(fault.kind) || is_of_object(fault.kind));
    match (door, astray) {
        (Some(door), Some(other)) => Err(InjectionError::Conflict {
            first: door.kind,
            second: other.kind,
        }),
        _ => Ok(()),
    }
}

/// Whether the kind is to take a wrong object.
pub(super) fn is_of_object(kind: FaultKind) -> bool {
    use FaultKind::*;
    matches!(
        kind,
        WrongAttribute
            | WrongInstance
            | WrongKind
            | IgnoredAnswer
            | StaleWrongObject
            | MissingAsk
            | ClaimedAnswer
    )
}

/// Whether the kind is to take a wrong receptacle.
pub(super) fn is_of_place(kind: FaultKind) -> bool {
    matches!(
        kind,
        FaultKind::WrongReceptacle | FaultKind::SimilarFurniture
    )
}
