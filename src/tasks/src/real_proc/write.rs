//! Tasks as files of REAL's task generator.

use std::collections::BTreeMap;

use reel_world::{InstanceId, PlanStep, ReceptacleId, Scene, Task};
use serde_json::{Map, Value, json};

use crate::{wording, yaml};

/// A task type of the generator, with what only its episodes have.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum ProcKind {
    /// One object moves; look-alike furniture stands in for distractors.
    Basic,
    /// One object moves, and others distract from it.
    Distractor,
    /// One object moves into or out of something with a door; `subtype` is `store` or `retrieve`.
    Articulation {
        /// `store` or `retrieve`: whether the object goes behind the door or comes from there.
        subtype: String,
    },
    /// One object moves, and the instruction does not say which.
    Interactive {
        /// The instruction that does.
        detailed: String,
        /// What the object is for.
        purpose: String,
        /// Name of the objects that are for it.
        purpose_group: String,
    },
    /// Several objects move to one place.
    Gather {
        /// Where the sources are, e.g. `same_room`.
        mode: String,
        /// The instruction that does not name the objects.
        fuzzy: String,
        /// What the objects are for.
        purpose: String,
        /// Name of the objects that are for it.
        purpose_group: String,
        /// Where each object is.
        sources: Vec<Source>,
        /// Room of the destination.
        dest_room: String,
        /// How the destination is called.
        dest_caption: String,
        /// Receptacles like each source, by its name.
        src_distractors: Map<String, Value>,
    },
}

impl ProcKind {
    /// As it stands in files and in their names.
    pub fn as_str(&self) -> &'static str {
        match self {
            ProcKind::Basic => "basic",
            ProcKind::Distractor => "distractor",
            ProcKind::Articulation { .. } => "articulation",
            ProcKind::Interactive { .. } => "interactive",
            ProcKind::Gather { .. } => "gather",
        }
    }
}

/// Where an object of a gathering is.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Source {
    /// Id of the receptacle, e.g. `table_1`.
    pub name: String,
    /// Id of the room that the receptacle stands in, e.g. `kitchen/0`.
    pub room: String,
    /// How it is called.
    pub reference: String,
    /// The object that is collected from there.
    pub object: String,
}

/// An object of an episode.
#[derive(Clone, PartialEq, Debug)]
pub struct ProcObject {
    /// Its asset; a leading `_` is dropped in files.
    pub asset: String,
    /// Category of the object, e.g. `mug`.
    pub category: String,
    /// Path of its USD file.
    pub usd_path: String,
    /// Scale along x, y and z.
    pub usd_scale: Value,
    /// Centre of its box before it settles, in metres; micrometres are dropped.
    pub position: [f64; 3],
    /// Width, depth and height, in metres; micrometres are dropped.
    pub size: [f64; 3],
    /// The receptacle it stands on.
    pub furniture: String,
}

/// An episode of such a file.
#[derive(Clone, PartialEq, Debug)]
pub struct ProcEpisode {
    /// Id of the scene that the file's episodes play in.
    pub scene_id: String,
    /// Type of the tasks in the file.
    pub kind: ProcKind,
    /// What the agent is told.
    pub instruction: String,
    /// Where the target is.
    pub src: String,
    /// Other receptacles of the source's kind.
    pub src_distractors: Vec<String>,
    /// Where the target shall go.
    pub dest: String,
    /// Other receptacles of the destination's kind.
    pub dest_distractors: Vec<String>,
    /// Assets of what moves; one but for gatherings.
    pub targets: Vec<String>,
    /// Assets of what distracts from the target, with their categories.
    pub distractors: Vec<(String, String)>,
    /// The plan, each step with the asset that it picks.
    pub plan: Vec<(PlanStep, String)>,
    /// Everything that is placed, in the order of `obj_0`, `obj_1`, ...
    pub objects: Vec<ProcObject>,
}

