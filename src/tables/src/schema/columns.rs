//! Every column of every table and of every nested struct.

use super::{
    Column,
    ColumnType::{Flag, Float, Int, List, Long, Struct, Text, Unsigned},
    may, must,
};

/// A list of columns: `must` (never null) or `may`, name, type, meaning.
macro_rules! columns {
    ($($need:ident $name:ident: $kind:expr, $meaning:literal;)*) => {
        &[$($need(stringify!($name), $kind, $meaning)),*]
    };
}

/// A change of a world graph.
pub(super) const CHANGE: &[Column] = columns! {
    must authority: Text, "whose graph changed: `physics` or `registry`";
    must event: Text, "`add`, `remove` or `door`";
    may object: Text, "instance that came or left";
    may asset: Text, "its asset";
    must receptacle: Text, "where; `floor` is a place";
    may door_from: Text, "door before: `open` or `closed`";
    may door_to: Text, "door after";
};

/// A term of a reward.
pub(super) const TERM: &[Column] = columns! {
    must component: Text, "`task`, `prog`, `phys`, `ask`, `time`, `safe` in preset `paper`";
    must value: Float, "the term";
    must reason: Text, "which event or rule gave it";
};

/// What a policy gives the tokens of a decision.
pub(super) const LOGPROBS: &[Column] = columns! {
    must policy: Text,
        "`old` sampled the tokens; others, e.g. `new` and `ref`, were added by `reel trace logprobs`";
    must logprobs: List(&Float), "natural logarithms, at most 0, one a token";
};

/// A number of the marker map.
pub(super) const MARKER: &[Column] = columns! {
    must marker: Int, "the number";
    must kind: Text, "`object` or `receptacle`";
    must id: Text, "instance or receptacle";
};

/// An object in a picture.
pub(super) const VISIBLE: &[Column] = columns! {
    must object: Text, "instance";
    must pixels: Int, "how many pixels of it are seen";
    must x_min: Int, "bounding box, pixels from the left, inclusive";
    must y_min: Int, "pixels from the top";
    must x_max: Int, "inclusive";
    must y_max: Int, "inclusive";
};

/// Columns of a step, nested in [`Table::Episodes`] and flat in the view `steps`.
pub const STEP: &[Column] = columns! {
    must step: Int, "decision, from 0";
    must tool: Text, "the paper's name of the tool; the name as called where it is no tool";
    must call_name: Text, "the name as called";
    must arguments: Text, "the arguments as called, JSON";
    may argument: Text,
        "the tool's one argument as plain text: receptacle, category, marker or question";
    must text: Text, "what the policy was told";
    may error_code: Text, "why the call failed; null: it did what it should";
    may error_class: Text, "`severe` or `moderate`";
    may object: Text, "instance that the call acted on";
    may receptacle: Text, "receptacle that the call acted on";
    may goal_object: Flag, "whether that object is one the goal moves";
    may goal_receptacle: Flag, "whether that receptacle is where the goal wants that object";
    may object_like: Text,
        "that object beside the target: `target`, `instance` (another of its asset), `category` \
         (another asset of its category), `distractor` (named as one, of another category), \
         `other`";
    may receptacle_like: Text,
        "that receptacle beside the destination: `dest`, `src`, `similar` (of its category, or \
         named as its distractor), `other`";
    may put_back: Flag,
        "of a successful `place`: whether the object is again where it stood at the start";
    may fell: Text, "what came to lie on the floor by this call: `target`, else `other`";
    may held: Text, "instance in the gripper after the call";
    must markers: Int, "numbers in the marker map after the call";
    must visible: Int, "objects in the picture";
    must candidates: Int,
        "different objects of the target's category, or among the task's object distractors, \
         seen or listed so far";
    must reward: Float, "sum of the reward terms under the episode's preset";
    must sim_step: Long, "simulation time after the call, in physics steps of 1/240 s";
    must robot_x_m: Float, "base of the robot, metres";
    must robot_y_m: Float, "base of the robot, metres";
    must robot_yaw_rad: Float, "heading, radians, 0 looks along +x";
    must path_length_m: Float, "path driven so far, metres";
    may latency_ns: Long, "how long the policy took, nanoseconds of wall-clock time";
    may took_ns: Long,
        "how long the robot or the server took over the call, nanoseconds; null in Reel's own \
         simulator";
    may reasoning: Text, "the policy's reasoning";
    may history: Text, "the policy's own summary";
    may plan: Text, "the policy's schedule and subtask";
    may question: Text, "what an `ask` asked";
    may reply: Text, "what the user answered";
    may reply_source: Text, "who answered: `rule-based`, `model`, `human`";
    may raw: Text, "the policy's output as it came";
    may tokens_read: Int, "tokens that the model read";
    may tokens_written: Int, "tokens that it wrote";
    may tokens: List(&Text),
        "the tokens that it wrote, as the endpoint names them; null: their log-probabilities \
         were not recorded";
    must logprobs: List(&Struct(LOGPROBS)), "what policies give these tokens; the view `logprobs`";
    must listed: List(&Text), "instances of whose existence the policy was told in words";
    must new_objects: List(&Text), "instances seen or listed for the first time";
    must changes: List(&Struct(CHANGE)), "changes of the world graphs; the view `world_diffs`";
    must terms: List(&Struct(TERM)),
        "reward terms under the episode's preset that are not zero; the view `rewards`";
    must marker_map: List(&Struct(MARKER)),
        "what the numbers stood for after the call; the view `markers`";
    must visible_objects: List(&Struct(VISIBLE)), "what the camera saw; the view `visible_objects`";
    must state_digest: Text, "digest of the simulator state after the call";
    must chain_digest: Text, "hash chain up to this step";
    must trace_offset: Long, "byte of the trace file at which the step's first message stands";
};

