//! When an `ask` is worth something: what was seen that the words so far may mean, and how often asking pays
//! (SPEC section 5, `ask`). Never answers a question.

use std::collections::BTreeSet;

use reel_world::{AssetId, InstanceId, ObjectInstance, ReceptacleId, Scene, Task, language};

/// Most that a budget can be (paper, Detailed Reward Configuration).
const BUDGET_MAX: usize = 3;

/// What the instruction and the replies leave open.
#[derive(Clone, Debug)]
pub(crate) struct Ambiguity {
    /// Objects that fit the instruction and all replies so far.
    candidates: Vec<ObjectInstance>,
    seen: BTreeSet<InstanceId>,
    budget: usize,
}

impl Ambiguity {
    pub(crate) fn new(task: &Task, scene: &Scene) -> Self {
        let fits = |object: &&ObjectInstance| language::fits(&task.instruction, object, task.purpose.as_deref());
        let candidates = task.objects.iter().filter(fits).cloned().collect();
        Self { candidates, seen: BTreeSet::new(), budget: budget(task, scene) }
    }

    pub(crate) fn see<'a>(&mut self, objects: impl Iterator<Item = &'a InstanceId>) {
        self.seen.extend(objects.cloned());
    }

    /// Takes note of an answered question: how many candidates it was asked among, if it earns something.
    pub(crate) fn ask(&mut self, reply: &str) -> Option<usize> {
        let observed = self.candidates.iter().filter(|object| self.seen.contains(&object.instance));
        let among = observed.map(|object| &object.asset).collect::<BTreeSet<_>>().len();
        self.candidates.retain(|object| language::fits(reply, object, None));
        if among < 2 || self.budget == 0 {
            return None;
        }
        self.budget -= 1;
        Some(among)
    }
}

/// `B_ask`.
fn budget(task: &Task, scene: &Scene) -> usize {
    let target = task.target_object();
    let others = task.objects.iter().filter(|object| object.asset != target.asset);
    let placed = others.clone().any(|object| task.object_distractors.contains(&object.asset) || alike(task, target, object));
    if !placed && !task.fuzzy {
        return 0;
    }
    let distractors: BTreeSet<&AssetId> =
        others.filter(|object| alike(task, target, object)).map(|object| &object.asset).collect();
    BUDGET_MAX.min(distractors.len() + usize::from(several_receptacles_fit(task, scene)))
}

/// Whether an object is of the target's category, or serves the task's purpose.
fn alike(task: &Task, target: &ObjectInstance, object: &ObjectInstance) -> bool {
    let category = language::is_a(&object.category, &target.category) || language::is_a(&target.category, &object.category);
    category || task.purpose.as_deref().is_some_and(|purpose| language::is_a(&object.category, purpose))
}

/// Whether the instruction leaves open which of several like receptacles is the source or the destination: it quotes neither
/// the id nor a caption that only the right one has.
fn several_receptacles_fit(task: &Task, scene: &Scene) -> bool {
    let captions = |id: &ReceptacleId| -> BTreeSet<&str> {
        scene.receptacle(id).into_iter().flat_map(|receptacle| receptacle.captions.keys().map(String::as_str)).collect()
    };
    [(&task.src, &task.src_distractors), (&task.dest, &task.dest_distractors)].into_iter().any(|(place, distractors)| {
        let others: BTreeSet<&str> = distractors.iter().filter(|other| *other != place).flat_map(captions).collect();
        let told =
            captions(place).iter().any(|caption| !others.contains(caption) && language::quotes(&task.instruction, caption));
        let named = language::quotes(&task.instruction, place.as_str());
        distractors.iter().any(|other| other != place) && !told && !named
    })
}