/// A file: its path below the folder of the set, and what it holds.
#[derive(Clone, PartialEq, Debug)]
pub struct ProcFile {
    /// Path below the output folder, `<scene>/<type>.yaml`.
    pub path: String,
    /// The document, keys in the generator's order.
    pub document: Value,
}

impl ProcFile {
    /// The text of the file.
    pub fn text(&self) -> String {
        yaml::text(&self.document)
    }
}

/// Tasks as files, one for each scene and type, in the order of their paths; episodes keep the
/// order of the tasks. `scenes` are those of the tasks, one each.
pub fn export<'a>(tasks: impl IntoIterator<Item = (&'a Task, &'a Scene)>) -> Vec<ProcFile> {
    group(
        tasks
            .into_iter()
            .map(|(task, scene)| ProcEpisode::of(task, scene))
            .collect(),
    )
}

/// Episodes as files, one for each scene and type, in the order of their paths.
pub fn group(episodes: Vec<ProcEpisode>) -> Vec<ProcFile> {
    let mut files: BTreeMap<String, Vec<ProcEpisode>> = BTreeMap::new();
    for episode in episodes {
        let path = format!("{}/{}.yaml", episode.scene_id, episode.kind.as_str());
        files.entry(path).or_default().push(episode);
    }
    files
        .into_iter()
        .map(|(path, episodes)| ProcFile {
            document: document(&episodes),
            path,
        })
        .collect()
}

/// What published code finds of a scene, by its id.
pub fn paths(scene_id: &str) -> Value {
    let folder = format!("assets/metadata/{scene_id}");
    json!({
        "scene_usd": format!("assets/scenes/{scene_id}_usd/scene.usd"),
        "occ_map_dir": folder,
        "furniture_lib": format!("{folder}/scene_furniture_library.json"),
    })
}

/// Name of the objects for a purpose: `drinking vessel` has `drinking_vessels`.
pub fn purpose_group(purpose: &str) -> String {
    format!("{}s", purpose.replace(' ', "_"))
}

fn document(episodes: &[ProcEpisode]) -> Value {
    let first = episodes
        .first()
        .expect("a file is made for its first episode");
    let mut objects = Map::new();
    let mut written = Vec::new();
    for (index, episode) in episodes.iter().enumerate() {
        let mut placements = Map::new();
        for object in &episode.objects {
            let key = format!("obj_{}", objects.len());
            placements.insert(
                key.clone(),
                json!({ "original_id": strip_underscore(&object.asset), "furniture": object.furniture }),
            );
            objects.insert(key, object_entry(object));
        }
        written.push(episode_entry(episode, index, placements));
    }
    json!({
        "scene_id": first.scene_id,
        "task_type": first.kind.as_str(),
        "paths": paths(&first.scene_id),
        "objects": objects,
        "episodes": written,
    })
}

fn object_entry(object: &ProcObject) -> Value {
    json!({
        "original_id": strip_underscore(&object.asset),
        "category": object.category,
        "usd_path": object.usd_path,
        "usd_scale": object.usd_scale,
        "position": object.position.map(micrometres),
        "size": object.size.map(micrometres),
    })
}