/// What a robot measured beside its steps.
pub(super) const MEASURED: &[Column] = columns! {
    must kind: Text,
        "`primitive`: an execution of a low-level skill; `vla`: an inference of the model \
         beneath; `alignment`: how far off a repeated command to navigate or gaze was";
    may step: Int, "the decision during which it was measured; null: before the first";
    may skill: Text, "of a primitive: `pick`, `place`, `open`, `close` or another name";
    may target: Text, "of a primitive or an alignment: on or at what, in words";
    may success: Flag, "of a primitive: whether it did what it should";
    may took_ns: Long, "of a primitive or an inference: how long it took, nanoseconds";
    may control_steps: Int, "of a primitive: steps of the low-level controller";
    may error: Text, "of a primitive: what went wrong, in the robot's words";
    may odometry_error_m: Float,
        "of an alignment, like what follows: distance to the wanted position, metres";
    may yaw_error_rad: Float, "difference in heading, radians";
    may image_shift_px: Float, "shift of the picture, pixels";
    may image_rmse_px: Float, "root mean square error of the picture's registration, pixels";
};

pub(super) const EPISODES: &[Column] = columns! {
    must episode_id: Text, "digest of the episode's inputs, shortened";
    must run_id: Text, "the command that recorded it";
    may group_id: Text, "prompt group of a rollout";
    may rollout_index: Int, "index in that group";
    must task_id: Text, "the task";
    must task_digest: Text, "joins `tasks` and `objects`";
    must scene_digest: Text, "joins `scenes`";
    must family: Text, "`FDP`, `FODP`, `FDO`, `SUL`";
    may task_type: Text, "e.g. `store`";
    must scene_id: Text, "the scene";
    must policy: Text, "who decided";
    may checkpoint: Text, "digest of a model's checkpoint";
    must seed: Unsigned, "seed of everything random";
    must profile: Text, "`paper` or `real-repo`";
    must preset: Text, "reward preset of the terms and metrics";
    must sim_version: Int, "version of the simulator";
    must build: Text, "version of Reel that recorded it";
    must backend: Text, "`sim`, `robot`, `proxy`";
    must skills: Text, "how reliable the robot's skills were made: `perfect`, `real-v1`";
    may end_reason: Text, "`finished`, `horizon`, `fault`, `aborted`; null: the trace breaks off";
    may success: Flag,
        "SR: no goal change is left; null where the trace breaks off, like the next six";
    may completion: Float, "CR: share of the goal changes that hold";
    may total_reward: Float, "cumulative reward, undiscounted";
    may discounted_return: Float, "discounted by 0.99 a step";
    may length: Int, "decisions";
    may asks: Int, "`ask` calls";
    may spl: Float, "success weighted by path length; null where no shortest path is known";
    must instruction: Text, "what the agent was told";
    must fuzzy: Flag, "whether it was told less than the precise instruction";
    may purpose: Text, "what the target is for, in fuzzy tasks";
    must target: Text, "instance to move";
    must target_category: Text, "its category";
    may target_caption: Text, "how people would describe it";
    must src: Text, "receptacle it stands on";
    must dest: Text, "receptacle it shall go to";
    may src_door: Text, "door of the source at the start: `open`, `closed`; null: it has none";
    may dest_door: Text, "door of the destination at the start";
    may shortest_path_m: Float, "shortest base path start, source, destination, metres";
    must path_length_m: Float, "path the base drove, metres";
    may parent_trace: Text, "digest of the trace this one branches from";
    may parent_call: Int, "first call that differs from the parent's";
    must start_changes: List(&Struct(CHANGE)),
        "how the graphs after settling differ from the task's";
    must start_objects: List(&Struct(VISIBLE)), "what the camera saw before the first decision";
    must trace: Text, "the trace file: what `replay`, `reward` and `frame` take";
    must trace_digest: Text, "the trace's chain digest";
    must trace_bytes: Long, "size of the trace file";
    must trace_modified_ns: Long,
        "when it was last written, nanoseconds since 1970; ingest skips files that are as they \
         were";
    must measured: List(&Struct(MEASURED)), "what a robot measured; the view `measurements`";
    must steps: List(&Struct(STEP)), "the decisions in order";
};

