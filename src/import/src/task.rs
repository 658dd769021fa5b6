//! The task and the scene of an episode: the real ones where they were given, else what
//! `task_meta.json` (or the `finish` payload, where a client kept it whole) and the graphs of the
//! steps say. Sizes and places are not in the files and are zero.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use reel_world::{
    AssetId, Door, Family, InstanceId, ObjectInstance, PlanStep, Receptacle, ReceptacleId, Room,
    Scene, Task, WorldGraph,
};
use serde_json::{Map, Value};

use crate::{ImportError, ImportOptions, graph};

/// Category of an object that nothing names.
const UNKNOWN: &str = "unknown";
/// Keys of `task_meta.json` and of the `finish` payload that have a place in a task or a header.
const KNOWN: &[&str] = &reel_world::words! {
    benchmark_task_id task_id family task_description scene_id model rooms_and_furniture
    initial_world_graph target_world_graph target_object source_furniture destination_furniture
    source_distractors destination_distractors object_distractors execution_plan
};
/// Keys that belong to the task and have no place of their own.
const OF_TASK: &[&str] = &reel_world::words! {
    global_index episode_idx episode_local_idx episode_range distractor_metadata
};

/// What the steps of an episode say of its world.
#[derive(Clone, Debug, Default)]
pub(crate) struct ObservedWorld {
    /// The first graph of a step, with what was held put back.
    pub first: Option<WorldGraph>,
    /// Every receptacle of every graph, with whether it has a door.
    pub receptacles: BTreeMap<ReceptacleId, bool>,
    /// Every object of every graph, with the place where it was first.
    pub objects: BTreeMap<InstanceId, ReceptacleId>,
    /// Categories that the robot was told.
    pub categories: BTreeMap<AssetId, String>,
}

impl ObservedWorld {
    /// Takes in what a graph shows.
    pub(crate) fn take_in(&mut self, graph: &WorldGraph) {
        for (receptacle, content) in &graph.receptacles {
            *self.receptacles.entry(receptacle.clone()).or_default() |= content.door.is_some();
            for object in content.content.keys() {
                self.objects
                    .entry(object.clone())
                    .or_insert_with(|| receptacle.clone());
            }
        }
    }
}

/// Where a task is told, and what was decided about it.
pub(crate) struct TaskSource<'a> {
    /// `task_meta.json`, or the payload of a `finish`.
    pub meta: &'a Map<String, Value>,
    /// Names of the folders of the task and of the scene, where files tell it.
    pub folders: [Option<String>; 2],
    /// The source of `meta` that error messages name.
    pub path: &'a Path,
    pub notes: Vec<String>,
}

/// The task of an episode and its scene.
#[derive(Clone, PartialEq, Debug)]
pub struct TaskSetup {
    /// The task that the episode plays.
    pub task: Task,
    /// The scene in which the task plays.
    pub scene: Scene,
    /// What the run said of itself besides the task.
    pub settings: BTreeMap<String, Value>,
}

/// Finds the task of an episode, or makes it from the files.
///
/// # Errors
/// When the files do not say what shall go where.
pub(crate) fn setting(
    told: &mut TaskSource<'_>,
    seen: &ObservedWorld,
    options: &ImportOptions<'_>,
) -> Result<TaskSetup, ImportError> {
    let meta = told.meta;
    let names = Names::of(told);
    let settings = settings(meta);
    let scene_id = text(meta, "scene_id")
        .or_else(|| told.folders[1].clone())
        .unwrap_or_else(|| UNKNOWN.to_owned());
    let known = |scene_id: &str| {
        options
            .scenes
            .and_then(|scenes| scenes.get(scene_id))
            .map(|scene| Scene::clone(scene))
    };
    if let Some(task) = options.tasks.iter().find(|task| names.mean(&task.task_id)) {
        let task = Task::clone(task);
        let scene = known(&task.scene_id)
            .unwrap_or_else(|| named_scene(&task.scene_id, meta, seen, &task.initial));
        compare_start(told, seen, &task);
        return Ok(TaskSetup {
            task,
            scene,
            settings,
        });
    }
    if !options.tasks.is_empty() {
        told.notes.push(format!(
            "none of the {} task files has the id {}",
            options.tasks.len(),
            names.task_id
        ));
    }
    let known_scene = known(&scene_id);
    let task = from_meta(told, names, scene_id, seen)?;
    let scene =
        known_scene.unwrap_or_else(|| named_scene(&task.scene_id, meta, seen, &task.initial));
    Ok(TaskSetup {
        task,
        scene,
        settings,
    })
}

