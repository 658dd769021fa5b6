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
    must authority: Text, "graph that changed: `physics` or `registry`";
    must event: Text, "`add`, `remove` or `door`";
    may object: Text, "instance that was added or removed";
    may asset: Text, "its asset";
    must receptacle: Text, "receptacle of the change, or `floor`";
    may door_from: Text, "door before: `open` or `closed`";
    may door_to: Text, "door after";
};

/// A term of a reward.
pub(super) const TERM: &[Column] = columns! {
    must component: Text, "`task`, `prog`, `phys`, `ask`, `time`, `safe` in preset `paper`";
    must value: Float, "the term";
    must reason: Text, "event or rule behind the term";
};

/// What a policy gives the tokens of a decision.
pub(super) const LOGPROBS: &[Column] = columns! {
    must policy: Text,
        "`old` sampled the tokens; others, e.g. `new` and `ref`, were added by `reel trace logprobs`";
    must logprobs: List(&Float), "natural logarithms, at most 0, one a token";
};

/// A number of the marker map.
pub(super) const MARKER: &[Column] = columns! {
    must marker: Int, "marker number";
    must kind: Text, "`object` or `receptacle`";
    must id: Text, "instance or receptacle";
};

/// An object in a frame.
pub(super) const VISIBLE: &[Column] = columns! {
    must object: Text, "instance";
    must pixels: Int, "visible pixels";
    must x_min: Int, "bounding box, pixels from the left, inclusive";
    must y_min: Int, "pixels from the top";
    must x_max: Int, "inclusive";
    must y_max: Int, "inclusive";
};

