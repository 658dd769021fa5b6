//! What the published servers say of a task when its episode begins, and world graphs in their
//! order: receptacles as the scene lists them, objects as they came there.

use reel_live::StartedEpisode;
use reel_world::{DoorState, InstanceId, Profile, ReceptacleId, Scene, Task, WorldGraph};
use serde_json::{Map, Value, json};

/// Where the loader keeps what it does not use of a task file (see [`Task::extra`]).
const GLOBAL_INDEX: &str = "episodes[0].global_index";
const DISTRACTOR_META: &str = "episodes[0].obj_distractor_meta.";

/// What is known when an episode begins. Branch `main` gives the benchmark's instruction and
/// names, branch `gspo` the precise instruction; a task that was asked for by an id has that id,
/// for the trainer compares them.
pub(super) fn payload(profile: Profile, begun: &StartedEpisode, scene: &Scene) -> Value {
    let task = &*begun.task;
    let main = profile != Profile::RealGspo;
    let mut payload = Map::new();
    let mut put = |key: &str, value: Value| drop(payload.insert(key.to_owned(), value));
    put(
        "task_id",
        json!(begun.requested.as_deref().unwrap_or(task.short_id())),
    );
    if let Some((family, _)) = task.benchmark_id().filter(|_| main) {
        put("benchmark_task_id", json!(task.task_id));
        put("family", json!(family));
        if let Some(index) = task.extra.get(GLOBAL_INDEX) {
            put("global_index", index.clone());
        }
    }
    put("episode_idx", json!(begun.index));
    put("episode_local_idx", json!(begun.index));
    put("episode_range", json!([0, begun.of]));
    put(
        "task_description",
        json!(if main {
            &task.instruction
        } else {
            &task.precise_instruction
        }),
    );
    put("scene_id", json!(task.scene_id));
    let rooms = scene
        .rooms_and_furniture()
        .into_iter()
        .map(|(room, ids)| (room.to_owned(), json!(ids)));
    put("rooms_and_furniture", rooms.collect::<Map<_, _>>().into());
    let initial = OrderedGraph::initial(task, scene);
    let target = task.target_object();
    put("initial_world_graph", initial.json());
    put(
        "target_world_graph",
        initial
            .moved(&target.instance, &task.src, &task.dest)
            .json(),
    );
    put(
        "target_object",
        json!({"id": target.asset, "name": target.instance, "category": target.category}),
    );
    put("source_furniture", json!(task.src));
    put("destination_furniture", json!(task.dest));
    put("source_distractors", json!(task.src_distractors));
    put("destination_distractors", json!(task.dest_distractors));
    put("object_distractors", json!(task.object_distractors));
    put("distractor_metadata", distractor_metadata(task));
    put("execution_plan", json!(task.plan));
    payload.into()
}

/// What the task file says of the assets of distractors, by asset: the trainer knows the category
/// of an object from it. The loader keeps what differs from the object itself.
fn distractor_metadata(task: &Task) -> Value {
    let kept = |asset: &str| {
        task.extra
            .get(&format!("{DISTRACTOR_META}{asset}"))
            .cloned()
    };
    let placed = |asset: &str| {
        task.objects
            .iter()
            .find(|object| object.asset.as_str() == asset)
            .map(|object| object.asset_meta())
    };
    let of = |asset: &str| Some((asset.to_owned(), kept(asset).or_else(|| placed(asset))?));
    let mut metadata: Map<String, Value> = task
        .object_distractors
        .iter()
        .filter_map(|asset| of(asset.as_str()))
        .collect();
    let listed = task
        .extra
        .iter()
        .filter_map(|(path, meta)| Some((path.strip_prefix(DISTRACTOR_META)?, meta)));
    for (asset, meta) in listed {
        metadata.entry(asset).or_insert_with(|| meta.clone());
    }
    metadata.into()
}

/// A world graph in the published order.
pub(super) struct OrderedGraph(Vec<Entry>);

#[derive(Clone)]
struct Entry {
    receptacle: ReceptacleId,
    content: Vec<InstanceId>,
    /// Whether it stands open; `None` if there is no door.
    door: Option<bool>,
}

impl OrderedGraph {
    /// The objects on each receptacle, with the doors of a graph.
    pub(super) fn of(receptacles: &[(ReceptacleId, Vec<InstanceId>)], graph: &WorldGraph) -> Self {
        let entry = |(receptacle, content): &(ReceptacleId, Vec<InstanceId>)| Entry {
            receptacle: receptacle.clone(),
            content: content.clone(),
            door: graph.door(receptacle).map(|state| state == DoorState::Open),
        };
        Self(receptacles.iter().map(entry).collect())
    }

    fn initial(task: &Task, scene: &Scene) -> Self {
        let placed = task.placement_order();
        let on = |id: &ReceptacleId| {
            placed
                .iter()
                .map(|index| &task.objects[*index].instance)
                .filter(|instance| task.initial.receptacle_of(instance) == Some(id))
                .cloned()
                .collect()
        };
        let receptacles: Vec<_> = scene
            .receptacles
            .iter()
            .map(|receptacle| (receptacle.id.clone(), on(&receptacle.id)))
            .collect();
        Self::of(&receptacles, &task.initial)
    }

    /// The graph with an object moved: what the published agent scores, the file's own goal does
    /// not always conserve objects.
    fn moved(&self, object: &InstanceId, from: &ReceptacleId, to: &ReceptacleId) -> Self {
        let mut entries = self.0.clone();
        for entry in &mut entries {
            if entry.receptacle == *from {
                entry.content.retain(|other| other != object);
            }
            if entry.receptacle == *to && !entry.content.contains(object) {
                entry.content.push(object.clone());
            }
        }
        Self(entries)
    }

    /// `{receptacle: {content: [instance], door: bool}}`; a door is `true` where it is open.
    pub(super) fn json(&self) -> Value {
        let entry = |Entry {
                         receptacle,
                         content,
                         door,
                     }: &Entry| {
            let mut state = json!({ "content": content });
            if let Some(door) = door {
                state["door"] = json!(door);
            }
            (receptacle.to_string(), state)
        };
        self.0.iter().map(entry).collect::<Map<_, _>>().into()
    }

    /// A line for each receptacle that holds something.
    pub(super) fn text(&self) -> String {
        let line = |Entry {
                        receptacle,
                        content,
                        ..
                    }: &Entry| {
            let objects: Vec<String> = content.iter().map(|object| format!("'{object}'")).collect();
            format!("{receptacle}: [{}]\n", objects.join(", "))
        };
        self.0
            .iter()
            .filter(|entry| !entry.content.is_empty())
            .map(line)
            .collect()
    }
}
