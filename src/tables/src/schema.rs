//! The tables' columns with their types and meanings: the one source of the Arrow schemas and of `schemas/tables.md`.
//! Knows no rows and no files.
//!
//! What belongs to an episode is nested in its row, so that an episode appears and disappears as a whole; the flat forms are
//! views ([`View`]).

use std::{fmt::Write as _, sync::Arc};

use arrow::datatypes::{DataType, Field, Fields, Schema, SchemaRef};

/// A stored table.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Table {
    /// One row an episode, its steps nested.
    Episodes,
    /// One row a task, its objects nested.
    Tasks,
    /// One row a scene, its receptacles nested.
    Scenes,
    /// Rewards that were recomputed, one row an episode and version of a preset.
    Rescored,
    /// Files that were left out.
    Quarantine,
    /// Why failed episodes failed, by the rules.
    Classes,
    /// Why episodes failed, measured.
    Blame,
    /// Why they failed, by people, judges and those who injected the fault. The rules never read it.
    Labels,
    /// What replaying trace files found. Bound to no version of the store.
    Verdicts,
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
    /// 64-bit unsigned integer; a decimal of 20 digits, because Delta Lake knows no unsigned numbers.
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

/// A change of a world graph.
const CHANGE: &[Column] = &[
    must("authority", Text, "whose graph changed: `physics` or `registry`"),
    must("event", Text, "`add`, `remove` or `door`"),
    may("object", Text, "instance that came or left"),
    may("asset", Text, "its asset"),
    must("receptacle", Text, "where; `floor` is a place"),
    may("door_from", Text, "door before: `open` or `closed`"),
    may("door_to", Text, "door after"),
];

/// A term of a reward.
const TERM: &[Column] = &[
    must("component", Text, "`task`, `prog`, `phys`, `ask`, `time`, `safe` in preset `paper`"),
    must("value", Float, "the term"),
    must("reason", Text, "which event or rule gave it"),
];

/// What a policy gives the tokens of a decision.
const LOGPROBS: &[Column] = &[
    must("policy", Text, "`old` sampled the tokens; others, e.g. `new` and `ref`, were added by `reel logprobs`"),
    must("logprobs", List(&Float), "natural logarithms, at most 0, one a token"),
];

/// A number of the marker map.
const MARKER: &[Column] = &[
    must("marker", Int, "the number"),
    must("kind", Text, "`object` or `receptacle`"),
    must("id", Text, "instance or receptacle"),
];

/// An object in a picture.
const VISIBLE: &[Column] = &[
    must("object", Text, "instance"),
    must("pixels", Int, "how many pixels of it are seen"),
    must("x_min", Int, "bounding box, pixels from the left, inclusive"),
    must("y_min", Int, "pixels from the top"),
    must("x_max", Int, "inclusive"),
    must("y_max", Int, "inclusive"),
];

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
    may(
        "object_like",
        Text,
        "that object beside the target: `target`, `instance` (another of its asset), `category` (another asset of its \
         category), `distractor` (named as one, of another category), `other`",
    ),
    may(
        "receptacle_like",
        Text,
        "that receptacle beside the destination: `dest`, `src`, `similar` (of its category, or named as its distractor), `other`",
    ),
    may("put_back", Flag, "of a successful `place`: whether the object is again where it stood at the start"),
    may("fell", Text, "what came to lie on the floor by this call: `target`, else `other`"),
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
    may("took_ns", Long, "how long the robot or the server took over the call, nanoseconds; null in Reel's own simulator"),
    may("reasoning", Text, "the policy's reasoning"),
    may("history", Text, "the policy's own summary"),
    may("plan", Text, "the policy's schedule and subtask"),
    may("question", Text, "what an `ask` asked"),
    may("reply", Text, "what the user answered"),
    may("reply_source", Text, "who answered: `rule-based`, `model`, `human`"),
    may("raw", Text, "the policy's output as it came"),
    may("tokens_read", Int, "tokens that the model read"),
    may("tokens_written", Int, "tokens that it wrote"),
    may(
        "tokens",
        List(&Text),
        "the tokens that it wrote, as the endpoint names them; null: their log-probabilities were not recorded",
    ),
    must("logprobs", List(&Struct(LOGPROBS)), "what policies give these tokens; the view `logprobs`"),
    must("contradictions", Int, "claims of the policy's own summary that the record refutes"),
    must("listed", List(&Text), "instances of whose existence the policy was told in words"),
    must("new_objects", List(&Text), "instances seen or listed for the first time"),
    must("changes", List(&Struct(CHANGE)), "changes of the world graphs; the view `world_diffs`"),
    must("terms", List(&Struct(TERM)), "reward terms under the episode's preset that are not zero; the view `rewards`"),
    must("marker_map", List(&Struct(MARKER)), "what the numbers stood for after the call; the view `markers`"),
    must("visible_objects", List(&Struct(VISIBLE)), "what the camera saw; the view `visible_objects`"),
    must("state_digest", Text, "digest of the simulator state after the call"),
    must("chain_digest", Text, "hash chain up to this step"),
    must("trace_offset", Long, "byte of the trace file at which the step's first message stands"),
];

