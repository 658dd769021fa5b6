//! What the rule-based writer says over recorded episodes: only what the policy could know, all of
//! it true, in good English.

use std::collections::BTreeSet;

use reel_annotate::{PublicTask, Step, annotate, episode_seed, version};
use reel_trace::Trace;
use reel_world::{Digest, ErrorCode, language::quotes, record::MarkerTarget};

use crate::{notes, traces, words};

/// What the images and texts before a decision showed, read from the records directly.
fn seen_before(trace: &Trace, index: usize) -> BTreeSet<&str> {
    let mut seen = BTreeSet::new();
    for record in trace.steps[..index]
        .iter()
        .filter(|record| record.outcome.is_ok())
    {
        seen.extend(record.visible.iter().map(|visible| visible.object.as_str()));
        seen.extend(record.listed.iter().map(|object| object.as_str()));
        seen.extend(
            record
                .markers
                .iter()
                .filter_map(|marker| match &marker.target {
                    MarkerTarget::Object(object) => Some(object.as_str()),
                    MarkerTarget::Receptacle(_) => None,
                }),
        );
    }
    seen
}

#[test]
fn nothing_hidden_is_said() {
    for trace in traces() {
        for (index, note) in notes(&trace).iter().enumerate() {
            let text = words(note);
            let where_ = || format!("{} step {index}: {text}", trace.path.display());
            let seen = seen_before(&trace, index);
            for object in &trace.task.objects {
                assert!(!text.contains(object.instance.as_str()), "{}", where_());
                let asset = object.asset.as_str();
                assert!(
                    !asset.contains('_') || !text.contains(asset),
                    "{}",
                    where_()
                );
                let Some(caption) = object
                    .caption
                    .as_deref()
                    .filter(|_| !seen.contains(object.instance.as_str()))
                else {
                    continue;
                };
                let twin = trace.task.objects.iter().any(|other| {
                    other.caption.as_deref() == Some(caption)
                        && seen.contains(other.instance.as_str())
                });
                let told = quotes(&trace.task.instruction, caption)
                    || trace.steps[..=index].iter().any(|record| {
                        let reply = record.reply.as_ref().filter(|_| record.step < index as u32);
                        reply.is_some_and(|reply| quotes(&reply.text, caption))
                            || quotes(&record.input.call.arguments.to_string(), caption)
                    });
                assert!(
                    twin || told || !quotes(&text, caption),
                    "unseen {caption}: {}",
                    where_()
                );
            }
        }
    }
}

/// No note can depend on what comes after its decision, whatever the rules are.
#[test]
fn a_note_does_not_know_what_its_call_comes_to() {
    for trace in traces() {
        let task = PublicTask::of(&trace.task, &trace.scene);
        let steps = Step::all(&trace);
        let notes = annotate(&task, &steps, 7);
        for index in 0..steps.len() {
            let mut known = steps[..=index].to_vec();
            let last = known.last_mut().unwrap();
            (last.outcome, last.error, last.reply, last.held) =
                ("?", Some(ErrorCode::BackendError), None, None);
            (last.markers, last.visible, last.receptacle) = (Vec::new(), Vec::new(), None);
            assert_eq!(
                annotate(&task, &known, 7)[index],
                notes[index],
                "{} step {index}",
                trace.path.display()
            );
        }
    }
}

#[test]
fn a_history_grows_and_is_not_reworded() {
    for trace in traces() {
        for (index, pair) in notes(&trace).windows(2).enumerate() {
            assert!(
                index == 0
                    || pair[1]
                        .history
                        .starts_with(&format!("{} ", pair[0].history)),
                "{}",
                pair[1].history
            );
        }
    }
}

