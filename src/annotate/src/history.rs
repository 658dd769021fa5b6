//! A deed and what was learned from it, in one or two sentences that stay as they are for the
//! rest of the episode.

use reel_world::ErrorCode;

use crate::{
    english,
    memory::{Memory, description},
    step::{Call, MarkedItem, ObservedObject, Step},
    voice::PhraseChooser,
    wordings::history as say,
};

/// Most things that are told one by one.
const LISTED_MAX: usize = 10;

/// What a deed adds to the History; `memory` is from before it.
pub(crate) fn step_facts(memory: &Memory<'_>, step: &Step<'_>, voice: PhraseChooser) -> String {
    let call = step.call();
    let at_step = memory.step;
    let tell = |wording, gaps: &[(&str, &str)]| voice.phrase(wording, at_step, gaps);
    let what = || english::sought(call.argument);
    let at = memory
        .at
        .map(|place| format!(" while at {place}"))
        .unwrap_or_default();
    let question = || english::quoted(last_sentence(call.argument));
    if let Some(code) = step.error {
        return match (call.tool, code) {
            ("show_object_by_category", ErrorCode::NothingFound) => {
                tell(say::LOOKED_IN_VAIN, &[("what", &what()), ("at", &at)])
            }
            ("walk_around", ErrorCode::NothingFound) if memory.at.is_some() => tell(
                say::WALKED_IN_VAIN,
                &[("place", memory.at.unwrap_or_default())],
            ),
            ("ask", ErrorCode::NoUser) => tell(say::ASKED_IN_VAIN, &[("question", &question())]),
            _ => tell(
                say::FAILED,
                &[
                    ("deed", &intention(memory, call)),
                    ("why", &why(code, call)),
                ],
            ),
        };
    }
    let target = memory.marked(call);
    let receptacle = match target {
        Some(MarkedItem::Receptacle(id)) => id,
        _ => step.receptacle.unwrap_or("the receptacle"),
    };
    match call.tool {
        "nav_to" => {
            let place = step.receptacle.unwrap_or(call.argument);
            let wording = if memory.visited.contains(&place) {
                say::WENT_BACK
            } else {
                say::WENT
            };
            tell(wording, &[("place", place)])
        }
        "show_object_by_category" => {
            let count = english::count(step.markers.len(), "candidate");
            let gaps = [
                ("what", what()),
                ("at", at),
                ("count", count),
                ("list", numbered(&step.markers)),
            ];
            let found = tell(
                say::LOOKED,
                &gaps.each_ref().map(|(gap, text)| (*gap, text.as_str())),
            );
            let unnumbered = |thing: &&ObservedObject<'_>| {
                !numbers(&step.markers, thing) && memory.may_be_meant(thing)
            };
            let others: Vec<String> = step
                .visible
                .iter()
                .filter(unnumbered)
                .map(|it| english::indefinite(&description(it)))
                .collect();
            match others.as_slice() {
                [] => found,
                others => format!(
                    "{found} {}",
                    tell(say::ALSO_SAW, &[("list", &english::list(others, "and"))])
                ),
            }
        }
        "walk_around" => {
            let count = english::count(step.markers.len(), "object");
            let place = step.receptacle.or(memory.at).unwrap_or("the receptacle");
            tell(
                say::WALKED,
                &[
                    ("place", place),
                    ("count", &count),
                    ("list", &numbered(&step.markers)),
                ],
            )
        }
        "show_receptacles" => tell(say::MARKED_PLACES, &[("list", &numbered(&step.markers))]),
        "gaze_at" => tell(say::GAZED, &[("it", &marked_in_words(memory, call))]),
        "pick" => {
            let it = match target {
                Some(MarkedItem::Object(thing)) => english::definite(&description(&thing)),
                _ => format!("the object with marker {}", call.argument),
            };
            // An object may stand on the neighbouring furniture, which the agent cannot tell.
            let from = step
                .receptacle
                .filter(|place| memory.at == Some(place))
                .map(|place| format!(" from {place}"));
            tell(
                say::PICKED,
                &[("it", &it), ("from", &from.unwrap_or_default())],
            )
        }
        "place" => {
            let it = memory.held.map_or("the object".to_owned(), |thing| {
                english::definite(&english::noun(thing.category))
            });
            tell(say::PLACED, &[("it", &it), ("place", receptacle)])
        }
        "open" => tell(say::OPENED, &[("place", receptacle)]),
        "close" => tell(say::CLOSED, &[("place", receptacle)]),
        "ask" => {
            let reply = english::quoted(step.reply.unwrap_or(step.outcome));
            tell(say::ASKED, &[("question", &question()), ("reply", &reply)])
        }
        "list_receptacles" => tell(say::LISTED, &[]),
        tool => tell(say::CALLED, &[("tool", tool)]),
    }
}