/// What a robot measured beside its steps.
const MEASURED: &[Column] = &[
    must(
        "kind",
        Text,
        "`primitive`: an execution of a low-level skill; `vla`: an inference of the model beneath; `alignment`: how far off \
         a repeated command to navigate or gaze was",
    ),
    may("step", Int, "the decision during which it was measured; null: before the first"),
    may("skill", Text, "of a primitive: `pick`, `place`, `open`, `close` or another name"),
    may("target", Text, "of a primitive or an alignment: on or at what, in words"),
    may("success", Flag, "of a primitive: whether it did what it should"),
    may("took_ns", Long, "of a primitive or an inference: how long it took, nanoseconds"),
    may("control_steps", Int, "of a primitive: steps of the low-level controller"),
    may("error", Text, "of a primitive: what went wrong, in the robot's words"),
    may("odometry_error_m", Float, "of an alignment, like what follows: distance to the wanted position, metres"),
    may("yaw_error_rad", Float, "difference in heading, radians"),
    may("image_shift_px", Float, "shift of the picture, pixels"),
    may("image_rmse_px", Float, "root mean square error of the picture's registration, pixels"),
];

const EPISODES: &[Column] = &[
    must("episode_id", Text, "digest of the episode's inputs, shortened"),
    must("run_id", Text, "the command that recorded it"),
    may("group_id", Text, "prompt group of a rollout"),
    may("rollout_index", Int, "index in that group"),
    must("task_id", Text, "the task"),
    must("task_digest", Text, "joins `tasks` and `objects`"),
    must("scene_digest", Text, "joins `scenes`"),
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
    must("skills", Text, "how reliable the robot's skills were made: `perfect`, `real-v1`"),
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
    may("src_door", Text, "door of the source at the start: `open`, `closed`; null: it has none"),
    may("dest_door", Text, "door of the destination at the start"),
    may("shortest_path_m", Float, "shortest base path start, source, destination, metres"),
    must("path_length_m", Float, "path the base drove, metres"),
    may("parent_trace", Text, "digest of the trace this one branches from"),
    may("parent_call", Int, "first call that differs from the parent's"),
    must("start_changes", List(&Struct(CHANGE)), "how the graphs after settling differ from the task's"),
    must("start_objects", List(&Struct(VISIBLE)), "what the camera saw before the first decision"),
    must("trace", Text, "the trace file: what `replay`, `reward` and `frame` take"),
    must("trace_digest", Text, "the trace's chain digest"),
    must("trace_bytes", Long, "size of the trace file"),
    must("trace_modified_ns", Long, "when it was last written, nanoseconds since 1970; ingest skips files that are as they were"),
    must("measured", List(&Struct(MEASURED)), "what a robot measured; the view `measurements`"),
    must("steps", List(&Struct(STEP)), "the decisions in order"),
];