fn episode_entry(episode: &ProcEpisode, index: usize, placements: Map<String, Value>) -> Value {
    let mut entry = Map::new();
    let mut put = |key: &str, value: Value| entry.insert(key.to_owned(), value);
    put("task_id", json!(format!("task_{index}")));
    put("task_type", json!(episode.kind.as_str()));
    put("task_description", json!(episode.instruction));
    let targets: Vec<&str> = episode
        .targets
        .iter()
        .map(|asset| strip_underscore(asset))
        .collect();
    let route = |put: &mut dyn FnMut(&str, Value) -> Option<Value>| {
        put("src", json!(episode.src));
        put("dest", json!(episode.dest));
        put("target_object_id", json!(targets.first()));
        put("src_distractors", json!(episode.src_distractors));
        put("dest_distractors", json!(episode.dest_distractors));
        put(
            "obj_distractors",
            json!(
                episode
                    .distractors
                    .iter()
                    .map(|(asset, _)| strip_underscore(asset))
                    .collect::<Vec<_>>()
            ),
        );
    };
    match &episode.kind {
        ProcKind::Basic | ProcKind::Distractor => route(&mut put),
        ProcKind::Articulation { subtype } => {
            put("articulation_subtype", json!(subtype));
            route(&mut put);
        }
        ProcKind::Interactive {
            detailed,
            purpose,
            purpose_group,
        } => {
            put("detailed_task_description", json!(detailed));
            put("purpose", json!(purpose));
            put("purpose_group", json!(purpose_group));
            route(&mut put);
        }
        ProcKind::Gather {
            mode,
            fuzzy,
            purpose,
            purpose_group,
            sources,
            dest_room,
            dest_caption,
            src_distractors,
        } => {
            let source = |source: &Source| json!({ "name": source.name, "room": source.room, "ref": source.reference, "object_uid": source.object });
            put("fuzzy_task_description", json!(fuzzy));
            put("mode", json!(mode));
            put("purpose", json!(purpose));
            put("purpose_group", json!(purpose_group));
            put(
                "sources",
                json!(sources.iter().map(source).collect::<Vec<_>>()),
            );
            put("dest", json!(episode.dest));
            put("dest_room", json!(dest_room));
            put("dest_caption", json!(dest_caption));
            put("target_object_ids", json!(targets));
            put(
                "src_furniture_distractors",
                Value::Object(src_distractors.clone()),
            );
            put(
                "dest_furniture_distractors",
                json!(episode.dest_distractors),
            );
            // The generator groups a gathering's distractors by source and its exporter
            // writes the groups' names.
            put(
                "obj_distractors",
                json!(
                    sources
                        .iter()
                        .map(|source| &source.name)
                        .collect::<Vec<_>>()
                ),
            );
        }
    }
    let meta = |(asset, category): &(String, String)| {
        (
            strip_underscore(asset).to_owned(),
            json!({ "category": category }),
        )
    };
    put(
        "obj_distractor_meta",
        Value::Object(episode.distractors.iter().map(meta).collect()),
    );
    put(
        "execution_plan",
        json!(
            episode
                .plan
                .iter()
                .map(|(step, asset)| step.to_text(strip_underscore(asset)))
                .collect::<Vec<_>>()
        ),
    );
    put("placements", Value::Object(placements));
    Value::Object(entry)
}

impl ProcEpisode {
    /// A task as the generator has it. Objects of tasks that were read from published files keep
    /// their USD files; others get the name that published code would look for, `<asset>.usd`.
    pub fn of(task: &Task, scene: &Scene) -> Self {
        let asset = |instance: &InstanceId| {
            task.object(instance)
                .map_or(instance.asset(), |object| object.asset.clone())
        };
        let names = |ids: &[ReceptacleId]| ids.iter().map(ToString::to_string).collect::<Vec<_>>();
        let extra = |object: &InstanceId, key: &str| {
            task.extra.get(&format!("objects.{object}.{key}")).cloned()
        };
        let objects = task.objects.iter().map(|object| ProcObject {
            asset: object.asset.to_string(),
            category: object.category.clone(),
            usd_path: extra(&object.instance, "usd_path")
                .and_then(|path| path.as_str().map(str::to_owned))
                .unwrap_or_else(|| format!("{}.usd", object.asset)),
            usd_scale: extra(&object.instance, "usd_scale")
                .unwrap_or_else(|| json!([1.0, 1.0, 1.0])),
            position: object.position,
            size: object.size,
            furniture: object.receptacle.to_string(),
        });
        let category = |asset: &str| {
            let placed = task
                .objects
                .iter()
                .find(|object| object.asset.as_str() == asset);
            placed.map(|object| object.category.clone())
        };
        let distractors = task
            .object_distractors
            .iter()
            .filter_map(|asset| Some((asset.to_string(), category(asset.as_str())?)));
        let mut moved: Vec<InstanceId> = task
            .goal_objects()
            .map(|object| object.instance.clone())
            .collect();
        // The target comes first.
        moved.sort_by_key(|instance| *instance != task.target);
        let picked = |step: &PlanStep| match step.text_argument("instance") {
            Some(instance) => asset(&instance.into()).to_string(),
            None => asset(&task.target).to_string(),
        };
        let plan = task.plan.iter().map(|step| {
            // Which of several objects is meant, the texts say by its id.
            let mut told = step.clone();
            told.args.remove("instance");
            if let (Some(category), Some(caption)) = (
                step.text_argument("target_category"),
                step.text_argument("target_description"),
            ) {
                told.args.insert(
                    "target_description".to_owned(),
                    json!(wording::naming_category(caption, category)),
                );
            }
            (told, picked(step))
        });
        ProcEpisode {
            scene_id: task.scene_id.clone(),
            kind: kind(task, scene, &moved),
            instruction: task.instruction.clone(),
            src: task.src.to_string(),
            src_distractors: names(&task.src_distractors),
            dest: task.dest.to_string(),
            dest_distractors: names(&task.dest_distractors),
            targets: moved
                .iter()
                .map(|instance| asset(instance).to_string())
                .collect(),
            distractors: distractors.collect(),
            plan: plan.collect(),
            objects: objects.collect(),
        }
    }
}

