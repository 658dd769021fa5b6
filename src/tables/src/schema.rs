//! The tables' columns with their types and meanings: the one source of the Arrow schemas and of `schemas/tables.md`.
//! Knows no rows and no files.

use std::sync::Arc;

use arrow::datatypes::{DataType, Field, Fields, Schema, SchemaRef};

/// A table.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Table {
    /// One row an episode, its steps nested.
    Episodes,
    /// Changes of the world graph, by both authorities.
    WorldDiffs,
    /// Reward terms.
    Rewards,
    /// One row a task.
    Tasks,
    /// The objects of the tasks.
    Objects,
    /// What the marker numbers stood for.
    Markers,
    /// What the camera saw.
    VisibleObjects,
    /// Questions to the user and the replies.
    Dialogue,
}

/// A column: its name, type, whether it may be null, and what it says.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Name in SQL.
    pub name: &'static str,
    /// Type.
    pub kind: Kind,
    /// Whether it may be null.
    pub nullable: bool,
    /// Meaning, with the unit where it has one.
    pub meaning: &'static str,
}

/// Type of a column.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// UTF-8.
    Text,
    /// True or false.
    Flag,
    /// 32-bit signed integer.
    Int,
    /// 64-bit signed integer.
    Long,
    /// 64-bit unsigned integer.
    Unsigned,
    /// 64-bit float.
    Float,
    /// A list.
    List(&'static Kind),
    /// Named fields.
    Struct(&'static [Column]),
}

use Kind::{Flag, Float, Int, List, Long, Struct, Text, Unsigned};

const fn must(name: &'static str, kind: Kind, meaning: &'static str) -> Column {
    Column { name, kind, nullable: false, meaning }
}

const fn may(name: &'static str, kind: Kind, meaning: &'static str) -> Column {
    Column { name, kind, nullable: true, meaning }
}

/// Columns of a step, nested in [`Table::Episodes`] and flat in the view `steps`.
pub const STEP: &[Column] = &[
    must("step", Int, "decision, from 0"),
    must("tool", Text, "the paper's name of the tool; the name as called where it is no tool"),
    must("call_name", Text, "the name as called"),
    must("arguments", Text, "the arguments as called, JSON"),
    may("argument", Text, "the tool's one argument as plain text: receptacle, category, marker or question"),
    must("text", Text, "what the policy was told"),
    may("error_code", Text, "why the call failed; null: it did what it should"),
    may("error_class", Text, "`severe` or `moderate`"),
    may("object", Text, "instance that the call acted on"),
    may("receptacle", Text, "receptacle that the call acted on"),
    may("goal_object", Flag, "whether that object is one the goal moves"),
    may("goal_receptacle", Flag, "whether that receptacle is where the goal wants that object"),
    may("held", Text, "instance in the gripper after the call"),
    must("markers", Int, "numbers in the marker map after the call"),
    must("visible", Int, "objects in the picture"),
    must(
        "candidates",
        Int,
        "different objects of the target's category, or among the task's object distractors, seen or listed so far",
    ),
    must("reward", Float, "sum of the reward terms under the episode's preset"),
    must("sim_step", Long, "simulation time after the call, in physics steps of 1/240 s"),
    must("robot_x_m", Float, "base of the robot, metres"),
    must("robot_y_m", Float, "base of the robot, metres"),
    must("robot_yaw_rad", Float, "heading, radians, 0 looks along +x"),
    must("path_length_m", Float, "path driven so far, metres"),
    may("latency_ns", Long, "how long the policy took, nanoseconds of wall-clock time"),
    may("reasoning", Text, "the policy's reasoning"),
    may("history", Text, "the policy's own summary"),
    may("plan", Text, "the policy's schedule and subtask"),
    may("question", Text, "what an `ask` asked"),
    may("reply", Text, "what the user answered"),
    may("reply_source", Text, "who answered: `rule-based`, `model`, `human`"),
    must("state_digest", Text, "digest of the simulator state after the call"),
    must("chain_digest", Text, "hash chain up to this step"),
    must("trace_offset", Long, "byte of the trace file at which the step's first message stands"),
];

const EPISODES: &[Column] = &[
    must("episode_id", Text, "digest of the episode's inputs, shortened"),
    must("run_id", Text, "the command that recorded it"),
    may("group_id", Text, "prompt group of a rollout"),
    may("rollout_index", Int, "index in that group"),
    must("task_id", Text, "the task"),
    must("task_digest", Text, "joins `tasks` and `objects`"),
    must("family", Text, "`FDP`, `FODP`, `FDO`, `SUL`"),
    may("task_type", Text, "e.g. `store`"),
    must("scene_id", Text, "the scene"),
    must("policy", Text, "who decided"),
    may("checkpoint", Text, "digest of a model's checkpoint"),
    must("seed", Unsigned, "seed of everything random"),
    must("profile", Text, "`paper` or `real-repo`"),
    must("preset", Text, "reward preset of the terms and metrics"),
    must("sim_version", Int, "version of the simulator"),
    must("build", Text, "version of Reel that recorded it"),
    must("backend", Text, "`sim`, `robot`, `proxy`"),
    may("end_reason", Text, "`finished`, `horizon`, `fault`, `aborted`; null: the trace breaks off"),
    may("success", Flag, "SR: no goal change is left; null where the trace breaks off, like the next six"),
    may("completion", Float, "CR: share of the goal changes that hold"),
    may("total_reward", Float, "cumulative reward, undiscounted"),
    may("discounted_return", Float, "discounted by 0.99 a step"),
    may("length", Int, "decisions"),
    may("asks", Int, "`ask` calls"),
    may("spl", Float, "success weighted by path length; null where no shortest path is known"),
    must("instruction", Text, "what the agent was told"),
    must("fuzzy", Flag, "whether it was told less than the precise instruction"),
    may("purpose", Text, "what the target is for, in fuzzy tasks"),
    must("target", Text, "instance to move"),
    must("target_category", Text, "its category"),
    may("target_caption", Text, "how people would describe it"),
    must("src", Text, "receptacle it stands on"),
    must("dest", Text, "receptacle it shall go to"),
    may("shortest_path_m", Float, "shortest base path start, source, destination, metres"),
    must("path_length_m", Float, "path the base drove, metres"),
    must("trace_uri", Text, "the trace file, as it was given to `ingest`"),
    must("trace_digest", Text, "the trace's chain digest"),
    must("trace_bytes", Long, "size of the trace file"),
    must("steps", List(&Struct(STEP)), "the decisions in order"),
];

const WORLD_DIFFS: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("step", Int, "the decision"),
    must("authority", Text, "whose graph changed: `physics` or `registry`"),
    must("event", Text, "`add`, `remove` or `door`"),
    may("object", Text, "instance that came or left"),
    may("asset", Text, "its asset"),
    must("receptacle", Text, "where; `floor` is a place"),
    may("door_from", Text, "door before: `open` or `closed`"),
    may("door_to", Text, "door after"),
];