/// An object of a task.
const OBJECT: &[Column] = &[
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
    must("object_count", Int, "how many objects there are"),
    must("objects", List(&Struct(OBJECT)), "the objects; the view `objects`"),
    must("task", Text, "the whole task as JSON"),
];

/// A receptacle of a scene.
const RECEPTACLE: &[Column] = &[
    must("receptacle", Text, "e.g. `table_1`"),
    must("category", Text, "e.g. `table`"),
    must("room", Text, "its room"),
    must("has_door", Flag, "whether it can be opened"),
    must("placeable", Flag, "whether it may be placed upon"),
    must("captions", List(&Text), "how people call it"),
];

const SCENES: &[Column] = &[
    must("scene_digest", Text, "digest of the scene's canonical JSON; the key"),
    must("scene_id", Text, "its name"),
    must("rooms", List(&Text), "its rooms"),
    must("receptacles", List(&Struct(RECEPTACLE)), "its furniture"),
    must("scene", Text, "the whole scene as JSON"),
];

/// A term of a recomputed reward.
const STEP_TERM: &[Column] =
    &[must("step", Int, "the decision"), must("component", Text, "as the preset names it"), must("value", Float, "the term")];

const RESCORED: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("trace_digest", Text, "of the trace that was scored"),
    must("preset", Text, "name of the preset"),
    must("version", Text, "digest of the preset's content"),
    must("total_reward", Float, "cumulative reward, undiscounted"),
    must("discounted_return", Float, "discounted by the preset's gamma"),
    must("terms", List(&Struct(STEP_TERM)), "the terms that are not zero, in order"),
];

const QUARANTINE: &[Column] =
    &[must("trace", Text, "the file"), must("reason", Text, "why it was left out; gone as soon as the file is read whole")];

/// One more finding of the rules.
const FINDING: &[Column] = &[
    must("rule", Text, "name of the rule"),
    must("class", Text, "its class"),
    must("sub_class", Text, "its sub-class"),
    must("step", Int, "the first step of its evidence"),
    must("last_step", Int, "the last one"),
];

const CLASSES: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("trace_digest", Text, "of the trace that was judged"),
    must("rules_version", Text, "digest of the rule set"),
    must("class", Text, "`Object Confusion`, `Key Action Missing`, `Lost Memory`, `Other` (paper, Failure Mode Taxonomy)"),
    must("sub_class", Text, "what within that class, e.g. `missing_ask`"),
    must("rule", Text, "the rule that decided"),
    must("step", Int, "the decisive step: as `reel blame` measured it, else the first that the rule's evidence names"),
    must("last_step", Int, "the last step of the evidence"),
    must("fields", List(&Text), "columns of `episodes` and `steps` that the rule looked at"),
    must("evidence", Text, "`full`; `reduced` where the trace has no physics behind it and the rules saw less"),
    must("secondary", List(&Struct(FINDING)), "what else was found, in the order of their priority"),
];

const BLAME: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("trace_digest", Text, "of the trace that was measured"),
    may("step", Int, "the decisive step; null, as what follows, where nothing was lost"),
    may("tool", Text, "its tool"),
    may(
        "harm",
        Text,
        "`world`: it changed the world for the worse; `ending`: it ended too early; `time`: the way was lost there",
    ),
    may("cause", Text, "`perception`, `communication`, `memory` or `other`: which capacity failed"),
    may("why", Text, "in a sentence"),
    may("advice", Text, "what a competent agent would have called then"),
    must("wasted", Int, "decisions lost in all"),
    may("point_of_no_return", Int, "the step with which success went out of reach"),
    must("repairable_at_end", Flag, "whether success was still to be had before the last step"),
    must("perception", Float, "share of what was lost for good that is due to it; the four add up to 1"),
    must("communication", Float, "the same"),
    must("memory", Float, "the same"),
    must("other", Float, "the same"),
    may(
        "alternative",
        Text,
        "the policy that succeeds from the decisive step on: `planner` knows what the agent knew, `oracle` the truth",
    ),
    may("alternative_length", Int, "decisions of the whole episode then"),
    may("alternative_trace", Text, "the branch, where it was kept"),
    must("verified", Flag, "whether that branch was replayed and is exact"),
    may("reason", Text, "why there is no alternative"),
];