/// A word that describes an object of a task.
const ATTRIBUTE: &[Column] = columns! {
    must kind: Text, "e.g. `colour`";
    must word: Text, "e.g. `red`";
};

/// An object of a task.
pub(super) const OBJECT: &[Column] = columns! {
    must instance: Text, "the object's key";
    must asset: Text, "its asset";
    must category: Text, "e.g. `alarm clock`";
    may caption: Text, "how people would describe it";
    must attributes: List(&Struct(ATTRIBUTE)), "attribute words";
    must width_m: Float, "along x at rest, metres";
    must depth_m: Float, "along y at rest, metres";
    must height_m: Float, "along z at rest, metres";
    must receptacle: Text, "where it is placed";
    must role: Text,
        "`target`, `distractor` (one of the task's object distractors, or of the target's \
         category) or `other`";
};

pub(super) const TASKS: &[Column] = columns! {
    must task_id: Text, "the task";
    must task_digest: Text, "digest of the task's canonical JSON; the key";
    must family: Text, "`FDP`, `FODP`, `FDO`, `SUL`";
    may task_type: Text, "e.g. `store`";
    must scene_id: Text, "the scene";
    must instruction: Text, "what the agent is told";
    must precise_instruction: Text, "the precise instruction";
    must fuzzy: Flag, "whether the agent is told less than that";
    may purpose: Text, "what the target is for";
    must target: Text, "instance to move";
    must target_category: Text, "its category";
    must src: Text, "where it stands";
    must dest: Text, "where it shall go";
    may src_door: Text, "door of the source at the start: `open`, `closed`; null: it has none";
    may dest_door: Text, "door of the destination at the start";
    must src_distractors: List(&Text), "receptacles like the source";
    must dest_distractors: List(&Text), "receptacles like the destination";
    must object_distractors: List(&Text), "assets like the target";
    must goal_changes: List(&Text), "what must change, as in the paper: `+object@receptacle`";
    must object_count: Int, "how many objects there are";
    must objects: List(&Struct(OBJECT)), "the objects; the view `objects`";
    must task: Text, "the whole task as JSON";
};

/// A receptacle of a scene.
pub(super) const RECEPTACLE: &[Column] = columns! {
    must receptacle: Text, "e.g. `table_1`";
    must category: Text, "e.g. `table`";
    must room: Text, "its room";
    must has_door: Flag, "whether it can be opened";
    must placeable: Flag, "whether it may be placed upon";
    must captions: List(&Text), "how people call it";
};

pub(super) const SCENES: &[Column] = columns! {
    must scene_digest: Text, "digest of the scene's canonical JSON; the key";
    must scene_id: Text, "its name";
    must rooms: List(&Text), "its rooms";
    must receptacles: List(&Struct(RECEPTACLE)), "its furniture";
    must scene: Text, "the whole scene as JSON";
};

/// A term of a recomputed reward.
pub(super) const STEP_TERM: &[Column] = columns! {
    must step: Int, "the decision";
    must component: Text, "as the preset names it";
    must value: Float, "the term";
};