/// Columns of a step, nested in `episodes` and flat in the view `steps`.
pub const STEP: &[Column] = columns! {
    must step: Int, "decision, from 0";
    must tool: Text, "the paper's name of the tool; the name as called where it is no tool";
    must call_name: Text, "the name as called";
    must arguments: Text, "the arguments as called, JSON";
    may argument: Text,
        "the tool's one argument as plain text: receptacle, category, marker or question";
    must text: Text, "text of the tool result";
    may error_code: Text, "why the call failed; null if it succeeded";
    may error_class: Text, "`severe` or `moderate`";
    may object: Text, "instance that the call acted on";
    may receptacle: Text, "receptacle that the call acted on";
    may goal_object: Flag, "whether that object is one the goal moves";
    may goal_receptacle: Flag, "whether that receptacle is where the goal wants that object";
    may object_match: Text,
        "that object compared with the target: `target`, `instance` (another of its asset), `category` \
         (another asset of its category), `distractor` (named as one, of another category), \
         `other`";
    may receptacle_match: Text,
        "that receptacle compared with the destination: `dest`, `src`, `similar` (of its category, or \
         named as its distractor), `other`";
    may put_back: Flag,
        "of a successful `place`: whether the object is back where it stood at the start";
    may primitive: Text,
        "skill of the arm that a call runs, also one that failed, as the paper's table has them: `open`, `close`, \
         `pick`, `place_open`, `place_inside` (of what has a door); null for other calls, and for a `place` \
         at nobody knows what";
    may fell: Text, "what the call dropped on the floor: `target`, else `other`";
    must repeated: Flag,
        "whether the same call was made before in the same state of the world, from the same \
         receptacle and with the same error, if any: it could bring nothing new";
    must goals_met: Int,
        "number of objects that the goal moves and that stand where it wants them after the call";
    must goals_missing: Int, "number of objects that the goal moves and that stand elsewhere then";
    may held: Text, "instance in the gripper after the call";
    must marker_count: Int, "number of markers in the marker map after the call";
    must visible_count: Int, "number of objects in the frame";
    must candidate_count: Int,
        "number of different objects of the target's category, or among the task's object distractors, \
         seen or listed so far";
    must reward: Float, "sum of the reward terms under the episode's preset";
    must sim_step: Long, "simulation time after the call, in physics steps of 1/240 s";
    must robot_x_m: Float, "base of the robot, metres";
    must robot_y_m: Float, "base of the robot, metres";
    must robot_yaw_rad: Float, "heading, radians, 0 looks along +x";
    must path_length_m: Float, "path driven so far, metres";
    may latency_ns: Long, "wall-clock time of the policy's decision, nanoseconds";
    may duration_ns: Long,
        "execution time of the call on the robot or server, nanoseconds; null in Reel's own \
         simulator";
    may reasoning: Text, "the policy's reasoning";
    may history: Text, "the policy's own summary";
    may plan: Text, "the policy's schedule and subtask";
    may question: Text, "question of an `ask` call";
    may reply: Text, "the user's answer";
    may settles: Flag,
        "of an answered question: whether the answer tells the target from all other candidates seen \
         so far, as the words of both are understood";
    may reply_source: Text, "who answered: `rule-based`, `model`, `human`";
    may refused_replies: Int,
        "of an `ask` with an answer: replies of a model that gave something away, which the policy did not get";
    may match_source: Text,
        "of a `show_object_by_category` in Reel's simulator: what decided which categories the query means: \
         `words` (Reel's word list, or equal names), else the name of the embedding model or of the file of \
         vectors";
    may match_categories: List(&Text),
        "categories that the query means by vectors, the most similar first; null if words decided";
    may query_known: Flag,
        "of a `show_object_by_category`: whether Reel's word list knows the query or its head noun, or \
         an object of the task has that category";
    may raw: Text, "the policy's unparsed output";
    may prompt_tokens: Int, "tokens of the model's prompt";
    may completion_tokens: Int, "tokens of the model's completion";
    may tokens: List(&Text),
        "tokens of the completion as the endpoint names them; null if no log-probabilities \
         were recorded";
    must logprobs: List(&Struct(LOGPROBS)),
        "log-probabilities of these tokens by policy; the view `logprobs`";
    must listed_objects: List(&Text), "instances that the text of the tool result lists";
    must new_objects: List(&Text), "instances seen or listed for the first time";
    must changes: List(&Struct(CHANGE)), "changes of the world graphs; the view `world_diffs`";
    must terms: List(&Struct(TERM)),
        "reward terms under the episode's preset that are not zero; the view `rewards`";
    must marker_map: List(&Struct(MARKER)),
        "targets of the markers after the call; the view `markers`";
    must visible_objects: List(&Struct(VISIBLE)),
        "objects in the frame; the view `visible_objects`";
    must state_digest: Text, "digest of the simulator state after the call";
    must chain_digest: Text, "hash chain up to this step";
    must trace_offset: Long, "byte offset of the step's first message in the trace file";
};

/// Measurements of a robot, apart from its steps.
pub(super) const MEASURED: &[Column] = columns! {
    must kind: Text,
        "`primitive`: an execution of a low-level skill; `vla`: an inference of the model \
         beneath; `alignment`: how far off a repeated command to navigate or gaze was";
    may step: Int, "the decision during which it was measured; null: before the first";
    may skill: Text, "of a primitive: `pick`, `place`, `open`, `close` or another name";
    may target: Text, "of a primitive or an alignment: on or at what, in words";
    may success: Flag, "of a primitive: whether it succeeded";
    may duration_ns: Long, "of a primitive or an inference: duration, nanoseconds";
    may control_steps: Int, "of a primitive: steps of the low-level controller";
    may error: Text, "of a primitive: the robot's error message";
    may odometry_error_m: Float,
        "of an alignment, like what follows: distance to the wanted position, metres";
    may yaw_error_rad: Float, "difference in heading, radians";
    may image_shift_px: Float, "shift of the image, pixels";
    may image_rmse_px: Float, "root mean square error of the image registration, pixels";
};

/// A score that was told with an episode.
pub(super) const SCORE: &[Column] = columns! {
    must name: Text, "the scorer; with a dot before the name of a part of its score";
    may value: Float, "as a number";
    may label: Text, "as it was told where it is no number";
    may explanation: Text, "why, in the scorer's words";
};