const LABELS: &[Column] = &[
    must("episode_id", Text, "the episode"),
    must("author", Text, "who says so: a person, a model, or `injected`"),
    must("kind", Text, "`human`, `judge`, `injected`, or `adjudicated`: decided where others disagreed"),
    must("class", Text, "one of the four classes"),
    may("sub_class", Text, "what within that class"),
    may("step", Int, "the decisive step"),
    may("confidence", Float, "from 0 to 1"),
    may("note", Text, "in words"),
    must("at_ms", Long, "when it was said, milliseconds since 1970"),
];

const VERDICTS: &[Column] = &[
    must("file_digest", Text, "BLAKE3 of the trace file's bytes"),
    must("trace_digest", Text, "the trace's chain digest; empty where the file could not be read"),
    must("sim_version", Int, "version of the simulator that replayed it"),
    must("build", Text, "version of Reel that replayed it"),
    must("verdict", Text, "`exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`"),
    must("reason", Text, "what was found, in words"),
];

impl Table {
    /// Every table, in the order of the documents.
    pub const ALL: [Table; 9] = [
        Table::Episodes,
        Table::Tasks,
        Table::Scenes,
        Table::Rescored,
        Table::Quarantine,
        Table::Classes,
        Table::Blame,
        Table::Labels,
        Table::Verdicts,
    ];

    /// Its name in SQL and as a folder.
    pub fn name(self) -> &'static str {
        match self {
            Table::Episodes => "episodes",
            Table::Tasks => "tasks",
            Table::Scenes => "scenes",
            Table::Rescored => "rescored",
            Table::Quarantine => "quarantine",
            Table::Classes => "classes",
            Table::Blame => "blame",
            Table::Labels => "labels",
            Table::Verdicts => "verdicts",
        }
    }

    /// What a row is.
    pub fn meaning(self) -> &'static str {
        match self {
            Table::Episodes => "One row an episode, all that belongs to it nested.",
            Table::Tasks => "One row a task, however many episodes play it.",
            Table::Scenes => "One row a scene.",
            Table::Rescored => "One row an episode and version of a preset, written by `reel reward`.",
            Table::Quarantine => "One row a file that `reel ingest` left out.",
            Table::Classes => "One row a failed episode: why it failed, by the rules; written by `reel taxonomy`.",
            Table::Blame => {
                "One row a failed episode: the step that decided, measured, and what is better; written by `reel blame`."
            }
            Table::Labels => {
                "One row an episode and author: why it failed, by people, judges and injected faults; written by `reel label`."
            }
            Table::Verdicts => {
                "One row a trace file that was replayed for an export, and what was found; the same in every version of the store."
            }
        }
    }

    /// Its columns.
    pub fn columns(self) -> &'static [Column] {
        match self {
            Table::Episodes => EPISODES,
            Table::Tasks => TASKS,
            Table::Scenes => SCENES,
            Table::Rescored => RESCORED,
            Table::Quarantine => QUARANTINE,
            Table::Classes => CLASSES,
            Table::Blame => BLAME,
            Table::Labels => LABELS,
            Table::Verdicts => VERDICTS,
        }
    }

    /// Its Arrow schema.
    pub fn schema(self) -> SchemaRef {
        Arc::new(Schema::new(fields(self.columns())))
    }
}

