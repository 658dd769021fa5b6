//! A household task: what stands where, what shall be where, and what the agent is told.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{AssetId, GraphEvent, InstanceId, ReceptacleId, Scene, WorldGraph};

/// Attribute words by kind, e.g. `colour -> [red, white]`.
pub type Attributes = BTreeMap<String, Vec<String>>;

/// The families of REAL-Bench (paper, Benchmark Construction), and one for all other tasks.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
pub enum Family {
    /// Furniture distractors, precise instruction.
    FDP,
    /// Furniture and object distractors, precise instruction.
    FODP,
    /// Furniture distractors with doors to open.
    FDO,
    /// Social: underspecified instruction, the agent must ask.
    SUL,
    /// A task outside REAL-Bench, e.g. of an agent that writes code.
    #[serde(rename = "other")]
    Other,
}

impl Family {
    /// The four of REAL-Bench, in the order of the paper's tables.
    pub const ALL: [Family; 4] = [Family::FDP, Family::FODP, Family::FDO, Family::SUL];

    /// As it stands in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Family::FDP => "FDP",
            Family::FODP => "FODP",
            Family::FDO => "FDO",
            Family::SUL => "SUL",
            Family::Other => "other",
        }
    }

    /// Reads what [`Family::as_str`] wrote of a family of REAL-Bench; [`Family::Other`] is none.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|family| family.as_str() == text)
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// One object of a task as it stands at the start.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ObjectInstance {
    /// Instance id: the key of the object in graphs and records.
    pub instance: InstanceId,
    /// The asset that this object is an instance of.
    pub asset: AssetId,
    /// Category of the object, e.g. `alarm clock`.
    pub category: String,
    /// How people would describe it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub caption: Option<String>,
    /// Attribute words by kind (colour, material, shape, size), which the renderer shows.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub attributes: Attributes,
    /// Width (x), depth (y), height (z) of the box at rest in the world, in metres.
    pub size: [f64; 3],
    /// Centre of that box before it settles: surface + half height + 0.02.
    pub position: [f64; 3],
    /// Rotation around z, in radians.
    #[serde(default)]
    pub yaw: f64,
    /// The receptacle it is placed on.
    pub receptacle: ReceptacleId,
    /// Where a simulator saw it come to rest, if the file says so (a check, never an input of
    /// ours): another one in published tasks, ours in those we make.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_rest: Option<[f64; 3]>,
}

impl ObjectInstance {
    /// What a task file says of its asset in `obj_meta` and `obj_distractor_meta`.
    pub fn asset_meta(&self) -> Value {
        let mut meta = serde_json::json!({ "category": self.category, "size": self.size });
        if let Some(caption) = &self.caption {
            meta["detailed_caption"] = Value::from(caption.as_str());
        }
        meta
    }
}

/// One step of a published plan.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct PlanStep {
    /// `nav_to`, `find`, `gaze_at`, `pick`, `place`, `open`, `close`, `ask`.
    pub action: String,
    /// Its arguments as published.
    pub args: BTreeMap<String, Value>,
}

/// A household task: objects, instruction, start graph and goal graph.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Task {
    /// e.g. `FDP/verify_task_10`; unique within a set of tasks.
    pub task_id: String,
    /// Family of REAL-Bench that the task belongs to, or [`Family::Other`].
    pub family: Family,
    /// e.g. `store`; absent where the file has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub task_type: Option<String>,
    /// The scene it plays in.
    pub scene_id: String,
    /// What the agent is told.
    pub instruction: String,
    /// The precise instruction; the same where the agent gets it.
    pub precise_instruction: String,
    /// Whether the agent gets less than the precise instruction (SUL).
    #[serde(default)]
    pub fuzzy: bool,
    /// What the target is for, in fuzzy tasks, e.g. `timekeeping device`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub purpose: Option<String>,
    /// Every object, sorted by instance.
    pub objects: Vec<ObjectInstance>,
    /// The objects in the order in which the file places them; empty if that order is the order of
    /// `objects`. The published servers list and number what stands on a receptacle in this order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub placement_order: Vec<InstanceId>,
    /// At the start: all receptacles of the scene, the objects, doors as they stand.
    pub initial: WorldGraph,
    /// At the end: the authority for reward and success (docs/spec.md#goal).
    pub goal: WorldGraph,
    /// The instance to move; the first one where a task moves several. Empty, like `src` and
    /// `dest`, where the task has no goal.
    pub target: InstanceId,
    /// Receptacle that holds the target at the start.
    pub src: ReceptacleId,
    /// Where it shall go.
    pub dest: ReceptacleId,
    /// Distractors for `src`: other receptacles that resemble it.
    #[serde(default)]
    pub src_distractors: Vec<ReceptacleId>,
    /// Distractors for `dest`: other receptacles that resemble it.
    #[serde(default)]
    pub dest_distractors: Vec<ReceptacleId>,
    /// Objects like the target.
    #[serde(default)]
    pub object_distractors: Vec<AssetId>,
    /// The published plan; empty where there is none.
    #[serde(default)]
    pub plan: Vec<PlanStep>,
    /// The file's own goal graph: stored, never scored (it need not conserve objects).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published_goal: Option<Value>,
    /// Fields we do not know, kept.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub extra: BTreeMap<String, Value>,
}

