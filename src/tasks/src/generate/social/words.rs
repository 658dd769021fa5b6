//! Which receptacles and objects texts leave possible, and the words of an instruction that single
//! one out. Rules over words, as the simulated user's are; never looks at a plan's questions.

use std::ops::Range;

use crate::wording::indefinite;
use reel_world::{ObjectInstance, PlanStep, Receptacle, Scene, Task, language};

use super::QuestionTopic;
use crate::generate::task::describe;

/// The objects on the source that every one of the texts may mean.
pub(super) fn objects<'a>(task: &'a Task, texts: &[&str]) -> Vec<&'a ObjectInstance> {
    let purpose = task.purpose.as_deref();
    let here = task
        .objects
        .iter()
        .filter(|object| object.receptacle == task.src);
    here.filter(|object| {
        texts
            .iter()
            .all(|text| language::fits(text, object, purpose))
    })
    .collect()
}

/// The receptacles that may be meant by the word for the right one: of its kind, usable, and not
/// the other end of the way. Of any kind where the instruction is silent about it.
pub(super) fn pool<'a>(task: &Task, scene: &'a Scene, about: QuestionTopic) -> Vec<&'a Receptacle> {
    let right = if about == QuestionTopic::Source {
        &task.src
    } else {
        &task.dest
    };
    let Some(right) = scene.receptacle(right) else {
        return Vec::new();
    };
    let ends = other_ends(task, scene, about);
    let any_kind = is_silent(task, scene, about);
    let may_be = |one: &&Receptacle| {
        (any_kind || is_called(&one.category, &right.category))
            && scene.is_usable(one)
            && !ends.iter().any(|end| end.id == one.id)
    };
    scene.receptacles.iter().filter(may_be).collect()
}

/// Whether people who say "a table" may mean a thing of this category: a table, a coffee table. Not
/// the other way round.
pub(super) fn is_called(category: &str, kind: &str) -> bool {
    let (category, kind) = (language::words(category), language::words(kind));
    category.ends_with(&kind)
}

/// The receptacles that the texts leave possible. A text that calls some by a name means these, and
/// those of their category that all of its words are said of; one that only says a room means those
/// in it; any other text means all.
pub(super) fn places<'a>(
    task: &Task,
    scene: &'a Scene,
    about: QuestionTopic,
    texts: &[&str],
) -> Vec<&'a Receptacle> {
    let mut left = pool(task, scene, about);
    let ends = other_ends(task, scene, about);
    for text in texts {
        // What is said of the other end is no word about this one.
        let mut bare = language::words(text);
        for end in &ends {
            let named = names(end, scene)
                .into_iter()
                .map(|name| language::words(&name));
            let said = named
                .filter(|name| at(&bare, name).is_some())
                .max_by_key(Vec::len);
            if let Some((name, from)) =
                said.and_then(|name| at(&bare, &name).map(|from| (name, from)))
            {
                bare.splice(from..from + name.len(), ["|".to_owned()]);
            }
        }
        let said = |name: &String| at(&bare, &language::words(name)).is_some();
        let told = left
            .iter()
            .flat_map(|one| names(one, scene))
            .filter(said)
            .max_by_key(|name| language::words(name).len());
        let in_room = |one: &&Receptacle| said(&format!("in the {}", one.room_name()));
        if let Some(name) = told {
            let is_its = |one: &Receptacle| {
                names(one, scene)
                    .iter()
                    .any(|its| its.eq_ignore_ascii_case(&name))
            };
            let kinds: Vec<&str> = left
                .iter()
                .filter(|one| is_its(one))
                .map(|one| one.category.as_str())
                .collect();
            left.retain(|one| {
                is_its(one)
                    || (kinds.contains(&one.category.as_str())
                        && describe::may_mean_receptacle(&name, one))
            });
        } else if left.iter().any(in_room) {
            left.retain(in_room);
        }
    }
    left
}

/// Whether no word of the instruction says what kind of receptacle this end of the way is.
pub(super) fn is_silent(task: &Task, scene: &Scene, about: QuestionTopic) -> bool {
    let right = match about {
        QuestionTopic::Object => None,
        QuestionTopic::Source => scene.receptacle(&task.src),
        QuestionTopic::Destination => scene.receptacle(&task.dest),
    };
    let said = language::words(&task.instruction);
    right.is_some_and(|right| {
        let kind = language::words(&right.category);
        !kind.iter().any(|word| said.contains(word))
            && !names(right, scene)
                .iter()
                .any(|name| language::quotes(&task.instruction, name))
    })
}