/// A flat form of what is nested in a table.
#[derive(Clone, Debug)]
pub struct View {
    /// Its name in SQL.
    pub name: &'static str,
    /// What a row is.
    pub meaning: &'static str,
    /// The query.
    pub sql: String,
}

/// The flat views, in the order of the documents. Of the fields of a step the view `steps` has those that are `available`:
/// all of them, but for a reader that leaves some of them out.
pub fn views(available: impl Fn(&str) -> bool) -> Vec<View> {
    let step: Vec<Column> = STEP.iter().filter(|column| available(column.name)).copied().collect();
    let view = |name, meaning, sql| View { name, meaning, sql };
    // what one of the step's lists holds, a row each
    let of_steps = |list: &str, columns: &[Column]| {
        format!(
            "SELECT episode_id, step, {} FROM (SELECT episode_id, s['step'] AS step, unnest(s['{list}']) AS item \
             FROM (SELECT episode_id, unnest(steps) AS s FROM episodes))",
            flat("item", columns)
        )
    };
    vec![
        view(
            "steps",
            "One row a decision: `episode_id, policy, family, task_id, success` and the columns of a step.",
            format!(
                "SELECT episode_id, policy, family, task_id, success, {} \
                 FROM (SELECT episode_id, policy, family, task_id, success, unnest(steps) AS s FROM episodes)",
                flat("s", &step)
            ),
        ),
        view(
            "world_diffs",
            "`episode_id`, `step` and the columns of a change; moving an object gives two rows.",
            of_steps("changes", CHANGE),
        ),
        view(
            "rewards",
            "`episode_id, preset, version, step, component, value, reason`: reward terms that are not zero, as recorded \
             (`version` null) and as recomputed.",
            "SELECT episode_id, preset, CAST(NULL AS VARCHAR) AS version, step, t['component'] AS component, \
             t['value'] AS value, t['reason'] AS reason \
             FROM (SELECT episode_id, preset, s['step'] AS step, unnest(s['terms']) AS t \
             FROM (SELECT episode_id, preset, unnest(steps) AS s FROM episodes)) \
             UNION ALL SELECT episode_id, preset, version, t['step'], t['component'], t['value'], '' \
             FROM (SELECT r.episode_id, r.preset, r.version, unnest(r.terms) AS t FROM rescored r \
             JOIN episodes e ON e.episode_id = r.episode_id AND e.trace_digest = r.trace_digest)"
                .into(),
        ),
        view(
            "objects",
            "`task_id`, `task_digest` and the columns of an object.",
            format!(
                "SELECT task_id, task_digest, {} FROM (SELECT task_id, task_digest, unnest(objects) AS o FROM tasks)",
                flat("o", OBJECT)
            ),
        ),
        view("markers", "`episode_id`, `step` and the columns of a marker.", of_steps("marker_map", MARKER)),
        view(
            "visible_objects",
            "`episode_id`, `step` and the columns of a visible object; step -1 is before the first decision.",
            format!(
                "{} UNION ALL SELECT episode_id, CAST(-1 AS INT), {} \
                 FROM (SELECT episode_id, unnest(start_objects) AS item FROM episodes)",
                of_steps("visible_objects", VISIBLE),
                flat("item", VISIBLE)
            ),
        ),
        view(
            "measurements",
            "`episode_id`, `policy`, `backend` and the columns of what a robot measured.",
            format!(
                "SELECT episode_id, policy, backend, {} FROM (SELECT episode_id, policy, backend, unnest(measured) AS m FROM episodes)",
                flat("m", MEASURED)
            ),
        ),
        view(
            "logprobs",
            "`episode_id, step, policy, tokens, logprobs`: one row a decision and policy whose log-probabilities are known.",
            "SELECT episode_id, step, l['policy'] AS policy, tokens, l['logprobs'] AS logprobs \
             FROM (SELECT episode_id, s['step'] AS step, s['tokens'] AS tokens, unnest(s['logprobs']) AS l \
             FROM (SELECT episode_id, unnest(steps) AS s FROM episodes))"
                .into(),
        ),
        view(
            "dialogue",
            "`episode_id, step, question, reply, source`: one row a question.",
            "SELECT episode_id, s['step'] AS step, s['question'] AS question, s['reply'] AS reply, \
             s['reply_source'] AS source FROM (SELECT episode_id, unnest(steps) AS s FROM episodes) \
             WHERE s['question'] IS NOT NULL"
                .into(),
        ),
    ]
}

