//! The four rules of the simulated user as a check of a reply, written apart from the user itself.
//! Works on replies of any source.

use reel_world::{Receptacle, Scene, Task, language};

use super::leaks;

/// Which of the rules a reply breaks: `not_goal_driven`, `exact_position`,
/// `target_named_too_early`, `raw_id`.
///
/// - `raw_id`: it speaks an instance, asset or receptacle id.
/// - `exact_position`: it says where the target stands more exactly than the instruction (what the
///   source is or looks like), or gives numbers or directions.
/// - `target_named_too_early`: before the target was seen it says the caption, category or an
///   attribute of the target that the instruction does not say.
/// - `not_goal_driven`: it says nothing of the object or a place, sends the robot to a receptacle
///   that is neither source nor destination, or, once the target was seen, describes an object that
///   the target does not fit.
pub fn violations(task: &Task, scene: &Scene, reply: &str, seen_target: bool) -> Vec<&'static str> {
    let bare = without_places(scene, reply);
    let leaks = leaks(task, scene, reply);
    #[rustfmt::skip]
    let checks = [
        ("not_goal_driven", leads_astray(task, scene, reply, &bare, seen_target)),
        ("exact_position", leaks.contains(&"exact_position")),
        ("target_named_too_early", !seen_target && names_target(task, &bare)),
        ("raw_id", leaks.contains(&"raw_id")),
    ];
    checks
        .into_iter()
        .filter(|(_, broken)| *broken)
        .map(|(name, _)| name)
        .collect()
}

fn leads_astray(task: &Task, scene: &Scene, reply: &str, bare: &str, seen_target: bool) -> bool {
    let about_places = without(reply, bare)
        || scene
            .receptacles
            .iter()
            .any(|receptacle| says(reply, receptacle.room_name()));
    let about_objects = language::names_object(bare) || says(reply, "what I asked for");
    let ours = |receptacle: &&Receptacle| receptacle.id == task.src || receptacle.id == task.dest;
    let own: Vec<&String> = scene
        .receptacles
        .iter()
        .filter(ours)
        .flat_map(|receptacle| receptacle.captions.keys())
        .collect();
    let elsewhere = scene
        .receptacles
        .iter()
        .filter(|receptacle| !ours(receptacle))
        .any(|receptacle| {
            let foreign = |caption: &&String| !own.iter().any(|own| language::quotes(own, caption));
            receptacle
                .captions
                .keys()
                .filter(foreign)
                .any(|caption| says(reply, caption))
        });
    let target = task.target_object();
    let wrong_object = seen_target && !language::fits(bare, target, task.purpose.as_deref());
    !(about_places || about_objects) || elsewhere || wrong_object
}

fn names_target(task: &Task, bare: &str) -> bool {
    let target = task.target_object();
    let instruction = language::words(&task.instruction);
    let purpose = language::words(task.purpose.as_deref().unwrap_or_default());
    let new = |word: &str| {
        !instruction
            .iter()
            .chain(&purpose)
            .any(|said| language::lemma(said) == language::lemma(word))
    };
    let caption = target.caption.as_deref().unwrap_or_default();
    let attributes = language::attribute_words(caption);
    let telling = attributes
        .values()
        .chain(target.attributes.values())
        .flatten()
        .any(|word| new(word) && says(bare, word));
    let category = language::words(&target.category);
    let named = says(bare, &target.category) && category.iter().any(|word| new(word));
    telling
        || named
        || (!caption.is_empty() && says(bare, caption) && !says(&task.instruction, caption))
}

fn says(text: &str, words: &str) -> bool {
    language::quotes(text, words)
}

/// The reply in lower case without the captions and categories of receptacles, the longest first.
fn without_places(scene: &Scene, reply: &str) -> String {
    let mut names: Vec<&str> = scene
        .receptacles
        .iter()
        .flat_map(|receptacle| {
            receptacle
                .captions
                .keys()
                .map(String::as_str)
                .chain([receptacle.category.as_str(), receptacle.room_name()])
        })
        .filter(|name| !name.is_empty())
        .collect();
    names.sort_by_key(|name| std::cmp::Reverse(name.len()));
    let mut bare = reply.to_lowercase();
    for name in names {
        bare = bare.replace(&format!(" {}", name.to_lowercase()), " ");
    }
    bare
}

fn without(reply: &str, bare: &str) -> bool {
    bare.len() < reply.len()
}
