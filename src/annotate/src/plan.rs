//! What is left to do as a short list, and what of it is done now.

use crate::{
    english,
    history::marked_in_words,
    memory::Memory,
    step::{Call, MarkedItem},
    voice::PhraseChooser,
    wordings::plan as say,
};

/// What is left, this decision included. Its words are chosen once an episode.
pub(crate) fn schedule(memory: &Memory<'_>, call: Call<'_>, voice: PhraseChooser) -> String {
    let items = items(memory, call, voice);
    match voice.words(say::STYLE, 0, &[]).as_str() {
        "numbers" => items
            .iter()
            .enumerate()
            .map(|(index, item)| format!("{}. {item}", index + 1))
            .collect::<Vec<_>>()
            .join("; "),
        "arrows" => items.join(" -> "),
        _ => items.join("; "),
    }
}

/// What is done now.
pub(crate) fn subtask(memory: &Memory<'_>, call: Call<'_>, voice: PhraseChooser) -> String {
    let tell = |wording, gaps: &[(&str, &str)]| voice.phrase(wording, memory.step, gaps);
    let it = || match memory.marked(call) {
        Some(MarkedItem::Receptacle(id)) => id.to_owned(),
        _ => marked_in_words(memory, call),
    };
    let short = || match memory.marked(call) {
        Some(MarkedItem::Object(thing)) => {
            format!(
                "{} with marker {}",
                english::definite(&english::noun(thing.category)),
                call.argument
            )
        }
        _ => it(),
    };
    match call.tool {
        tool if call.lacks_argument() => tell(say::NOW_OTHER, &[("tool", &english::quoted(tool))]),
        "nav_to" => tell(say::NOW_GO, &[("place", call.argument)]),
        "walk_around" => tell(
            say::NOW_WALK,
            &[("place", memory.at.unwrap_or("the place where I am"))],
        ),
        "show_object_by_category" => {
            tell(say::NOW_LOOK, &[("what", &english::sought(call.argument))])
        }
        "show_receptacles" => tell(say::NOW_MARK, &[]),
        "gaze_at" => tell(say::NOW_GAZE, &[("it", &short())]),
        "pick" => tell(say::NOW_PICK, &[("it", &short())]),
        "place" => {
            let held = memory.held.map_or("the object".to_owned(), |held| {
                english::definite(&english::noun(held.category))
            });
            tell(say::NOW_PLACE, &[("it", &held), ("place", &it())])
        }
        "open" => tell(say::NOW_OPEN, &[("it", &it())]),
        "close" => tell(say::NOW_CLOSE, &[("it", &it())]),
        "ask" => tell(say::NOW_ASK, &[]),
        "finish" => tell(say::NOW_FINISH, &[]),
        tool => tell(say::NOW_OTHER, &[("tool", &english::quoted(tool))]),
    }
}

fn items(memory: &Memory<'_>, call: Call<'_>, voice: PhraseChooser) -> Vec<String> {
    let task = memory.task;
    let item = |wording, gaps: &[(&str, &str)]| voice.words(wording, 0, gaps);
    let finish = || item(say::PLAN_FINISH, &[]);
    let destination = ("place", task.destination.phrase.as_str());
    let mut items = Vec::new();
    if call.tool == "finish" {
        return vec![finish()];
    }
    let done = memory.is_done() && memory.held.is_none();
    if !done {
        if !memory.holds_it() {
            if let Some(held) = memory.held {
                items.push(item(
                    say::PLAN_PUT_BACK,
                    &[("it", &english::definite(&english::noun(held.category)))],
                ));
            }
            let shut = |id: &String| memory.wants_opening(id);
            if task.destination.alike.iter().any(shut)
                && !task
                    .destination
                    .alike
                    .iter()
                    .any(|id| memory.doors.contains_key(id.as_str()))
            {
                items.push(item(say::PLAN_OPEN, &[destination]));
            }
            if memory.held.is_some()
                || !memory
                    .numbered()
                    .any(|(_, thing)| memory.may_be_meant(&thing))
            {
                items.push(item(
                    say::PLAN_FIND,
                    &[("object", &task.object), ("place", &task.source.phrase)],
                ));
            }
            if task.purpose.is_some() && !memory.asked {
                items.push(item(say::PLAN_ASK, &[]));
            }
            items.push(item(say::PLAN_PICK, &[("object", &task.object_short)]));
        }
        let arrived = memory.holds_it()
            && call.tool != "nav_to"
            && memory.at.is_some_and(|at| task.destination.may_be(at));
        if !arrived {
            items.push(item(say::PLAN_CARRY, &[destination]));
        }
        items.push(item(say::PLAN_PLACE, &[]));
        if task.moves > 1 {
            items.push(item(say::PLAN_MORE, &[]));
        }
    }
    let open = memory.doors.iter().filter(|(_, open)| **open);
    items.extend(open.map(|(id, _)| item(say::PLAN_CLOSE, &[("place", id)])));
    items.push(finish());
    items
}