#[test]
fn every_part_is_said_and_reads_like_english() {
    const BAD: [&str; 17] = reel_world::words! {
        "  " " ." ".." " ," "the the " " a a " "{" "}" " a apple" " a orange" " an book" "the a "
        "a the " "some some" "()" "the what" " ,"
    };
    for trace in traces() {
        for (index, note) in notes(&trace).iter().enumerate() {
            for part in [
                &note.reasoning,
                &note.history,
                &note.schedule,
                &note.subtask,
            ] {
                let said = trace.steps.iter().any(|record| {
                    BAD.iter()
                        .any(|bad| record.outcome.text.contains(bad) && part.contains(bad))
                });
                let bad = BAD.iter().find(|bad| part.contains(*bad));
                assert!(
                    !part.is_empty() && (bad.is_none() || said),
                    "{bad:?} in {} step {index}: {part}",
                    trace.path.display()
                );
            }
            assert!(
                note.reasoning.ends_with(['.', '?', '!', '"']),
                "{}",
                note.reasoning
            );
            assert!(
                !note.history.contains('\n') && note.history.ends_with(['.', '"', '!', '?']),
                "{}",
                note.history
            );
        }
    }
}

/// What the next decision needs stands in the History: where one was, what the user said,
/// what failed and why.
#[test]
fn a_history_tells_what_happened() {
    for trace in traces() {
        let notes = notes(&trace);
        for (index, record) in trace.steps[..trace.steps.len() - 1].iter().enumerate() {
            let (before, after) = (&notes[index].history, &notes[index + 1].history);
            let told = if index == 0 {
                after.as_str()
            } else {
                after.strip_prefix(before.as_str()).unwrap()
            };
            let says = |word: &str| {
                assert!(
                    told.contains(word),
                    "{} step {index} lacks {word}: {told}",
                    trace.path.display()
                )
            };
            match (record.tool_name(), record.outcome.error) {
                ("nav_to", None) => says(record.receptacle.as_ref().unwrap().as_str()),
                ("place", None) => says(record.receptacle.as_ref().unwrap().as_str()),
                // The published servers answer a door call on an object and a question without a
                // description like any other call.
                ("open" | "close", None) => record
                    .receptacle
                    .iter()
                    .for_each(|receptacle| says(receptacle.as_str())),
                ("ask", None) => record
                    .reply
                    .iter()
                    .for_each(|reply| says(reply.text.trim_end_matches('.'))),
                ("show_object_by_category" | "walk_around", None) => {
                    says(&format!("{} ", record.markers.len()))
                }
                ("show_receptacles", None) => says(&format!("marker {}", record.markers[0].id)),
                ("pick", None) => says(
                    &trace
                        .task
                        .object(record.held.as_ref().unwrap())
                        .unwrap()
                        .category,
                ),
                (_, Some(ErrorCode::OutOfReach)) => says("out of reach"),
                (_, Some(ErrorCode::MarkerNotInView)) => says("not in view"),
                (_, Some(ErrorCode::AlreadyHolding)) => says("already holding"),
                (_, Some(ErrorCode::DoorClosed)) => says("door was closed"),
                (_, Some(ErrorCode::HandNotFree)) => says("hand was not free"),
                _ => assert!(!told.trim().is_empty()),
            }
        }
    }
}

#[test]
fn equal_arguments_give_equal_words_and_other_seeds_other_words() {
    let traces = traces();
    let trace = traces.iter().find(|trace| trace.steps.len() > 6).unwrap();
    let (task, steps) = (PublicTask::of(&trace.task, &trace.scene), Step::all(trace));
    assert_eq!(annotate(&task, &steps, 1), annotate(&task, &steps, 1));
    let histories: BTreeSet<String> = (0..40)
        .map(|seed| annotate(&task, &steps, seed).pop().unwrap().history)
        .collect();
    assert_eq!(histories.len(), 40);
    let digest = |text: &str| Digest::of(text.as_bytes());
    assert_ne!(episode_seed(1, &digest("a")), episode_seed(1, &digest("b")));
    assert_ne!(version(), Digest::default());
}