/// Whether the instruction leaves open what is meant, and says so: by a purpose, or by "a table".
pub(super) fn is_vague(task: &Task, scene: &Scene, about: QuestionTopic) -> bool {
    let told = [task.instruction.as_str()];
    match about {
        QuestionTopic::Object => task.fuzzy && moves_one(task) && objects(task, &told).len() > 1,
        QuestionTopic::Source | QuestionTopic::Destination => {
            let right = scene.receptacle(if about == QuestionTopic::Source {
                &task.src
            } else {
                &task.dest
            });
            let is_said = right.is_some_and(|right| {
                language::quotes(&task.instruction, &indefinite(&right.category))
            });
            is_said && places(task, scene, about, &told).len() > 1
        }
    }
}

/// The words by which an instruction tells what is meant: for the object, of each that moves.
pub(super) fn told(task: &Task, scene: &Scene, about: QuestionTopic) -> Vec<String> {
    let longest = |names: Vec<String>| {
        let said = names
            .into_iter()
            .filter(|name| language::quotes(&task.instruction, name));
        said.max_by_key(|name| language::words(name).len())
    };
    match about {
        QuestionTopic::Object => {
            let names = task.goal_objects().map(|object| {
                let mut names = describe::object(
                    &object.category,
                    object.caption.as_deref().unwrap_or_default(),
                    &object.attributes,
                );
                names.push(indefinite(&object.category));
                names.extend(task.purpose.clone());
                names
            });
            names.filter_map(longest).collect()
        }
        QuestionTopic::Source => task
            .goal_objects()
            .filter_map(|object| longest(names(scene.receptacle(&object.receptacle)?, scene)))
            .collect(),
        QuestionTopic::Destination => scene
            .receptacle(&task.dest)
            .and_then(|one| longest(names(one, scene)))
            .into_iter()
            .collect(),
    }
}

/// All that a receptacle is called, by its captions or so that no other is meant.
pub(super) fn names(receptacle: &Receptacle, scene: &Scene) -> Vec<String> {
    let mut names = describe::receptacle(receptacle, scene);
    names.extend(receptacle.captions.keys().cloned());
    names
}

/// A name that no other receptacle has: the one people use most.
pub(super) fn name(receptacle: &Receptacle, scene: &Scene) -> Option<String> {
    let unique = describe::receptacle(receptacle, scene);
    let main = receptacle
        .main_caption()
        .filter(|main| unique.iter().any(|name| name == main));
    main.map(str::to_owned)
        .or_else(|| unique.into_iter().next())
}

/// Where the longest of these phrases stands in a text, with the article before it; none where it
/// does not stand there once.
pub(super) fn phrase_in(text: &str, phrases: &[String]) -> Option<Range<usize>> {
    let lower = text.to_ascii_lowercase();
    let mut phrases: Vec<String> = phrases
        .iter()
        .map(|phrase| phrase.to_ascii_lowercase())
        .collect();
    phrases.sort_by_key(|phrase| std::cmp::Reverse(phrase.len()));
    let is_word = |range: &Range<usize>| {
        let outside = |letter: Option<char>| letter.is_none_or(|letter| !letter.is_alphanumeric());
        outside(lower[..range.start].chars().next_back())
            && outside(lower[range.end..].chars().next())
    };
    for phrase in phrases.iter().filter(|phrase| !phrase.is_empty()) {
        let ranges = lower
            .match_indices(phrase.as_str())
            .map(|(from, _)| from..from + phrase.len())
            .filter(is_word);
        match ranges.collect::<Vec<_>>().as_slice() {
            [] => {}
            [one] => {
                let article = ["the ", "a ", "an "]
                    .iter()
                    .find(|article| lower[..one.start].ends_with(&format!(" {article}")));
                return Some(one.start - article.map_or(0, |article| article.len())..one.end);
            }
            _ => return None,
        }
    }
    None
}

/// Whether a task moves its target and nothing else.
pub(super) fn moves_one(task: &Task) -> bool {
    task.goal_objects().count() == 1
}

/// The receptacle a step of a plan is at, if it says one.
pub(super) fn place_of_step(step: &PlanStep) -> Option<&str> {
    step.args
        .get("receptacle_name")
        .and_then(|name| name.as_str())
}

/// Where things come from, for the destination; where they go, for the source.
fn other_ends<'a>(task: &Task, scene: &'a Scene, about: QuestionTopic) -> Vec<&'a Receptacle> {
    if about == QuestionTopic::Source {
        return scene.receptacle(&task.dest).into_iter().collect();
    }
    let mut ids: Vec<_> = task
        .goal_objects()
        .map(|object| &object.receptacle)
        .collect();
    ids.sort();
    ids.dedup();
    ids.into_iter()
        .filter_map(|id| scene.receptacle(id))
        .collect()
}

/// Where words stand among words.
fn at(text: &[String], words: &[String]) -> Option<usize> {
    if words.is_empty() {
        None
    } else {
        text.windows(words.len()).position(|window| window == words)
    }
}