impl Task {
    /// Whether a world graph says what shall be moved where. A task without it names no target: its
    /// episodes have no rewards, and whether they succeeded is what somebody reported.
    pub fn has_goal(&self) -> bool {
        !self.target.as_str().is_empty()
    }

    /// `Delta_goal`: what must change (paper, Detailed Reward Configuration).
    pub fn goal_changes(&self) -> Vec<GraphEvent> {
        self.goal.difference(&self.initial)
    }

    /// The assets of its objects, each as often as there are objects of it.
    pub fn assets(&self) -> impl Iterator<Item = &AssetId> {
        self.objects.iter().map(|object| &object.asset)
    }

    /// The object of this instance id, or `None` if the task does not have it.
    pub fn object(&self, instance: &InstanceId) -> Option<&ObjectInstance> {
        self.objects
            .iter()
            .find(|object| object.instance == *instance)
    }

    /// Whether the goal wants an object elsewhere than it is at the start.
    pub fn moves(&self, object: &ObjectInstance) -> bool {
        self.goal.receptacle_of(&object.instance) != self.initial.receptacle_of(&object.instance)
    }

    /// The objects that the goal wants elsewhere.
    pub fn goal_objects(&self) -> impl Iterator<Item = &ObjectInstance> {
        self.objects.iter().filter(|object| self.moves(object))
    }

    /// Its id without the family: what the published files call `task_id`, unique
    /// within a family only.
    pub fn short_id(&self) -> &str {
        self.benchmark_id()
            .map_or(&self.task_id, |(_, short)| short)
    }

    /// The two parts of the id of a benchmark task, family and short id; `None` if the
    /// id names no family.
    pub fn benchmark_id(&self) -> Option<(&str, &str)> {
        self.task_id
            .split_once('/')
            .filter(|(family, _)| *family == self.family.as_str())
    }

    /// The indices of its objects in the order in which the file places them.
    pub fn placement_order(&self) -> Vec<usize> {
        let rank = |object: &ObjectInstance| {
            self.placement_order
                .iter()
                .position(|instance| *instance == object.instance)
        };
        let mut placed: Vec<usize> = (0..self.objects.len()).collect();
        placed.sort_by_key(|index| rank(&self.objects[*index]));
        placed
    }

    /// The target object.
    ///
    /// # Panics
    /// When the target is no object of the task; the loader refuses such tasks.
    pub fn target_object(&self) -> &ObjectInstance {
        self.object(&self.target)
            .expect("the loader checked that the target is an object of the task")
    }

    /// The start graph for a scene: every receptacle, closed doors, the given objects.
    pub fn initial_graph(scene: &Scene, objects: &[ObjectInstance]) -> WorldGraph {
        let mut graph = WorldGraph::default();
        for receptacle in &scene.receptacles {
            let state = graph.receptacles.entry(receptacle.id.clone()).or_default();
            state.door = receptacle.door.exists().then_some(crate::DoorState::Closed);
        }
        for object in objects {
            graph.add(&object.receptacle, &object.instance);
        }
        graph
    }
}
