//! What a predicate claims and the slots that it fills.

use super::*;

/// Whether a verb that needs an object has none.
pub(super) fn bare(predicate: &Predicate, slots: &Slots) -> bool {
    let needs = matches!(
        predicate.act,
        Act::Pick | Act::Place | Act::Get | Act::Carry | Act::Gaze | Act::Check
    );
    needs && slots.object.is_none() && slots.place.is_none() && slots.marker.is_none()
}

/// The claim that an act makes.
pub(crate) fn kind_of(act: Act) -> ClaimKind {
    match act {
        Act::Go | Act::Carry | Act::Check => ClaimKind::Visit,
        Act::Explore => ClaimKind::Explore,
        Act::Search => ClaimKind::Search,
        Act::See => ClaimKind::Sight,
        Act::Mark => ClaimKind::Marker,
        Act::Gaze => ClaimKind::Gaze,
        Act::Pick | Act::Get => ClaimKind::Pick,
        Act::Hold | Act::Have => ClaimKind::Hold,
        Act::Place => ClaimKind::Place,
        Act::Open | Act::Close => ClaimKind::DoorAct,
        Act::Ask => ClaimKind::Ask,
        Act::Say => ClaimKind::Answer,
        Act::Finish => ClaimKind::Finish,
        Act::Leave | Act::Contain | Act::Be => ClaimKind::Location,
        Act::Call => ClaimKind::Call,
        Act::Try | Act::Fail | Act::Succeed | Act::Manage => ClaimKind::Outcome,
    }
}

/// The readings of a predicate's arguments; lists give one each, and no argument gives one without.
pub(crate) fn slots(predicate: &Predicate) -> Vec<Slots<'_>> {
    let takes_marker = matches!(
        predicate.act,
        Act::Gaze | Act::Pick | Act::Place | Act::Open | Act::Close | Act::Check | Act::Get
    );
    let marker = predicate
        .all_args()
        .filter(|_| takes_marker)
        .find_map(|arg| arg.marker);
    let (mut things, mut places): (Vec<&Arg>, Vec<&Arg>) = (Vec::new(), Vec::new());
    let for_follows = predicate.args.iter().any(|arg| arg.prep == Prep::For);
    let said = |arg: &&Arg| {
        !arg.user && !arg.hand && (arg.marker.is_none() || arg.referent.is_receptacle())
    };
    let objects = predicate
        .subjects
        .iter()
        .map(|arg| (arg, true))
        .chain(predicate.args.iter().map(|arg| (arg, false)));
    for (arg, before) in objects.filter(|(arg, _)| said(arg)) {
        let place_like = arg.referent.is_receptacle() || !arg.referent.is_object();
        match (predicate.act, arg.prep) {
            _ if before && !predicate.passive && !arg.door => {}
            (
                Act::Go | Act::Check | Act::Explore,
                Prep::Direct | Prep::To | Prep::At | Prep::Near,
            ) if place_like => places.push(arg),
            (Act::Go | Act::Check | Act::Explore, Prep::Direct | Prep::To) => things.push(arg),
            (Act::Open | Act::Close, Prep::Direct | Prep::Of | Prep::At) => places.push(arg),
            (Act::Search, Prep::Direct)
                if for_follows || place_like && arg.referent.is_receptacle() =>
            {
                places.push(arg)
            }
            (Act::Search, Prep::For | Prep::Direct) => things.push(arg),
            (Act::Gaze, Prep::Direct | Prep::At | Prep::To) => things.push(arg),
            (Act::Pick, Prep::From | Prep::At) | (Act::Place | Act::Carry, Prep::At | Prep::To) => {
                places.push(arg)
            }
            (Act::Get, Prep::To) => places.push(arg),
            (Act::See | Act::Mark | Act::Search, Prep::At) => places.push(arg),
            (_, Prep::Direct) => things.push(arg),
            _ => {}
        }
    }
    match (things.len(), places.len()) {
        (0, 0) => vec![Slots {
            marker,
            ..Slots::default()
        }],
        (_, 0) => things
            .into_iter()
            .map(|thing| Slots {
                object: Some(thing),
                place: None,
                marker,
            })
            .collect(),
        (1.., 1) => things
            .into_iter()
            .map(|thing| Slots {
                object: Some(thing),
                place: Some(places[0]),
                marker,
            })
            .collect(),
        _ => places
            .into_iter()
            .map(|place| Slots {
                object: things.first().copied(),
                place: Some(place),
                marker,
            })
            .collect(),
    }
}