/// Of an episode that does not say what shall go where.
pub(crate) fn unknown(told: &TaskSource<'_>, initial: WorldGraph) -> TaskSetup {
    let meta = told.meta;
    let names = Names::of(told);
    let scene_id = text(meta, "scene_id").unwrap_or_else(|| UNKNOWN.to_owned());
    let mut setting = unknown_task(
        names.task_id,
        text(meta, "task_description").unwrap_or_default(),
        scene_id,
        initial,
    );
    setting.task.family = names.family.unwrap_or(setting.task.family);
    TaskSetup {
        settings: settings(meta),
        ..setting
    }
}

/// What is neither of the task nor of the header.
fn settings(meta: &Map<String, Value>) -> BTreeMap<String, Value> {
    let known = |key: &str| KNOWN.contains(&key) || OF_TASK.contains(&key);
    let others = meta
        .iter()
        .filter(|(key, value)| !value.is_null() && !known(key));
    others
        .map(|(key, value)| (key.clone(), value.clone()))
        .collect()
}

/// A task without a goal, of which nothing is known but, perhaps, its words. Whether an episode of it
/// succeeded is what somebody reports.
pub fn unknown_task(
    task_id: String,
    instruction: String,
    scene_id: String,
    initial: WorldGraph,
) -> TaskSetup {
    let task = Task {
        placement_order: Vec::new(),
        task_id,
        family: Family::Other,
        task_type: None,
        scene_id: scene_id.clone(),
        precise_instruction: instruction.clone(),
        instruction,
        fuzzy: false,
        purpose: None,
        target: "".into(),
        objects: Vec::new(),
        goal: initial.clone(),
        initial,
        src: "".into(),
        dest: "".into(),
        src_distractors: Vec::new(),
        dest_distractors: Vec::new(),
        object_distractors: Vec::new(),
        plan: Vec::new(),
        published_goal: None,
        extra: BTreeMap::new(),
    };
    let scene = Scene {
        scene_id,
        rooms: Vec::new(),
        walls: None,
        robot_start: None,
        receptacles: Vec::new(),
        extra: BTreeMap::new(),
    };
    TaskSetup {
        task,
        scene,
        settings: BTreeMap::new(),
    }
}

/// What an episode's task may be called.
struct Names {
    task_id: String,
    family: Option<Family>,
    /// As the published agents turn the id into the name of a folder.
    folder: Option<String>,
}

impl Names {
    fn of(told: &TaskSource<'_>) -> Self {
        let meta = told.meta;
        let folder = told.folders[0].clone();
        let of_id = |id: &str| id.split(['/', '_']).next().and_then(Family::parse);
        let benchmark_id = text(meta, "benchmark_task_id");
        let named = text(meta, "family").as_deref().and_then(Family::parse);
        let family = named
            .or_else(|| benchmark_id.as_deref().and_then(of_id))
            .or_else(|| folder.as_deref().and_then(of_id));
        let short = text(meta, "task_id").map(|id| match family {
            Some(family) if !id.contains('/') => format!("{family}/{id}"),
            _ => id,
        });
        let task_id = benchmark_id
            .or(short)
            .or_else(|| folder.clone())
            .unwrap_or_else(|| UNKNOWN.to_owned());
        Self {
            task_id,
            family,
            folder: folder.filter(|_| meta.is_empty()),
        }
    }

    fn mean(&self, task_id: &str) -> bool {
        self.task_id == task_id
            || self
                .folder
                .as_ref()
                .is_some_and(|folder| *folder == task_id.replace('/', "_"))
    }
}