pub(super) const EPISODES: &[Column] = columns! {
    must episode_id: Text, "digest of the episode's inputs, shortened";
    must run_id: Text, "the command that recorded it";
    may group_id: Text, "prompt group of a rollout";
    may rollout_index: Int, "index in that group";
    must task_id: Text, "the task";
    must task_digest: Text, "joins `tasks` and `objects`";
    must scene_digest: Text, "joins `scenes`";
    must family: Text, "`FDP`, `FODP`, `FDO`, `SUL`; `other`: outside REAL-Bench";
    may task_type: Text, "e.g. `store`";
    must scene_id: Text, "the scene";
    must policy: Text, "the policy";
    may checkpoint: Text, "digest of a model's checkpoint";
    must seed: Unsigned, "seed of everything random";
    must profile: Text, "`paper` or `real-repo`";
    must preset: Text, "reward preset of the terms and metrics";
    must sim_version: Int, "version of the simulator";
    must build: Text, "version of Reel that recorded it";
    must backend: Text,
        "`sim`, `robot`, `proxy`; `imported`: the log of another program";
    must skills: Text, "reliability of the simulated skills: `perfect`, `real-v1`";
    may end_reason: Text,
        "`finished`, `horizon`, `fault`, `aborted`; null if the trace is incomplete";
    may success: Flag,
        "SR: every goal change holds; where the task has no goal `reported_success`; null, like \
         the next six, if the trace is incomplete";
    may completion: Float,
        "CR: share of the goal changes that hold; null, like the rewards, where the task has no goal";
    may total_reward: Float, "cumulative reward, undiscounted";
    may discounted_return: Float, "discounted by 0.99 a step";
    may length: Int, "decisions";
    may asks: Int, "`ask` calls";
    may spl: Float, "success weighted by path length; null where no shortest path is known";
    must instruction: Text, "instruction to the agent";
    must fuzzy: Flag, "whether the instruction omits details of the precise one";
    may purpose: Text, "what the target is for, in fuzzy tasks";
    must target: Text,
        "instance to move; empty, like category, source and destination, where the task has no goal";
    must target_category: Text, "its category";
    may target_caption: Text, "how people would describe it";
    must src: Text, "source receptacle";
    must dest: Text, "destination receptacle";
    may src_door: Text, "door of the source at the start: `open`, `closed`; null: it has none";
    may dest_door: Text, "door of the destination at the start";
    may shortest_path_m: Float, "shortest base path start, source, destination, metres";
    must path_length_m: Float, "path length of the base, metres";
    may parent_trace: Text, "digest of the trace this one branches from";
    may parent_call: Int, "first call that differs from the parent's";
    must start_changes: List(&Struct(CHANGE)),
        "changes from the task's graphs to those after settling";
    must start_objects: List(&Struct(VISIBLE)), "objects in the frame before the first decision";
    must trace: Text, "the trace file: what `replay`, `reward` and `frame` take";
    must trace_digest: Text, "the trace's chain digest";
    must trace_bytes: Long, "size of the trace file";
    must trace_modified_ns: Long,
        "modification time of the file, nanoseconds since 1970; ingest skips unchanged files";
    must measurements: List(&Struct(MEASURED)), "measurements of a robot; the view `measurements`";
    must steps: List(&Struct(STEP)), "the decisions in order";
    may reported_success: Flag,
        "whether it succeeded, as somebody said where it ran; null: nobody did";
    may scores: List(&Struct(SCORE)), "what scorers said where it ran";
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
    must family: Text, "`FDP`, `FODP`, `FDO`, `SUL`; `other`: outside REAL-Bench";
    may task_type: Text, "e.g. `store`";
    must scene_id: Text, "the scene";
    must instruction: Text, "instruction to the agent";
    must precise_instruction: Text, "the precise instruction";
    must fuzzy: Flag, "whether the instruction omits details of the precise one";
    may purpose: Text, "what the target is for";
    must target: Text,
        "instance to move; empty, like category, source and destination, where the task has no goal";
    must target_category: Text, "its category";
    must src: Text, "source receptacle";
    must dest: Text, "destination receptacle";
    may src_door: Text, "door of the source at the start: `open`, `closed`; null: it has none";
    may dest_door: Text, "door of the destination at the start";
    must src_distractors: List(&Text), "receptacles like the source";
    must dest_distractors: List(&Text), "receptacles like the destination";
    must object_distractors: List(&Text), "assets like the target";
    must goal_changes: List(&Text),
        "changes that solve the task, as in the paper: `+object@receptacle`";
    must object_count: Int, "number of objects";
    must objects: List(&Struct(OBJECT)), "the objects; the view `objects`";
    must task: Text, "the whole task as JSON";
};

