//! What each kind of fault does, as legs of a course. Never when the episode as a whole ends well,
//! nor how it is classified.

mod exploration;

use reel_world::{ReceptacleId, Scene, Tool, ToolCall};
use serde_json::json;

use super::{
    Fault, FaultKind, InjectionError, choices,
    plan::{Draft, FaultTrigger, InsertedCalls},
    scripted_call::{PlanSegment, ScriptedCall, StaleMarkerTool, Until},
};
use crate::{oracle::OracleOptions, random};
use exploration::{exploration, false_history, questions, repeated_failure, stale_marker, turning};

/// Categories that no scene of Reel has.
const ABSENT: [&str; 6] = reel_world::words! {
    telescope violin umbrella surfboard typewriter "snow globe"
};

/// What the fault of this index puts into the course.
pub(super) fn inserts(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Result<Vec<InsertedCalls>, InjectionError> {
    use FaultKind::*;
    Ok(match fault.kind {
        WrongAttribute | WrongInstance | WrongKind | IgnoredAnswer | MissingAsk | ClaimedAnswer => {
            return wrong_object(draft, index, fault);
        }
        StaleWrongObject => return stale_wrong_object(draft, index, fault),
        WrongReceptacle | SimilarFurniture => return wrong_place(draft, index, fault),
        MissingOpen => return missing_open(draft, index, fault),
        NeverLooked => never_looked(draft, index, fault),
        MissingPick => missing_pick(draft, index, fault),
        MissingPlace => missing_place(draft, index, fault),
        PrematureFinish => premature_finish(draft, index, fault),
        Oscillation => turning(draft, index, fault, 2),
        Circling => turning(draft, index, fault, 3),
        RepeatedFailure => repeated_failure(draft, index, fault),
        PickAgain => {
            let deed = ScriptedCall::PickAny;
            again(draft, index, fault, Until::Held, vec![], vec![deed])
        }
        StaleMarker => stale_marker(draft, index, fault),
        FalseHistory => false_history(draft, index, fault),
        Exploration => exploration(draft, index, fault),
        InvalidOutput => forever(
            index,
            fault,
            moment(fault, &ANYWHEN),
            vec![ScriptedCall::Nonsense],
            fault.strength as usize + 1,
        ),
        Dawdling => {
            let at = moment(
                fault,
                &[
                    Until::Looking,
                    Until::Found,
                    Until::Held,
                    Until::AtDestination,
                ],
            );
            forever(
                index,
                fault,
                at,
                vec![ScriptedCall::Idle],
                2 * fault.strength as usize + 2,
            )
        }
        EndlessQuestions => {
            let questions = questions(draft);
            forever(
                index,
                fault,
                moment(fault, &ANYWHEN),
                questions,
                fault.strength as usize + 2,
            )
        }
    })
}

/// A name like those of the scene's receptacles that none has.
pub(super) fn unknown_receptacle(scene: &Scene, like: &ReceptacleId) -> ReceptacleId {
    let stem = like
        .as_str()
        .trim_end_matches(|c: char| c.is_ascii_digit() || c == '_');
    let free = |id: &ReceptacleId| scene.receptacle(id).is_none();
    (scene.receptacles.len()..)
        .map(|number| format!("{stem}_{number}").into())
        .find(free)
        .expect("some number is free")
}

const ANYWHEN: [Until; 5] = [
    Until::Start,
    Until::Looking,
    Until::Found,
    Until::Held,
    Until::AtDestination,
];

/// The moment at the fault's position.
fn moment(fault: &Fault, choices: &[Until]) -> Until {
    let index = (fault.position * choices.len() as f64) as usize;
    choices[index.min(choices.len() - 1)]
}

fn nav(receptacle: &ReceptacleId) -> ScriptedCall {
    ScriptedCall::Call(Tool::NavTo {
        receptacle: receptacle.clone(),
    })
}

fn look(category: &str) -> ScriptedCall {
    ScriptedCall::Call(Tool::ShowObjectByCategory {
        category: category.to_owned(),
    })
}

fn finish() -> PlanSegment {
    PlanSegment::one(ScriptedCall::Call(Tool::Finish))
}

fn idly() -> PlanSegment {
    PlanSegment::Do {
        calls: vec![ScriptedCall::Idle],
        times: None,
    }
}

/// One insert: the fault begins with the first of these; it is repaired after them, or `end`
/// follows and nothing else.
fn one(
    index: usize,
    fault: &Fault,
    at: Until,
    mut legs: Vec<PlanSegment>,
    end: Vec<PlanSegment>,
) -> Vec<InsertedCalls> {
    legs.insert(0, PlanSegment::Begin(index));
    if fault.repaired {
        legs.push(PlanSegment::Repaired(index));
    } else {
        legs.extend(end);
    }
    vec![InsertedCalls {
        at,
        legs,
        last: !fault.repaired,
    }]
}

/// The deeds in turn: so many where it is repaired, else until the horizon.
fn forever(
    index: usize,
    fault: &Fault,
    at: Until,
    deeds: Vec<ScriptedCall>,
    repaired_after: usize,
) -> Vec<InsertedCalls> {
    let times = fault.repaired.then_some(repaired_after);
    one(
        index,
        fault,
        at,
        vec![PlanSegment::Do {
            calls: deeds,
            times,
        }],
        vec![],
    )
}

/// After the first deeds the others again and again, to the horizon or until it gives up.
fn again(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
    at: Until,
    first: Vec<ScriptedCall>,
    deeds: Vec<ScriptedCall>,
) -> Vec<InsertedCalls> {
    let long = 5 + 2 * fault.strength as usize + draft.draw(3);
    let gives_up = draft.chance(35);
    let times = if fault.repaired {
        Some(2 + fault.strength as usize)
    } else {
        gives_up.then_some(long)
    };
    repeated(index, fault, at, PlanSegment::each(first), deeds, times)
}

/// One insert: first something, then calls that are repeated so many times, or until the end.
fn repeated(
    index: usize,
    fault: &Fault,
    at: Until,
    first: PlanSegment,
    calls: Vec<ScriptedCall>,
    times: Option<usize>,
) -> Vec<InsertedCalls> {
    let calls = vec![PlanSegment::Do { calls, times }];
    let mut inserts = one(index, fault, at, calls, vec![finish()]);
    inserts[0].legs.insert(0, first);
    inserts
}

fn wrong_object(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Result<Vec<InsertedCalls>, InjectionError> {
    let mut objects = choices::wrong_objects(fault.kind, draft.task)?;
    objects.retain(|object| !draft.engaged.contains(&object.receptacle));
    let object = random::choose(&mut draft.rng, &objects)
        .copied()
        .cloned()
        .ok_or(InjectionError::NoObject { kind: fault.kind })?;
    draft.engaged.push(object.receptacle.clone());
    draft.watch(FaultTrigger::Picks(index, object.instance.clone()));
    let mut inserts = Vec::new();
    let mut insert = |at, legs| {
        inserts.push(InsertedCalls {
            at,
            legs,
            last: false,
        })
    };
    let never_asks = PlanSegment::Options(OracleOptions {
        asks: false,
        ..OracleOptions::default()
    });
    let believes = PlanSegment::Object(Some(object.clone()));
    match fault.kind {
        FaultKind::IgnoredAnswer => insert(
            Until::Looking,
            vec![PlanSegment::Go(Until::Asked), believes],
        ),
        FaultKind::MissingAsk => insert(Until::Start, vec![never_asks, believes]),
        FaultKind::ClaimedAnswer => {
            insert(Until::Start, vec![never_asks, believes]);
            let category = &object.category;
            let claims = [
                format!("the user said that the {category} is meant"),
                format!("asked the user, who wants the {category}"),
                format!("the user confirmed the {category}"),
            ];
            let claim = claims[draft.draw(claims.len())].clone();
            insert(Until::Looking, vec![PlanSegment::Claim(claim)]);
        }
        _ => insert(Until::Start, vec![believes]),
    }
    if fault.repaired {
        let mut legs = put_back(draft, index, fault);
        if fault.kind == FaultKind::MissingAsk || fault.kind == FaultKind::ClaimedAnswer {
            let question = format!("Is this {} what you mean?", object.category);
            legs.insert(
                0,
                PlanSegment::one(ScriptedCall::Call(Tool::Ask { question })),
            );
        }
        insert(Until::Held, legs);
    }
    Ok(inserts)
}

/// It notices on the way that it holds the wrong thing; the oracle puts it back and
/// takes the right one.
fn put_back(draft: &mut Draft<'_>, index: usize, fault: &Fault) -> Vec<PlanSegment> {
    let thoughts = [
        "Wait, this is not the one I was told to bring.",
        "Looking at it in my hand, it does not fit the description.",
        "I took the wrong one; I have to put it back.",
    ];
    let mut legs = vec![PlanSegment::Think(
        thoughts[draft.draw(thoughts.len())].to_owned(),
    )];
    if fault.strength > 2 {
        legs.insert(
            0,
            PlanSegment::one(nav(&choices::destination(draft.task).clone())),
        );
    }
    legs.extend([
        PlanSegment::Repaired(index),
        PlanSegment::Unclaim,
        PlanSegment::Object(None),
        PlanSegment::Options(OracleOptions::default()),
    ]);
    legs
}

fn stale_wrong_object(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Result<Vec<InsertedCalls>, InjectionError> {
    choices::wrong_objects(fault.kind, draft.task)?;
    let target = draft.task.target.clone();
    draft.watch(FaultTrigger::PicksOther(index, target.clone()));
    let category = draft.task.target_object().category.clone();
    let mut looks = [Tool::WalkAround, Tool::ShowObjectByCategory { category }];
    if draft.chance(50) {
        looks.reverse();
    }
    // Looks until the numbers have changed so that the old one misleads; then it relies
    // on the old one.
    let [first, second] = looks;
    let renumber = |tool: &Tool| ScriptedCall::Renumber {
        object: target.clone(),
        tool: tool.clone(),
    };
    let old = |tool| ScriptedCall::Old {
        object: target.clone(),
        tool,
        other: true,
    };
    let mut maps = vec![
        ScriptedCall::Call(first.clone()),
        renumber(&second),
        renumber(&first),
    ];
    maps.extend([
        ScriptedCall::Gaze,
        renumber(&second),
        old(StaleMarkerTool::Gaze),
        old(StaleMarkerTool::Pick),
    ]);
    let mut inserts = vec![InsertedCalls {
        at: Until::Looking,
        legs: vec![PlanSegment::each(maps)],
        last: false,
    }];
    if fault.repaired {
        // The numbers may not have misled it after all: then it has nothing to say.
        inserts.push(InsertedCalls {
            at: Until::Held,
            legs: vec![PlanSegment::Repaired(index)],
            last: false,
        });
    }
    Ok(inserts)
}

fn wrong_place(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Result<Vec<InsertedCalls>, InjectionError> {
    let mut places = choices::wrong_receptacles(fault.kind, draft.task, draft.scene)?;
    places.retain(|place| !draft.engaged.contains(place));
    let none = || InjectionError::NoReceptacle {
        kind: fault.kind,
        destination: choices::destination(draft.task).clone(),
    };
    let place = random::choose(&mut draft.rng, &places)
        .cloned()
        .ok_or_else(none)?;
    draft.engaged.push(place.clone());
    draft.watch(FaultTrigger::PlacesOn(index, place.clone()));
    let mut inserts = vec![InsertedCalls {
        at: Until::Start,
        legs: vec![PlanSegment::Place(Some(place.clone()))],
        last: false,
    }];
    let right = choices::destination(draft.task).clone();
    if draft.chance(40) && !choices::is_closed(draft.task, &place) {
        // It was at the right one and did not know it.
        let legs = vec![
            PlanSegment::Think(format!("Is it {right}? I do not think so.")),
            PlanSegment::one(nav(&right)),
        ];
        inserts.push(InsertedCalls {
            at: Until::Held,
            legs,
            last: false,
        });
    }
    if fault.repaired {
        let think = PlanSegment::Think(format!(
            "{place} is not where it belongs; I take it from there again."
        ));
        let legs = vec![
            think,
            PlanSegment::Repaired(index),
            PlanSegment::Place(None),
        ];
        inserts.push(InsertedCalls {
            at: Until::Placed,
            legs,
            last: false,
        });
    }
    Ok(inserts)
}

fn missing_open(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Result<Vec<InsertedCalls>, InjectionError> {
    let [from, to] = [
        draft.task.target_object().receptacle.clone(),
        choices::destination(draft.task).clone(),
    ];
    let [source, destination] = [&from, &to].map(|id| choices::is_closed(draft.task, id));
    let category = draft.task.target_object().category.clone();
    let often = fault.strength as usize;
    let (at, mut legs) = if destination {
        (
            Until::AtDestination,
            vec![
                PlanSegment::each(vec![ScriptedCall::Call(Tool::ShowReceptacles)]),
                PlanSegment::one(ScriptedCall::PlaceOn(to.clone())),
            ],
        )
    } else if source {
        (
            Until::Looking,
            vec![PlanSegment::each(vec![
                look(&category),
                ScriptedCall::Call(Tool::WalkAround),
            ])],
        )
    } else {
        return Err(InjectionError::NoDoor {
            kind: fault.kind,
            source_id: from,
            destination: to,
        });
    };
    let more = if destination {
        ScriptedCall::PlaceOn(to)
    } else {
        look(&category)
    };
    if often > 1 && (!fault.repaired || source) {
        legs.push(PlanSegment::Do {
            calls: vec![more],
            times: Some(often - 1),
        });
    }
    let end = if draft.chance(30) { idly() } else { finish() };
    let sees_doors = PlanSegment::Options(OracleOptions::default());
    let mut inserts = one(index, fault, at, legs, vec![end]);
    inserts[0].legs.push(sees_doors);
    let blind = PlanSegment::Options(OracleOptions {
        minds_doors: false,
        ..OracleOptions::default()
    });
    inserts.push(InsertedCalls {
        at: Until::Start,
        legs: vec![blind],
        last: false,
    });
    Ok(inserts)
}

fn never_looked(draft: &mut Draft<'_>, index: usize, fault: &Fault) -> Vec<InsertedCalls> {
    let to = choices::destination(draft.task).clone();
    let try_to_place = || {
        vec![
            nav(&to),
            ScriptedCall::Call(Tool::ShowReceptacles),
            ScriptedCall::PlaceOn(to.clone()),
        ]
    };
    let (at, deeds) = match draft.draw(4) {
        0 => (Until::Looking, vec![nav(&to)]),
        1 => (Until::Start, try_to_place()),
        2 => (
            Until::Looking,
            vec![
                ScriptedCall::Call(Tool::ShowReceptacles),
                ScriptedCall::PickFurniture,
                nav(&to),
            ],
        ),
        _ => (Until::Looking, try_to_place()),
    };
    let mut legs = vec![
        PlanSegment::Think(format!("I take it along and bring it to {to}.")),
        PlanSegment::each(deeds),
    ];
    if fault.strength > 1 {
        let others = draft.others(
            &[&to, &draft.task.target_object().receptacle.clone()],
            fault.strength as usize - 1,
        );
        legs.push(PlanSegment::each(others.iter().map(nav).collect()));
    }
    one(index, fault, at, legs, vec![finish()])
}

fn missing_pick(draft: &mut Draft<'_>, index: usize, fault: &Fault) -> Vec<InsertedCalls> {
    let to = choices::destination(draft.task).clone();
    let category = &draft.task.target_object().category;
    let thoughts = [
        format!("I found the {category}; now it has to go to {to}."),
        format!("With the {category} found, the next thing is {to}."),
        format!("The {category} is here. On to {to}."),
    ];
    let mut legs = vec![
        PlanSegment::Think(thoughts[draft.draw(3)].clone()),
        PlanSegment::one(nav(&to)),
    ];
    let tries = if fault.repaired {
        1
    } else {
        draft.draw(fault.strength as usize + 1)
    };
    if tries > 0 {
        let place = ScriptedCall::PlaceOn(to.clone());
        legs.extend([
            PlanSegment::one(ScriptedCall::Call(Tool::ShowReceptacles)),
            PlanSegment::Do {
                calls: vec![place],
                times: Some(tries),
            },
        ]);
    }
    let end = if draft.chance(20) { idly() } else { finish() };
    one(index, fault, Until::Found, legs, vec![end])
}

fn missing_place(draft: &mut Draft<'_>, index: usize, fault: &Fault) -> Vec<InsertedCalls> {
    let to = choices::destination(draft.task);
    let thoughts = [
        format!("I have brought it to {to}."),
        format!("I am at {to} with it, so the task is done."),
        "It is where it was wanted.".to_owned(),
    ];
    let think = PlanSegment::Think(thoughts[draft.draw(3)].clone());
    if fault.repaired {
        // It is about to leave with the thing in its hand, and comes back.
        let elsewhere = draft.others(&[&choices::destination(draft.task).clone()], 1);
        return one(
            index,
            fault,
            Until::AtDestination,
            vec![
                think,
                PlanSegment::each(elsewhere.iter().map(nav).collect()),
            ],
            vec![],
        );
    }
    let looks = draft.draw(fault.strength as usize + 1);
    let legs = if looks > 0 {
        vec![
            think,
            PlanSegment::Do {
                calls: vec![ScriptedCall::Idle],
                times: Some(looks),
            },
        ]
    } else {
        vec![think]
    };
    one(index, fault, Until::AtDestination, legs, vec![finish()])
}

fn premature_finish(draft: &mut Draft<'_>, index: usize, fault: &Fault) -> Vec<InsertedCalls> {
    let [from, to] = [
        draft.task.target_object().receptacle.clone(),
        choices::destination(draft.task).clone(),
    ];
    if fault.position >= 0.25 {
        let way = draft.draw(fault.strength as usize);
        let others = draft.others(&[&to, &from], way);
        let mut inserts = one(index, fault, Until::Held, vec![], vec![finish()]);
        inserts[0]
            .legs
            .insert(0, PlanSegment::each(others.iter().map(nav).collect()));
        return inserts;
    }
    // It looks in the wrong place, finds nothing, and leaves it at that.
    let category = draft.task.target_object().category.clone();
    let alike: Vec<ReceptacleId> = draft.task.src_distractors.clone();
    let wrong = random::choose(&mut draft.rng, &alike).cloned();
    let wrong = wrong
        .or_else(|| draft.others(&[&to, &from], 1).pop())
        .unwrap_or(to);
    let mut inserts = one(index, fault, Until::Start, vec![], vec![finish()]);
    let looks = vec![
        nav(&wrong),
        look(&category),
        ScriptedCall::Call(Tool::WalkAround),
    ];
    inserts[0].legs.splice(
        0..0,
        [
            PlanSegment::Think(format!("It should be on {wrong}.")),
            PlanSegment::each(looks),
        ],
    );
    inserts
}