fn from_meta(
    told: &mut TaskSource<'_>,
    names: Names,
    scene_id: String,
    seen: &ObservedWorld,
) -> Result<Task, ImportError> {
    let (meta, path) = (told.meta, told.path);
    let missing = |what: &str| ImportError::Task {
        path: path.to_owned(),
        reason: what.to_owned(),
    };
    let src: ReceptacleId = text(meta, "source_furniture")
        .ok_or_else(|| missing("no source_furniture in task_meta.json"))?
        .into();
    let dest: ReceptacleId = text(meta, "destination_furniture")
        .ok_or_else(|| missing("no destination_furniture in task_meta.json"))?
        .into();
    let wanted = meta
        .get("target_object")
        .and_then(Value::as_object)
        .ok_or_else(|| missing("no target_object in task_meta.json"))?;
    let mut initial = meta
        .get("initial_world_graph")
        .and_then(graph::parse)
        .or_else(|| seen.first.clone())
        .unwrap_or_default();
    for receptacle in [&src, &dest] {
        initial.receptacles.entry(receptacle.clone()).or_default();
    }
    let by_asset = || {
        let asset: AssetId = text(wanted, "id")?.as_str().into();
        let here = initial
            .objects_on(&src)
            .into_iter()
            .find(|object| object.asset() == asset);
        here.or_else(|| Some(InstanceId::from(asset.as_str())))
    };
    let target: Option<InstanceId> = text(wanted, "name").map(Into::into).or_else(by_asset);
    let target = target
        .ok_or_else(|| missing("the target_object in task_meta.json has neither name nor id"))?;
    if initial.receptacle_of(&target) != Some(&src) && !initial.objects_on(&src).contains(&target) {
        told.notes.push(format!(
            "{target} stands not on {src} in the first graph; it is taken to have stood there"
        ));
        if let Some(place) = initial.receptacle_of(&target).cloned() {
            initial.remove(&place, &target);
        }
        initial.add(&src, &target);
    }
    let mut goal = initial.clone();
    goal.remove(&src, &target);
    goal.add(&dest, &target);

    let family = names.family.unwrap_or_else(|| {
        told.notes
            .push("the family is not known; it is taken as FDP".to_owned());
        Family::FDP
    });
    let instruction = text(meta, "task_description").unwrap_or_else(|| {
        told.notes.push("the instruction is not known".to_owned());
        String::new()
    });
    let receptacles = |key: &str| list(meta, key).map(Into::into).collect();
    Ok(Task {
        placement_order: Vec::new(),
        objects: objects(&initial, seen, &target, text(wanted, "category")),
        task_id: names.task_id,
        family,
        task_type: None,
        scene_id,
        precise_instruction: instruction.clone(),
        instruction,
        fuzzy: family == Family::SUL,
        purpose: None,
        initial,
        goal,
        target,
        src,
        dest,
        src_distractors: receptacles("source_distractors"),
        dest_distractors: receptacles("destination_distractors"),
        object_distractors: list(meta, "object_distractors").map(Into::into).collect(),
        plan: plan(meta),
        published_goal: meta
            .get("target_world_graph")
            .filter(|goal| !goal.is_null())
            .cloned(),
        extra: OF_TASK
            .iter()
            .filter_map(|key| Some(((*key).to_owned(), meta.get(*key)?.clone())))
            .collect(),
    })
}

/// Every object of the start, and those that turned up later.
fn objects(
    initial: &WorldGraph,
    seen: &ObservedWorld,
    target: &InstanceId,
    category: Option<String>,
) -> Vec<ObjectInstance> {
    let mut places = seen.objects.clone();
    for (receptacle, state) in &initial.receptacles {
        places.extend(
            state
                .content
                .keys()
                .map(|object| (object.clone(), receptacle.clone())),
        );
    }
    let object = |(instance, receptacle): (InstanceId, ReceptacleId)| {
        let told = seen.categories.get(&instance.asset()).cloned();
        let category = category
            .clone()
            .filter(|_| instance.asset() == target.asset())
            .or(told);
        ObjectInstance {
            asset: instance.asset(),
            category: category.unwrap_or_else(|| UNKNOWN.to_owned()),
            instance,
            caption: None,
            attributes: BTreeMap::new(),
            size: [0.0; 3],
            position: [0.0; 3],
            yaw: 0.0,
            receptacle,
            reference_rest: None,
        }
    };
    places.into_iter().map(object).collect()
}