/// A call as a verb in the infinitive: `pick up marker 1 (a large red mug)`.
pub(crate) fn intention(memory: &Memory<'_>, call: Call<'_>) -> String {
    let it = || marked_in_words(memory, call);
    match call.tool {
        "nav_to" if memory.task.receptacle(call.argument).is_some() => {
            format!("go to {}", call.argument)
        }
        tool if call.lacks_argument() => {
            format!("call {} without its argument", english::quoted(tool))
        }
        "nav_to" | "gaze_at" | "pick" | "place" | "open" | "close" if call.marker().is_none() => {
            format!(
                "call {} with {}",
                english::quoted(call.tool),
                english::quoted(call.argument)
            )
        }
        "walk_around" => memory.at.map_or("walk around".to_owned(), |place| {
            format!("walk around {place}")
        }),
        "show_object_by_category" => format!("look for {}", english::sought(call.argument)),
        "show_receptacles" => "mark the receptacles in view".to_owned(),
        "gaze_at" => format!("look closely at {}", it()),
        "pick" => format!("pick up {}", it()),
        "place" => match memory.held {
            Some(held) => format!(
                "place {} on {}",
                english::definite(&english::noun(held.category)),
                it()
            ),
            None => format!("place something on {}", it()),
        },
        "open" => format!("open {}", it()),
        "close" => format!("close {}", it()),
        "ask" => "ask the user".to_owned(),
        "finish" => "finish".to_owned(),
        tool => format!("call {}", english::quoted(tool)),
    }
}

/// Why a call failed, as a clause.
pub(crate) fn why(code: ErrorCode, call: Call<'_>) -> String {
    let it = if call.marker().is_some() {
        format!("marker {}", call.argument)
    } else {
        "it".to_owned()
    };
    match code {
        ErrorCode::UnknownTool => "there is no such tool".to_owned(),
        ErrorCode::BadArguments => "the arguments of the call were not valid".to_owned(),
        ErrorCode::UnparsableOutput => "my output could not be read as a call".to_owned(),
        ErrorCode::UnknownReceptacle => "there is no receptacle of that name".to_owned(),
        ErrorCode::UnknownMarker => format!("{it} was not on the current map"),
        ErrorCode::MarkerNotInView => format!("{it} was not in view"),
        ErrorCode::NoMarkerMap => "there was no map of markers".to_owned(),
        ErrorCode::NoLandmark => "I was not at any receptacle yet".to_owned(),
        ErrorCode::NothingFound => "nothing was found".to_owned(),
        ErrorCode::NoViewpoint => "there was no free position to see it from".to_owned(),
        ErrorCode::NotGraspable => format!("{it} was nothing that can be picked up"),
        ErrorCode::NotASurface => format!("{it} was no surface to place things on"),
        ErrorCode::NoFreeSpot => "there was no free spot on it".to_owned(),
        ErrorCode::AlreadyHolding => "I was already holding something".to_owned(),
        ErrorCode::NothingHeld => "there was nothing in my hand".to_owned(),
        ErrorCode::HandNotFree => "my hand was not free".to_owned(),
        ErrorCode::NoDoor => format!("{it} had no door"),
        ErrorCode::DoorClosed => "its door was closed".to_owned(),
        ErrorCode::OutOfReach => format!("{it} was out of reach"),
        ErrorCode::SkillFailed => "the gripper failed".to_owned(),
        ErrorCode::NoUser => "nobody answered".to_owned(),
        ErrorCode::BackendError | ErrorCode::PhysicsFault => {
            "the robot reported an error".to_owned()
        }
        ErrorCode::EpisodeOver => "the episode was over".to_owned(),
    }
}

/// `marker 1 (a large red mug)`, `marker 2 (desk_1)`, `marker 7`.
pub(crate) fn marked_in_words(memory: &Memory<'_>, call: Call<'_>) -> String {
    match memory.marked(call) {
        Some(marked) => format!("marker {} ({})", call.argument, in_words(&marked)),
        None => format!("marker {}", call.argument),
    }
}

/// The sentence of a question that asks.
pub(crate) fn last_sentence(question: &str) -> &str {
    let question = question.trim();
    let body = question.trim_end_matches(['.', '?', '!']);
    let start = body.rfind(['.', '?', '!']).map_or(0, |end| end + 1);
    question[start..].trim()
}

/// `marker 1 (a large red mug) and marker 2 (desk_1)`.
fn numbered(markers: &[(u32, MarkedItem<'_>)]) -> String {
    let mut items: Vec<String> = markers
        .iter()
        .take(LISTED_MAX)
        .map(|(number, marked)| format!("marker {number} ({})", in_words(marked)))
        .collect();
    if markers.len() > LISTED_MAX {
        items.push(format!("{} more", markers.len() - LISTED_MAX));
    }
    english::list(&items, "and")
}

fn in_words(marked: &MarkedItem<'_>) -> String {
    match marked {
        MarkedItem::Object(thing) => english::indefinite(&description(thing)),
        MarkedItem::Receptacle(id) => (*id).to_owned(),
    }
}

/// Whether a map numbers an object.
fn numbers(markers: &[(u32, MarkedItem<'_>)], thing: &ObservedObject<'_>) -> bool {
    markers
        .iter()
        .any(|(_, marked)| matches!(marked, MarkedItem::Object(other) if other.key == thing.key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sentence_that_asks() {
        assert_eq!(
            last_sentence("I see: a; b. Which one do you mean?"),
            "Which one do you mean?"
        );
        assert_eq!(last_sentence("Where?"), "Where?");
        assert_eq!(last_sentence(""), "");
    }
}