/// The fields of a struct as columns of their own.
fn flat(of: &str, columns: &[Column]) -> String {
    let column = |column: &Column| format!("{of}['{0}'] AS {0}", column.name);
    columns.iter().map(column).collect::<Vec<_>>().join(", ")
}

/// Delta Lake's name for what a list holds.
const LIST_ITEM: &str = "element";

fn fields(columns: &[Column]) -> Fields {
    columns.iter().map(|column| Field::new(column.name, data_type(column.kind), column.nullable)).collect()
}

fn data_type(kind: Kind) -> DataType {
    match kind {
        Text => DataType::Utf8,
        Flag => DataType::Boolean,
        Int => DataType::Int32,
        Long => DataType::Int64,
        Unsigned => DataType::Decimal128(20, 0),
        Float => DataType::Float64,
        List(item) => DataType::List(Arc::new(Field::new(LIST_ITEM, data_type(*item), false))),
        Struct(columns) => DataType::Struct(fields(columns)),
    }
}

/// The tables as a Markdown page: `schemas/tables.md`.
pub fn document() -> String {
    let mut page = String::from(
        "# Tables\n\nWritten by `reel ingest`, asked by `reel query`. Delta Lake (Parquet with zstd), one folder a table.\nWhat \
         belongs to an episode is nested in its row; the views below are its flat forms.\n",
    );
    for table in Table::ALL {
        let _ = write!(page, "\n## `{}`\n{}\n\n", table.name(), table.meaning());
        document_columns(table.columns(), &mut page);
    }
    for (title, columns) in NESTED {
        let _ = write!(page, "\n## {title}\n\n");
        document_columns(columns, &mut page);
    }
    page.push_str("\n## Views\n\n| view | rows |\n|---|---|\n");
    for view in views(|_| true) {
        let _ = writeln!(page, "| `{}` | {} |", view.name, view.meaning);
    }
    page
}

/// Nested structs with a section of their own.
const NESTED: [(&str, &[Column]); 11] = [
    ("A step (`episodes.steps`, view `steps`)", STEP),
    ("What a robot measured (`episodes.measured`, view `measurements`)", MEASURED),
    ("Log-probabilities (`steps.logprobs`, view `logprobs`)", LOGPROBS),
    ("A change (`steps.changes`, `episodes.start_changes`, view `world_diffs`)", CHANGE),
    ("A reward term (`steps.terms`, view `rewards`)", TERM),
    ("A marker (`steps.marker_map`, view `markers`)", MARKER),
    ("A visible object (`steps.visible_objects`, `episodes.start_objects`, view `visible_objects`)", VISIBLE),
    ("An object (`tasks.objects`, view `objects`)", OBJECT),
    ("A receptacle (`scenes.receptacles`)", RECEPTACLE),
    ("A recomputed term (`rescored.terms`, view `rewards`)", STEP_TERM),
    ("A finding (`classes.secondary`)", FINDING),
];

fn has_section(columns: &[Column]) -> bool {
    NESTED.iter().any(|(_, nested)| nested.iter().map(|column| column.name).eq(columns.iter().map(|column| column.name)))
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
        Unsigned => "decimal(20, 0)".into(),
        Float => "float64".into(),
        List(Struct(columns)) if has_section(columns) => "list, see below".into(),
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