fn plan(meta: &Map<String, Value>) -> Vec<PlanStep> {
    let steps = meta
        .get("execution_plan")
        .and_then(Value::as_array)
        .into_iter()
        .flatten();
    let step = |step: &Value| {
        let args = step
            .get("args")
            .and_then(Value::as_object)
            .cloned()
            .unwrap_or_default();
        Some(PlanStep {
            action: step.get("action")?.as_str()?.to_owned(),
            args: args.into_iter().collect(),
        })
    };
    steps.filter_map(step).collect()
}

/// Says where the first graph is not as the task file has it.
fn compare_start(told: &mut TaskSource<'_>, seen: &ObservedWorld, task: &Task) {
    let Some(first) = &seen.first else { return };
    let differences = first.difference(&task.initial);
    if !differences.is_empty() {
        let shown: Vec<String> = differences
            .iter()
            .take(4)
            .map(ToString::to_string)
            .collect();
        let count = differences.len();
        told.notes.push(format!(
            "the first graph differs from the task file in {count} places: {}",
            shown.join(" ")
        ));
    }
}

/// A scene of names: rooms where the files say them, and no geometry.
fn named_scene(
    scene_id: &str,
    meta: &Map<String, Value>,
    seen: &ObservedWorld,
    initial: &WorldGraph,
) -> Scene {
    let mut rooms: BTreeMap<ReceptacleId, String> = BTreeMap::new();
    for (room, furniture) in meta
        .get("rooms_and_furniture")
        .and_then(Value::as_object)
        .into_iter()
        .flatten()
    {
        for name in furniture
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
        {
            rooms.insert(name.into(), room.clone());
        }
    }
    let mut doors: BTreeMap<ReceptacleId, bool> =
        rooms.keys().map(|id| (id.clone(), false)).collect();
    for (id, has_door) in initial
        .receptacles
        .iter()
        .map(|(id, state)| (id, state.door.is_some()))
        .chain(seen.receptacles.iter().map(|(id, door)| (id, *door)))
    {
        *doors.entry(id.clone()).or_default() |= has_door;
    }
    let receptacle = |(id, has_door): (ReceptacleId, bool)| Receptacle {
        room: rooms
            .get(&id)
            .cloned()
            .unwrap_or_else(|| UNKNOWN.to_owned()),
        category: category_of(&id),
        door: if has_door { Door::Left } else { Door::None },
        captions: BTreeMap::new(),
        attributes: BTreeMap::new(),
        surface_min: [0.0; 3],
        surface_max: [0.0; 3],
        facing_deg: None,
        placeable: true,
        covers: None,
        part_of: None,
        geometry: None,
        extra: BTreeMap::new(),
        id,
    };
    let receptacles: Vec<Receptacle> = doors.into_iter().map(receptacle).collect();
    let names: BTreeSet<&str> = receptacles
        .iter()
        .map(|receptacle| receptacle.room.as_str())
        .collect();
    let room = |name: &str| Room {
        name: name.to_owned(),
        rects: Vec::new(),
        min: [0.0; 2],
        max: [0.0; 2],
        extra: BTreeMap::new(),
    };
    Scene {
        scene_id: scene_id.to_owned(),
        rooms: names.into_iter().map(room).collect(),
        walls: None,
        robot_start: None,
        receptacles,
        extra: BTreeMap::new(),
    }
}

/// `cabinet_6` is a `cabinet`.
fn category_of(id: &ReceptacleId) -> String {
    match id.as_str().rsplit_once('_') {
        Some((category, number))
            if !category.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit()) =>
        {
            category.to_owned()
        }
        _ => id.to_string(),
    }
}

/// A text of a mapping; none where it is missing, empty or something else.
pub(crate) fn text(map: &Map<String, Value>, key: &str) -> Option<String> {
    map.get(key)
        .and_then(Value::as_str)
        .filter(|text| !text.is_empty())
        .map(str::to_owned)
}

fn list<'a>(map: &'a Map<String, Value>, key: &str) -> impl Iterator<Item = &'a str> {
    map.get(key)
        .and_then(Value::as_array)
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
}
