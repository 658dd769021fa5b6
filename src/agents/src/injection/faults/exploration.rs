//! Faults of memory and exploration: turning in circles, repeated failures, stale markers, a false
//! History, aimless search.

use super::*;

/// Drives in turn between so many receptacles.
pub(super) fn turning(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
    between: usize,
) -> Vec<InsertedCalls> {
    let at = moment(fault, &[Until::Start, Until::Looking, Until::Held]);
    let [from, to] = [
        draft.task.target_object().receptacle.clone(),
        choices::destination(draft.task).clone(),
    ];
    let (wanted, alike) = if at == Until::Held {
        (to, draft.task.dest_distractors.clone())
    } else {
        (from, draft.task.src_distractors.clone())
    };
    let mut others: Vec<ReceptacleId> = alike.into_iter().filter(|id| *id != wanted).collect();
    random::shuffle(&mut draft.rng, &mut others);
    if draft.chance(30) {
        others.clear();
    }
    let but: Vec<ReceptacleId> = others.iter().cloned().chain([wanted.clone()]).collect();
    others.extend(draft.others(&but.iter().collect::<Vec<_>>(), between - 1));
    others.truncate(between - 1);
    // Where it stands already it need not go: when it looks it stands at the first.
    let circle = if at == Until::Looking {
        others.into_iter().chain([wanted]).collect()
    } else {
        [wanted].into_iter().chain(others).collect::<Vec<_>>()
    };
    let turns = between * (fault.strength as usize + 1) + 1;
    let gives_up = draft.chance(20);
    let long = between * 4 + draft.draw(4);
    let times = if fault.repaired {
        Some(turns)
    } else {
        gives_up.then_some(long)
    };
    let mut deeds: Vec<ScriptedCall> = circle.iter().map(nav).collect();
    // Where a door has to be opened first it is wrong to go to the object at once.
    let door_first =
        at == Until::Start && choices::is_closed(draft.task, choices::destination(draft.task));
    if at == Until::Looking || door_first {
        return one(
            index,
            fault,
            at,
            vec![PlanSegment::Do {
                calls: deeds,
                times,
            }],
            vec![finish()],
        );
    }
    // To where it should go it goes rightly once; the fault begins when it leaves again.
    let rightly = deeds[0].clone();
    deeds.rotate_left(1);
    let times = times.map(|times| times - 1);
    repeated(index, fault, at, PlanSegment::one(rightly), deeds, times)
}