pub(super) const RESCORED: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "of the trace that was scored";
    must preset: Text, "name of the preset";
    must version: Text, "digest of the preset's content";
    must total_reward: Float, "cumulative reward, undiscounted";
    must discounted_return: Float, "discounted by the preset's gamma";
    must terms: List(&Struct(STEP_TERM)), "the terms that are not zero, in order";
};

pub(super) const QUARANTINE: &[Column] = columns! {
    must trace: Text, "the file";
    must reason: Text, "why it was left out; gone as soon as the file is read whole";
};

/// One more finding of the rules.
pub(super) const FINDING: &[Column] = columns! {
    must rule: Text, "name of the rule";
    must class: Text, "its class";
    must sub_class: Text, "its sub-class";
    must step: Int, "the first step of its evidence";
    must last_step: Int, "the last one";
};

pub(super) const CLASSES: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "of the trace that was judged";
    must rules_version: Text, "digest of the rule set";
    must class: Text,
        "`Object Confusion`, `Key Action Missing`, `Lost Memory`, `Other` (paper, Failure Mode \
         Taxonomy)";
    must sub_class: Text, "what within that class, e.g. `missing_ask`";
    must rule: Text, "the rule that decided";
    must step: Int,
        "the decisive step: as `reel blame` measured it, else the first that the rule's evidence \
         names";
    must last_step: Int, "the last step of the evidence";
    must fields: List(&Text), "columns of `episodes` and `steps` that the rule looked at";
    must evidence: Text,
        "`full`; `reduced` where the trace has no physics behind it and the rules saw less";
    must secondary: List(&Struct(FINDING)), "what else was found, in the order of their priority";
};

pub(super) const BLAME: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "of the trace that was measured";
    may step: Int, "the decisive step; null, as what follows, where nothing was lost";
    may tool: Text, "its tool";
    may harm: Text,
        "`world`: it changed the world for the worse; `ending`: it ended too early; `time`: the \
         way was lost there";
    may cause: Text, "`perception`, `communication`, `memory` or `other`: which capacity failed";
    may why: Text, "in a sentence";
    may advice: Text, "what a competent agent would have called then";
    must wasted: Int, "decisions lost in all";
    may point_of_no_return: Int, "the step with which success went out of reach";
    must repairable_at_end: Flag, "whether success was still to be had before the last step";
    must perception: Float,
        "share of what was lost for good that is due to it; the four add up to 1";
    must communication: Float, "the same";
    must memory: Float, "the same";
    must other: Float, "the same";
    may alternative: Text,
        "the policy that succeeds from the decisive step on: `planner` knows what the agent \
         knew, `oracle` the truth";
    may alternative_length: Int, "decisions of the whole episode then";
    may alternative_trace: Text, "the branch, where it was kept";
    must verified: Flag, "whether that branch was replayed and is exact";
    may reason: Text, "why there is no alternative";
};

pub(super) const LABELS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must author: Text, "who says so: a person, a model, or `injected`";
    must kind: Text,
        "`human`, `judge`, `injected`, or `adjudicated`: decided where others disagreed";
    must class: Text, "one of the four classes";
    may sub_class: Text, "what within that class";
    may step: Int, "the decisive step";
    may confidence: Float, "from 0 to 1";
    may note: Text, "in words";
    must at_ms: Long, "when it was said, milliseconds since 1970";
};

pub(super) const VERDICTS: &[Column] = columns! {
    must file_digest: Text, "BLAKE3 of the trace file's bytes";
    must trace_digest: Text, "the trace's chain digest; empty where the file could not be read";
    must sim_version: Int, "version of the simulator that replayed it";
    must build: Text, "version of Reel that replayed it";
    must verdict: Text, "`exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`";
    must reason: Text, "what was found, in words";
};

/// A claim that the record refutes.
pub(super) const CLAIM: &[Column] = columns! {
    must step: Int, "the decision whose History makes the claim";
    must kind: Text, "what it is about, e.g. `pick`, `door state`";
    must claim: Text, "its words";
    must reason: Text, "what the record says instead";
};

pub(super) const CONTRADICTIONS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "of the trace whose Histories were checked";
    must checker_version: Int, "version of the checker";
    must claims: List(&Struct(CLAIM)), "the refuted claims; the view `refuted_claims`";
};