fn kind(task: &Task, scene: &Scene, moved: &[InstanceId]) -> ProcKind {
    let purpose = task
        .purpose
        .clone()
        .unwrap_or_else(|| task.target_object().category.clone());
    let purpose_group = purpose_group(&purpose);
    let room = |id: &ReceptacleId| {
        scene
            .receptacle(id)
            .map(|receptacle| receptacle.room.clone())
            .unwrap_or_default()
    };
    let phrase = |id: &ReceptacleId| {
        format!(
            "the {}",
            wording::furniture_name(wording::furniture(id.as_str()).0)
        )
    };
    if moved.len() > 1 {
        let sources: Vec<Source> = moved
            .iter()
            .filter_map(|instance| task.object(instance))
            .map(|object| Source {
                name: object.receptacle.to_string(),
                room: room(&object.receptacle),
                reference: phrase(&object.receptacle),
                object: object.asset.to_string(),
            })
            .collect();
        let dest_room = room(&task.dest);
        let same = sources.iter().all(|source| source.room == dest_room);
        let alike = |name: &str| {
            let own = wording::furniture(name).0;
            let others = scene
                .receptacles
                .iter()
                .map(|receptacle| receptacle.id.as_str());
            let mut others: Vec<&str> = others
                .filter(|id| *id != name && wording::furniture(id).0 == own)
                .collect();
            others.sort_by_key(|id| wording::furniture(id));
            json!(others)
        };
        return ProcKind::Gather {
            mode: if same { "same_room" } else { "cross_room" }.to_owned(),
            fuzzy: task.instruction.clone(),
            purpose,
            purpose_group,
            src_distractors: sources
                .iter()
                .map(|source| (source.name.clone(), alike(&source.name)))
                .collect(),
            sources,
            dest_room,
            dest_caption: phrase(&task.dest),
        };
    }
    if task.fuzzy {
        return ProcKind::Interactive {
            detailed: task.precise_instruction.clone(),
            purpose,
            purpose_group,
        };
    }
    match task.task_type.as_deref() {
        Some(subtype @ ("store" | "retrieve")) => ProcKind::Articulation {
            subtype: subtype.to_owned(),
        },
        _ if task.objects.len() > 1 => ProcKind::Distractor,
        _ => ProcKind::Basic,
    }
}

/// An id as it stands in files: without the `_` that some begin with.
pub fn strip_underscore(id: &str) -> &str {
    id.trim_start_matches('_')
}

fn micrometres(length_m: f64) -> f64 {
    (length_m * 1e6).round() / 1e6
}