/// A receptacle of a scene.
pub(super) const RECEPTACLE: &[Column] = columns! {
    must receptacle: Text, "e.g. `table_1`";
    must category: Text, "e.g. `table`";
    must room: Text, "its room";
    must has_door: Flag, "whether it can be opened";
    must placeable: Flag, "whether objects can be placed on it";
    must captions: List(&Text), "names that people use for it";
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
    must trace_digest: Text, "digest of the scored trace";
    must preset: Text, "name of the preset";
    must version: Text, "digest of the preset's content";
    must total_reward: Float, "cumulative reward, undiscounted";
    must discounted_return: Float, "discounted by the preset's gamma";
    must terms: List(&Struct(STEP_TERM)), "the terms that are not zero, in order";
};

pub(super) const QUARANTINE: &[Column] = columns! {
    must trace: Text, "the file";
    must reason: Text, "why it failed to load; the row is removed once the file loads";
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
    must trace_digest: Text, "digest of the classified trace";
    must rules_version: Text, "digest of the rule set";
    must class: Text,
        "`Object Confusion`, `Key Action Missing`, `Lost Memory`, `Other` (paper, Failure Mode \
         Taxonomy)";
    must sub_class: Text, "sub-class within that class, e.g. `missing_ask`";
    must rule: Text, "the rule that decided";
    must step: Int,
        "the decisive step, at which the fault shows: the first of the rule's evidence; where time \
         was lost, as measured by `reel blame` within the evidence";
    must last_step: Int, "the last step of the evidence";
    must cause: Text, "capacity that failed, as in `blame`";
    may explanation: Text, "explanation in a sentence; null if `reel blame` did not measure";
    may advised_call: Text,
        "call that a competent agent makes at the decisive step; null if `reel blame` did not \
         measure that step";
    must confidence: Float,
        "how sure the explanation is, from 0 to 1 (docs/taxonomy.md has how it was measured)";
    may runner_up: Text, "sub-class of the next best explanation";
    must conflicts: List(&Text), "in which rules and `blame` disagree: worth a look";
    must fields: List(&Text), "columns of `episodes` and `steps` that the rule reads";
    must evidence: Text,
        "`full`; `reduced` if the trace has no physics and the rules read less";
    must secondary: List(&Struct(FINDING)), "further findings by priority";
};

pub(super) const BLAME: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "digest of the measured trace";
    may step: Int, "the decisive step; null, like the columns below, if nothing was lost";
    may tool: Text, "its tool";
    may harm: Text,
        "`world`: a harmful change of the world; `ending`: ended too early; `time`: steps were \
         wasted";
    may cause: Text,
        "`perception`, `communication`, `memory`, `primitive` or `other`: capacity that failed";
    may explanation: Text, "explanation in a sentence";
    may advised_call: Text, "call that a competent agent makes at this step";
    must wasted_steps: Int, "total number of wasted decisions";
    may point_of_no_return: Int,
        "last step before which success was certain, and after it not; null: there is none";
    must repairable_at_end: Flag, "whether success was still possible before the last step";
    must perception: Float,
        "share of the permanent loss due to it; the five add up to 1";
    must communication: Float, "the same";
    must memory: Float, "the same";
    must primitive: Float, "the same";
    must other: Float, "the same";
    may alternative: Text,
        "the policy that succeeds from the decisive step on: `planner` knows what the agent \
         knew, `oracle` the truth";
    may alternative_length: Int, "decisions of that whole episode";
    may alternative_trace: Text, "trace of the branch; null if it was not kept";
    must verified: Flag, "whether the branch replays exactly";
    may reason: Text, "why there is no alternative";
};