const REWARDS: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("step", Int, "the decision"),
    must("preset", Text, "reward preset"),
    must("component", Text, "`task`, `prog`, `phys`, `ask`, `time`, `safe`"),
    must("value", Float, "the term"),
    must("reason", Text, "which event or rule gave it"),
];

const TASKS: &[Column] = &[
    must("task_id", Text, "the task"),
    must("task_digest", Text, "digest of the task's canonical JSON; the key"),
    must("family", Text, "`FDP`, `FODP`, `FDO`, `SUL`"),
    may("task_type", Text, "e.g. `store`"),
    must("scene_id", Text, "the scene"),
    must("instruction", Text, "what the agent is told"),
    must("precise_instruction", Text, "the precise instruction"),
    must("fuzzy", Flag, "whether the agent is told less than that"),
    may("purpose", Text, "what the target is for"),
    must("target", Text, "instance to move"),
    must("target_category", Text, "its category"),
    must("src", Text, "where it stands"),
    must("dest", Text, "where it shall go"),
    may("src_door", Text, "door of the source at the start: `open`, `closed`; null: it has none"),
    may("dest_door", Text, "door of the destination at the start"),
    must("src_distractors", List(&Text), "receptacles like the source"),
    must("dest_distractors", List(&Text), "receptacles like the destination"),
    must("object_distractors", List(&Text), "assets like the target"),
    must("goal_changes", List(&Text), "what must change, as in the paper: `+object@receptacle`"),
    must("objects", Int, "how many objects there are"),
];

const OBJECTS: &[Column] = &[
    must("task_id", Text, "the task"),
    must("task_digest", Text, "joins `tasks` and `episodes`"),
    must("instance", Text, "the object's key"),
    must("asset", Text, "its asset"),
    must("category", Text, "e.g. `alarm clock`"),
    may("caption", Text, "how people would describe it"),
    must(
        "attributes",
        List(&Struct(&[must("kind", Text, "e.g. `colour`"), must("word", Text, "e.g. `red`")])),
        "attribute words",
    ),
    must("width_m", Float, "along x at rest, metres"),
    must("depth_m", Float, "along y at rest, metres"),
    must("height_m", Float, "along z at rest, metres"),
    must("receptacle", Text, "where it is placed"),
    must("role", Text, "`target`, `distractor` (one of the task's object distractors, or of the target's category) or `other`"),
];

const MARKERS: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("step", Int, "the decision after which the map held"),
    must("marker", Int, "the number"),
    must("kind", Text, "`object` or `receptacle`"),
    must("id", Text, "instance or receptacle"),
];

const VISIBLE_OBJECTS: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("step", Int, "the decision after which the picture was taken; -1: before the first"),
    must("object", Text, "instance"),
    must("pixels", Int, "how many pixels of it are seen"),
    must("x_min", Int, "bounding box, pixels from the left, inclusive"),
    must("y_min", Int, "pixels from the top"),
    must("x_max", Int, "inclusive"),
    must("y_max", Int, "inclusive"),
];