pub(super) fn repeated_failure(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Vec<InsertedCalls> {
    let to = choices::destination(draft.task).clone();
    let furniture = vec![ScriptedCall::Call(Tool::ShowReceptacles)];
    let late = fault.position >= 0.5;
    let early = if late { Until::Held } else { Until::Start };
    let (at, first, deed) = match draft.draw(if late { 2 } else { 4 }) {
        0 => (early, vec![], nav(&unknown_receptacle(draft.scene, &to))),
        1 => {
            let caption = draft
                .scene
                .receptacle(&to)
                .and_then(|known| known.main_caption())
                .unwrap_or("the place")
                .to_owned();
            let call = ToolCall::new("nav_to", json!({ "receptacle_name": caption }));
            (early, vec![], ScriptedCall::Raw(call))
        }
        2 => (
            Until::Looking,
            vec![],
            look(ABSENT[draft.draw(ABSENT.len())]),
        ),
        _ if draft.chance(50) => (Until::Looking, furniture, ScriptedCall::OpenDoorless),
        _ => (Until::Looking, furniture, ScriptedCall::PickFurniture),
    };
    again(draft, index, fault, at, first, vec![deed])
}

pub(super) fn stale_marker(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Vec<InsertedCalls> {
    let target = draft.task.target.clone();
    let [from, to] = [
        draft.task.target_object().receptacle.clone(),
        choices::destination(draft.task).clone(),
    ];
    let old = |tool| ScriptedCall::Old {
        object: target.clone(),
        tool,
        other: false,
    };
    let often = fault.strength as usize;
    let (at, first, deeds) = if fault.position < 0.6 {
        let mut away: Vec<ScriptedCall> = if draft.chance(50) {
            draft.others(&[&from], 1).iter().map(nav).collect()
        } else {
            vec![]
        };
        away.push(nav(&from));
        let deeds = if draft.chance(50) {
            vec![old(StaleMarkerTool::Pick), old(StaleMarkerTool::Gaze)]
        } else {
            vec![old(StaleMarkerTool::Gaze), old(StaleMarkerTool::Pick)]
        };
        (Until::Found, away, deeds)
    } else {
        (
            Until::Held,
            vec![ScriptedCall::Call(Tool::ShowReceptacles), nav(&to)],
            vec![old(StaleMarkerTool::Place)],
        )
    };
    repeated(
        index,
        fault,
        at,
        PlanSegment::each(first),
        deeds,
        Some(often),
    )
}

pub(super) fn false_history(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Vec<InsertedCalls> {
    let to = choices::destination(draft.task).clone();
    let category = draft.task.target_object().category.clone();
    let picked = [
        format!("picked up the {category}"),
        format!("took the {category}"),
        format!("the {category} is in my hand"),
        format!("grasped the {category} successfully"),
    ];
    let placed = [
        format!("placed the {category} on {to}"),
        format!("put it on {to}"),
        format!("the {category} is on {to} now"),
        format!("delivered the {category} to {to}"),
    ];
    let picked = PlanSegment::Claim(picked[draft.draw(4)].clone());
    let placed = PlanSegment::Claim(placed[draft.draw(4)].clone());
    let looks = PlanSegment::Do {
        calls: vec![ScriptedCall::Idle],
        times: Some(draft.draw(fault.strength as usize) + 1),
    };
    let at = moment(
        fault,
        &[Until::Looking, Until::Found, Until::Held, Until::Held],
    );
    let mut legs = match at {
        Until::Held => vec![placed, looks],
        _ if draft.chance(50) => vec![picked, PlanSegment::one(nav(&to)), placed],
        _ => vec![picked, PlanSegment::one(nav(&to))],
    };
    if fault.repaired {
        let think = PlanSegment::Think(
            "That cannot be: I look at my hand and see that it was not so.".to_owned(),
        );
        legs.extend([PlanSegment::Unclaim, think]);
    }
    one(index, fault, at, legs, vec![finish()])
}

pub(super) fn exploration(
    draft: &mut Draft<'_>,
    index: usize,
    fault: &Fault,
) -> Vec<InsertedCalls> {
    let category = draft.task.target_object().category.clone();
    let places = draft.others(
        &[&draft.task.target_object().receptacle.clone()],
        usize::MAX,
    );
    let places = if fault.repaired {
        &places[..places.len().min(fault.strength as usize + 1)]
    } else {
        &places[..]
    };
    let mut deeds = Vec::new();
    for place in places {
        deeds.push(nav(place));
        let looks = [
            look(&category),
            ScriptedCall::Call(Tool::WalkAround),
            ScriptedCall::Call(Tool::ShowReceptacles),
        ];
        deeds.push(looks[draft.draw(3)].clone());
        if !fault.repaired && draft.chance(25) {
            deeds.push(looks[draft.draw(2)].clone());
        }
    }
    let times = fault.repaired.then_some(deeds.len());
    let at = if fault.position < 0.7 {
        Until::Start
    } else {
        Until::Looking
    };
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

pub(super) fn questions(draft: &mut Draft<'_>) -> Vec<ScriptedCall> {
    let task = draft.task;
    let category = &task.target_object().category;
    let mut questions = vec![
        format!("Where is the {category}?"),
        "Which one do you mean?".to_owned(),
        format!("Where shall I put the {category}?"),
        format!("What does the {category} look like?"),
        "Is there anything else I should know?".to_owned(),
        "Shall I go on?".to_owned(),
        format!("Is it on {}?", choices::destination(task)),
    ];
    random::shuffle(&mut draft.rng, &mut questions);
    questions
        .into_iter()
        .map(|question| ScriptedCall::Call(Tool::Ask { question }))
        .collect()
}