pub(super) const ATTRIBUTION: &[Column] = columns! {
    must episode_id: Text, "the failed episode";
    must trace_digest: Text, "digest of its trace";
    must capability: Text,
        "the capability made perfect: `perception`, `communication`, `memory`, `primitives`";
    must failures: Int, "recorded calls that failed by it";
    may first_step: Int, "the first of them";
    must played: Flag, "whether a branch was played; without a failure none has to be";
    must success: Flag, "whether the branch succeeded";
    must replaced: Int, "recorded calls that a competent agent's calls took the place of";
    must skipped: Int, "recorded calls without a counterpart in the branch, left out";
    may length: Int, "decisions of the branch";
    may branch: Text, "trace of the branch; null if it was not kept";
    must verified: Flag, "whether the kept branch replays exactly";
    may reason: Text, "why no branch could be played";
};

pub(super) const LABELS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must author: Text, "author of the label: a person, a model, or `injected`";
    must kind: Text,
        "`human`, `judge`, `injected`, or `adjudicated`: decides between labels that disagree";
    must class: Text, "one of the four classes";
    may sub_class: Text, "sub-class within that class";
    may step: Int, "the decisive step";
    may confidence: Float, "from 0 to 1";
    may note: Text, "explanation in free text";
    must at_ms: Long, "time of the label, milliseconds since 1970";
    may blind: Flag,
        "whether the author answered before seeing what the rules and `reel blame` say; null: unknown";
};

pub(super) const ANSWER_LABELS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must step: Int, "the `ask` whose answer it is about";
    must author: Text, "author of the label";
    must label: Text, "`faithful`, `unfaithful` or `unclear`";
    may note: Text, "explanation in free text";
    must at_ms: Long, "time of the label, milliseconds since 1970";
};

pub(super) const REMARKS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must author: Text, "who made the remark";
    must kind: Text, "`star`, `tag` or `comment`";
    must text: Text, "the tag or the comment; empty for a star";
    may step: Int, "the step that it is about; null: the whole episode";
    must at_ms: Long, "time of the remark, milliseconds since 1970";
};

pub(super) const COUNTERFACTUALS: &[Column] = columns! {
    must episode_id: Text, "the episode";
    must trace_digest: Text, "digest of its trace";
    must step: Int, "the step whose call was replaced";
    must call: Text, "the call in its place, as JSON: `name` and `arguments`";
    must tool: Text, "name of the call's tool";
    must origin: Text,
        "why it is plausible: `advice` (a competent agent's call), `question` (its question to the user), `marker` (another marker in view), `receptacle` (another receptacle of the same category)";
    must with_recorded_success: Flag, "success when the recorded calls go on after it";
    must with_recorded_completion: Float, "share of the goal reached then, from 0 to 1";
    may with_planner_success: Flag,
        "success when policy `planner` goes on after it; null where the recorded calls succeed";
    may with_planner_completion: Float, "share of the goal reached then, from 0 to 1";
    may with_planner_length: Int, "decisions of the whole episode then";
};

pub(super) const VERDICTS: &[Column] = columns! {
    must file_digest: Text, "BLAKE3 of the trace file's bytes";
    must trace_digest: Text, "the trace's chain digest; empty if the file cannot be read";
    must sim_version: Int, "version of the simulator that replayed it";
    must build: Text, "version of Reel that replayed it";
    must verdict: Text, "`exact`, `diverged`, `other_simulator`, `not_replayable` or `refused`; `exact_without_rgb` and `diverged_without_rgb` where no colours were compared";
    must reason: Text, "the finding in words";
    may at_ms: Long, "time of the replay, milliseconds since 1970; null: before version 0.3";
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