const DIALOGUE: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("step", Int, "the decision"),
    must("question", Text, "what was asked"),
    may("reply", Text, "the answer; null: nobody answered"),
    may("source", Text, "who answered: `rule-based`, `model`, `human`"),
];

impl Table {
    /// Every table, in the order of the documents.
    pub const ALL: [Table; 8] = [
        Table::Episodes,
        Table::WorldDiffs,
        Table::Rewards,
        Table::Tasks,
        Table::Objects,
        Table::Markers,
        Table::VisibleObjects,
        Table::Dialogue,
    ];

    /// Its name in SQL and as a folder.
    pub fn name(self) -> &'static str {
        match self {
            Table::Episodes => "episodes",
            Table::WorldDiffs => "world_diffs",
            Table::Rewards => "rewards",
            Table::Tasks => "tasks",
            Table::Objects => "objects",
            Table::Markers => "markers",
            Table::VisibleObjects => "visible_objects",
            Table::Dialogue => "dialogue",
        }
    }

    /// What a row is.
    pub fn meaning(self) -> &'static str {
        match self {
            Table::Episodes => "One row an episode, its steps nested.",
            Table::WorldDiffs => "One row a change of a world graph (moving an object gives two).",
            Table::Rewards => "One row a reward term that is not zero.",
            Table::Tasks => "One row a task, however many episodes play it.",
            Table::Objects => "One row an object of a task.",
            Table::Markers => "One row a number of the marker map after a call.",
            Table::VisibleObjects => "One row an object in a picture.",
            Table::Dialogue => "One row a question.",
        }
    }

    /// Its columns.
    pub fn columns(self) -> &'static [Column] {
        match self {
            Table::Episodes => EPISODES,
            Table::WorldDiffs => WORLD_DIFFS,
            Table::Rewards => REWARDS,
            Table::Tasks => TASKS,
            Table::Objects => OBJECTS,
            Table::Markers => MARKERS,
            Table::VisibleObjects => VISIBLE_OBJECTS,
            Table::Dialogue => DIALOGUE,
        }
    }

    /// Its Arrow schema.
    pub fn schema(self) -> SchemaRef {
        Arc::new(Schema::new(fields(self.columns())))
    }

    /// Whether its rows belong to a task (and are stored once a task) rather than to an episode.
    pub fn is_by_task(self) -> bool {
        matches!(self, Table::Tasks | Table::Objects)
    }
}

fn fields(columns: &[Column]) -> Fields {
    columns.iter().map(|column| Field::new(column.name, data_type(column.kind), column.nullable)).collect()
}

fn data_type(kind: Kind) -> DataType {
    match kind {
        Text => DataType::Utf8,
        Flag => DataType::Boolean,
        Int => DataType::Int32,
        Long => DataType::Int64,
        Unsigned => DataType::UInt64,
        Float => DataType::Float64,
        List(item) => DataType::List(Arc::new(Field::new("item", data_type(*item), false))),
        Struct(columns) => DataType::Struct(fields(columns)),
    }
}

/// The tables as a Markdown page: `schemas/tables.md`.
pub fn document() -> String {
    let mut page = String::from(
        "# Tables\n\nWritten by `reel ingest`, asked by `reel query`. Parquet (zstd), one folder a table. The view `steps` is the \
         nested list\n`episodes.steps`, flat: `episode_id, policy, family, task_id, success` and the columns of a step.\n",
    );
    for table in Table::ALL {
        page.push_str(&format!("\n## `{}`\n{}\n\n", table.name(), table.meaning()));
        document_columns(table.columns(), &mut page);
    }
    page.push_str("\n## A step (`episodes.steps`, view `steps`)\n\n");
    document_columns(STEP, &mut page);
    page
}

fn document_columns(columns: &[Column], page: &mut String) {
    page.push_str("| column | type | meaning |\n|---|---|---|\n");
    for column in columns {
        let null = if column.nullable { ", may be null" } else { "" };
        page.push_str(&format!("| `{}` | {}{null} | {} |\n", column.name, type_name(column.kind), column.meaning));
    }
}

fn type_name(kind: Kind) -> String {
    match kind {
        Text => "text".into(),
        Flag => "boolean".into(),
        Int => "int32".into(),
        Long => "int64".into(),
        Unsigned => "uint64".into(),
        Float => "float64".into(),
        List(Struct(columns)) if columns.len() == STEP.len() => "list of steps, see below".into(),
        List(item) => format!("list of {}", type_name(*item)),
        Struct(columns) => {
            let inner: Vec<String> = columns.iter().map(|column| format!("{} {}", column.name, type_name(column.kind))).collect();
            format!("struct({})", inner.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `REEL_BLESS=1 cargo test -p reel-tables` rewrites the page.
    #[test]
    fn the_page_says_what_the_schemas_say() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../schemas/tables.md");
        if std::env::var_os("REEL_BLESS").is_some() {
            std::fs::write(path, document()).unwrap();
        }
        let page = std::fs::read_to_string(path).unwrap_or_default();
        assert_eq!(page, document(), "schemas/tables.md is stale: run REEL_BLESS=1 cargo test -p reel-tables");
    }
}
