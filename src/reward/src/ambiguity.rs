//! How often asking can pay in a task (docs/spec.md#reward-preset-paper, `ask`), by its words and
//! distractors. Never answers a question.

use std::collections::BTreeSet;

use reel_world::{AssetId, ObjectInstance, ReceptacleId, Scene, Task, language};

/// `B_ask` before the limit of the preset.
pub(crate) fn budget(task: &Task, scene: &Scene) -> u32 {
    let Some(target) = task.object(&task.target) else {
        return 0;
    };
    let others = task
        .objects
        .iter()
        .filter(|object| object.asset != target.asset);
    let placed = others.clone().any(|object| {
        task.object_distractors.contains(&object.asset) || alike(task, target, object)
    });
    if !placed && !task.fuzzy {
        return 0;
    }
    let distractors: BTreeSet<&AssetId> = others
        .filter(|object| alike(task, target, object))
        .map(|object| &object.asset)
        .collect();
    distractors.len() as u32 + u32::from(several_receptacles_fit(task, scene))
}

/// Whether an object is of the target's category, or serves the task's purpose.
fn alike(task: &Task, target: &ObjectInstance, object: &ObjectInstance) -> bool {
    let category = language::is_a(&object.category, &target.category)
        || language::is_a(&target.category, &object.category);
    category
        || task
            .purpose
            .as_deref()
            .is_some_and(|purpose| language::is_a(&object.category, purpose))
}

/// Whether the instruction leaves open which of several like receptacles is the source or the
/// destination: it quotes neither the id nor a caption that only the right one has.
fn several_receptacles_fit(task: &Task, scene: &Scene) -> bool {
    let captions = |id: &ReceptacleId| -> BTreeSet<&str> {
        scene
            .receptacle(id)
            .into_iter()
            .flat_map(|receptacle| receptacle.captions.keys().map(String::as_str))
            .collect()
    };
    [
        (&task.src, &task.src_distractors),
        (&task.dest, &task.dest_distractors),
    ]
    .into_iter()
    .any(|(place, distractors)| {
        let others: BTreeSet<&str> = distractors
            .iter()
            .filter(|other| *other != place)
            .flat_map(captions)
            .collect();
        let told = captions(place).iter().any(|caption| {
            !others.contains(caption) && language::quotes(&task.instruction, caption)
        });
        let named = language::quotes(&task.instruction, place.as_str());
        distractors.iter().any(|other| other != place) && !told && !named
    })
}
