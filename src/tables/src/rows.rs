//! A trace as rows: the values of every column of [`crate::schema`]. `serde_arrow` turns the
//! rows into columns, so that a field here without a column there (or the reverse) is an
//! error of every test.

mod nested;
mod tasks;

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
};

use arrow::array::RecordBatch;

use reel_trace::{Trace, robot::RobotLog};
use reel_world::{
    Digest, ErrorClass, ErrorCode, FLOOR, GraphEvent, InstanceId, Primitive, ReceptacleId, Scene,
    Task, TokenLogprobs, WorldGraph, canonical_json, language,
    record::{Backend, MarkerTarget, StepRecord},
};
use serde::Serialize;
use serde_arrow::ArrayBuilder;
use serde_json::Value;

use crate::{Table, revisit::Revisits};
pub(crate) use nested::{Change, MarkerRow, PolicyLogprobs, ScoreRow, Term, Visible};
use nested::{changes, marker, score_row, start_changes, term, visible};
pub(crate) use tasks::{door, name_of};
use tasks::{scene_row, task_row};

/// A row does not fit its columns.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct RowsError(#[from] serde_arrow::Error);

/// Rows of a table on their way into columns.
pub(crate) struct Rows {
    columns: ArrayBuilder,
}

impl Rows {
    pub(crate) fn new(table: Table) -> Result<Self, RowsError> {
        Ok(Self {
            columns: ArrayBuilder::from_arrow(table.schema().fields())?,
        })
    }

    /// Adds the row of an episode. `modified_ns` is when the trace file was last written. After an
    /// error the rows are of no use any more.
    pub(crate) fn push_episode(
        &mut self,
        trace: &Trace,
        modified_ns: i64,
    ) -> Result<(), RowsError> {
        Ok(self.columns.push(episode(trace, modified_ns))?)
    }

    /// Adds a row of an episode that was made up.
    pub(crate) fn push_row(&mut self, row: &Episode<'_>) -> Result<(), RowsError> {
        Ok(self.columns.push(row)?)
    }

    pub(crate) fn finish(self) -> Result<RecordBatch, RowsError> {
        Ok(self.columns.into_record_batch()?)
    }

    /// The row of a task.
    pub(crate) fn task(task: &Task) -> Result<RecordBatch, RowsError> {
        Self::of(Table::Tasks, &[task_row(task)])
    }

    /// The row of a scene.
    pub(crate) fn scene(scene: &Scene) -> Result<RecordBatch, RowsError> {
        Self::of(Table::Scenes, &[scene_row(scene)])
    }

    /// Files with the reason why they were left out.
    pub(crate) fn quarantine(files: &BTreeMap<String, String>) -> Result<RecordBatch, RowsError> {
        let rows: Vec<QuarantineRow> = files
            .iter()
            .map(|(trace, reason)| QuarantineRow { trace, reason })
            .collect();
        Self::of(Table::Quarantine, &rows)
    }

    pub(crate) fn of<R: Serialize>(table: Table, rows: &[R]) -> Result<RecordBatch, RowsError> {
        let mut builder = Self::new(table)?;
        builder.columns.extend(rows)?;
        builder.finish()
    }
}

#[derive(Serialize)]
struct QuarantineRow<'a> {
    trace: &'a str,
    reason: &'a str,
}

#[derive(Serialize)]
pub(crate) struct Episode<'a> {
    pub(crate) episode_id: Cow<'a, str>,
    pub(crate) run_id: &'a str,
    pub(crate) group_id: Option<Cow<'a, str>>,
    pub(crate) rollout_index: Option<u32>,
    pub(crate) task_id: &'a str,
    pub(crate) task_digest: String,
    pub(crate) scene_digest: String,
    pub(crate) family: &'static str,
    pub(crate) task_type: Option<&'a str>,
    pub(crate) scene_id: &'a str,
    pub(crate) policy: &'a str,
    pub(crate) checkpoint: Option<&'a str>,
    pub(crate) seed: String,
    pub(crate) profile: &'static str,
    pub(crate) preset: &'a str,
    pub(crate) sim_version: u32,
    pub(crate) build: &'a str,
    pub(crate) backend: Value,
    pub(crate) skills: &'static str,
    pub(crate) end_reason: Option<Value>,
    pub(crate) success: Option<bool>,
    pub(crate) completion: Option<f64>,
    pub(crate) total_reward: Option<f64>,
    pub(crate) discounted_return: Option<f64>,
    pub(crate) length: Option<u32>,
    pub(crate) asks: Option<u32>,
    pub(crate) spl: Option<f64>,
    pub(crate) instruction: &'a str,
    pub(crate) fuzzy: bool,
    pub(crate) purpose: Option<&'a str>,
    pub(crate) target: &'a str,
    pub(crate) target_category: &'a str,
    pub(crate) target_caption: Option<&'a str>,
    pub(crate) src: &'a str,
    pub(crate) dest: &'a str,
    pub(crate) src_door: Option<String>,
    pub(crate) dest_door: Option<String>,
    pub(crate) shortest_path_m: Option<f64>,
    pub(crate) path_length_m: f64,
    pub(crate) parent_trace: Option<String>,
    pub(crate) parent_call: Option<u32>,
    pub(crate) start_changes: Vec<Change>,
    pub(crate) start_objects: Vec<Visible<'a>>,
    pub(crate) trace: String,
    pub(crate) trace_digest: String,
    pub(crate) trace_bytes: u64,
    pub(crate) trace_modified_ns: i64,
    pub(crate) measurements: Vec<Measured<'a>>,
    pub(crate) steps: Vec<Step<'a>>,
    pub(crate) reported_success: Option<bool>,
    pub(crate) scores: Vec<ScoreRow<'a>>,
}

fn episode(trace: &Trace, modified_ns: i64) -> Episode<'_> {
    let Trace {
        header,
        task,
        start,
        end,
        ..
    } = trace;
    let target = task.object(&task.target);
    let metrics = end.as_ref().map(|end| &end.metrics);
    let goal_metrics = metrics.filter(|_| task.has_goal());
    let last_robot = trace.steps.last().map_or(&start.robot, |step| &step.robot);
    Episode {
        episode_id: header.episode_id.as_str().into(),
        run_id: &header.run_id,
        group_id: header.group_id.as_deref().map(Cow::from),
        rollout_index: header.rollout_index,
        task_id: &header.task_id,
        task_digest: header.task_digest.to_string(),
        scene_digest: header.scene_digest.to_string(),
        family: header.family.as_str(),
        task_type: task.task_type.as_deref(),
        scene_id: &header.scene_id,
        policy: &header.policy.name,
        checkpoint: header.policy.checkpoint.as_deref(),
        seed: header.seed.to_string(),
        profile: header.profile.as_str(),
        preset: &header.reward_preset,
        sim_version: header.sim_version,
        build: &header.build,
        backend: name_of(&header.backend),
        skills: header.skills.as_str(),
        end_reason: end.as_ref().map(|end| name_of(&end.reason)),
        success: end.as_ref().and_then(|end| end.success(task)),
        completion: goal_metrics.map(|metrics| metrics.completion),
        total_reward: goal_metrics.map(|metrics| metrics.total_reward),
        discounted_return: goal_metrics.map(|metrics| metrics.discounted_return),
        length: metrics.map(|metrics| metrics.length),
        asks: metrics.map(|metrics| metrics.asks),
        spl: goal_metrics.and_then(|metrics| metrics.spl),
        instruction: &task.instruction,
        fuzzy: task.fuzzy,
        purpose: task.purpose.as_deref(),
        target: task.target.as_str(),
        target_category: target.map_or("", |object| &object.category),
        target_caption: target.and_then(|object| object.caption.as_deref()),
        src: task.src.as_str(),
        dest: task.dest.as_str(),
        src_door: door(&task.initial, &task.src),
        dest_door: door(&task.initial, &task.dest),
        shortest_path_m: start.shortest_path_m.map(f64::from),
        path_length_m: last_robot.path_length_m.into(),
        parent_trace: header
            .parent
            .as_ref()
            .map(|parent| parent.trace.to_string()),
        parent_call: header.parent.as_ref().map(|parent| parent.call),
        start_changes: start_changes(task, &start.graphs),
        start_objects: start.visible.iter().map(visible).collect(),
        trace: trace.path.display().to_string(),
        trace_digest: trace.chain().to_string(),
        trace_bytes: trace.bytes,
        trace_modified_ns: modified_ns,
        measurements: measurements(&trace.robot),
        steps: steps(trace),
        reported_success: end.as_ref().and_then(|end| end.reported.success),
        scores: end
            .iter()
            .flat_map(|end| &end.reported.scores)
            .map(score_row)
            .collect(),
    }
}

#[derive(Serialize, Default)]
pub(crate) struct Measured<'a> {
    kind: &'static str,
    step: Option<u32>,
    skill: Option<&'a str>,
    target: Option<&'a str>,
    success: Option<bool>,
    duration_ns: Option<u64>,
    control_steps: Option<u32>,
    error: Option<&'a str>,
    odometry_error_m: Option<f64>,
    yaw_error_rad: Option<f64>,
    image_shift_px: Option<f64>,
    image_rmse_px: Option<f64>,
}

fn measurements(log: &RobotLog) -> Vec<Measured<'_>> {
    let primitives = log.primitives.iter().map(|it| Measured {
        kind: "primitive",
        step: it.step,
        skill: Some(&it.skill),
        target: said(&it.target),
        success: Some(it.success),
        duration_ns: it.duration_ns,
        control_steps: it.control_steps,
        error: it.error.as_deref(),
        ..Measured::default()
    });
    let vla = log.vla.iter();
    let vla = vla.map(|it| Measured {
        kind: "vla",
        step: it.step,
        duration_ns: Some(it.latency_ns),
        ..Measured::default()
    });
    let alignments = log.alignments.iter().map(|it| Measured {
        kind: "alignment",
        step: it.step,
        target: said(&it.target),
        odometry_error_m: it.odometry_error_m,
        yaw_error_rad: it.yaw_error_rad,
        image_shift_px: it.image_shift_px,
        image_rmse_px: it.image_rmse_px,
        ..Measured::default()
    });
    primitives.chain(vla).chain(alignments).collect()
}

#[derive(Serialize)]
pub(crate) struct Step<'a> {
    pub(crate) step: u32,
    pub(crate) tool: &'a str,
    pub(crate) call_name: &'a str,
    pub(crate) arguments: String,
    pub(crate) argument: Option<Cow<'a, str>>,
    pub(crate) text: Cow<'a, str>,
    pub(crate) error_code: Option<&'static str>,
    pub(crate) error_class: Option<&'static str>,
    pub(crate) object: Option<&'a str>,
    pub(crate) receptacle: Option<&'a str>,
    pub(crate) goal_object: Option<bool>,
    pub(crate) goal_receptacle: Option<bool>,
    pub(crate) object_match: Option<&'static str>,
    pub(crate) receptacle_match: Option<&'static str>,
    pub(crate) put_back: Option<bool>,
    pub(crate) primitive: Option<&'static str>,
    pub(crate) fell: Option<&'static str>,
    pub(crate) repeated: bool,
    pub(crate) goals_met: usize,
    pub(crate) goals_missing: usize,
    pub(crate) held: Option<&'a str>,
    pub(crate) marker_count: usize,
    pub(crate) visible_count: usize,
    pub(crate) candidate_count: usize,
    pub(crate) reward: f64,
    pub(crate) sim_step: u64,
    pub(crate) robot_x_m: f32,
    pub(crate) robot_y_m: f32,
    pub(crate) robot_yaw_rad: f32,
    pub(crate) path_length_m: f32,
    pub(crate) latency_ns: Option<u64>,
    pub(crate) duration_ns: Option<u64>,
    pub(crate) reasoning: Option<&'a str>,
    pub(crate) history: Option<&'a str>,
    pub(crate) plan: Option<&'a str>,
    pub(crate) question: Option<Cow<'a, str>>,
    pub(crate) reply: Option<&'a str>,
    pub(crate) settles: Option<bool>,
    pub(crate) reply_source: Option<Value>,
    pub(crate) refused_replies: Option<usize>,
    pub(crate) match_source: Option<&'a str>,
    pub(crate) match_categories: Option<&'a [String]>,
    pub(crate) query_known: Option<bool>,
    pub(crate) raw: Option<&'a str>,
    pub(crate) prompt_tokens: Option<u32>,
    pub(crate) completion_tokens: Option<u32>,
    pub(crate) tokens: Option<&'a [String]>,
    pub(crate) logprobs: Vec<PolicyLogprobs<'a>>,
    pub(crate) listed_objects: Vec<&'a str>,
    pub(crate) new_objects: Vec<&'a str>,
    pub(crate) changes: Vec<Change>,
    pub(crate) terms: Vec<Term<'a>>,
    pub(crate) marker_map: Vec<MarkerRow<'a>>,
    pub(crate) visible_objects: Vec<Visible<'a>>,
    pub(crate) state_digest: String,
    pub(crate) chain_digest: String,
    pub(crate) trace_offset: u64,
}

fn steps(trace: &Trace) -> Vec<Step<'_>> {
    let goal = trace.task.goal_changes();
    let candidates = candidates(&trace.task);
    let objects = trace.task.objects.iter();
    let categories: BTreeSet<&str> = objects.map(|it| it.category.as_str()).collect();
    let mut seen: BTreeSet<&InstanceId> = trace
        .start
        .visible
        .iter()
        .map(|visible| &visible.object)
        .collect();
    let mut rows = Vec::with_capacity(trace.steps.len());
    let mut revisits = Revisits::new(trace);
    for record in &trace.steps {
        let repeated = revisits.follow(record);
        let (goals_met, goals_missing) = revisits.goals();
        let shown = record
            .visible
            .iter()
            .map(|visible| &visible.object)
            .chain(&record.listed);
        let new_objects = shown
            .filter(|object| seen.insert(*object))
            .map(InstanceId::as_str)
            .collect();
        let (policy, lookup) = (record.input.policy.as_ref(), record.input.lookup.as_ref());
        let recorded = policy.and_then(|policy| policy.logprobs.as_ref());
        let by_policy = |(policy, logprobs)| PolicyLogprobs { policy, logprobs };
        rows.push(Step {
            step: record.step,
            tool: record.tool_name(),
            call_name: &record.input.call.name,
            arguments: canonical_json(&record.input.call.arguments),
            argument: record.input.call.argument(),
            text: record.outcome.text.as_str().into(),
            error_code: record.outcome.error.map(|code| code.as_str()),
            error_class: record.outcome.error.map(|code| match code.class() {
                ErrorClass::Severe => "severe",
                ErrorClass::Moderate => "moderate",
            }),
            object: record.object.as_ref().map(InstanceId::as_str),
            receptacle: record.receptacle.as_ref().map(|id| id.as_str()),
            goal_object: record
                .object
                .as_ref()
                .map(|object| goal.iter().any(|event| event.object() == Some(object))),
            goal_receptacle: goal_receptacle(record, &goal),
            object_match: record
                .object
                .as_ref()
                .map(|object| object_match(&trace.task, object)),
            receptacle_match: record
                .receptacle
                .as_ref()
                .map(|id| receptacle_match(&trace.task, &trace.scene, id)),
            put_back: put_back(&trace.task, record),
            primitive: primitive(trace, record).map(Primitive::as_str),
            fell: fell(&trace.task, record),
            repeated,
            goals_met,
            goals_missing,
            held: record.held.as_ref().map(InstanceId::as_str),
            marker_count: record.markers.len(),
            visible_count: record.visible.len(),
            candidate_count: seen
                .iter()
                .filter(|object| candidates.contains(*object))
                .count(),
            reward: record.reward_total(),
            sim_step: record.sim_step,
            robot_x_m: record.robot.base[0],
            robot_y_m: record.robot.base[1],
            robot_yaw_rad: record.robot.yaw,
            path_length_m: record.robot.path_length_m,
            latency_ns: policy
                .and_then(|policy| policy.latency_ns)
                .map(|ns| ns.min(i64::MAX as u64)),
            duration_ns: trace.timings.get(&record.step).map(|timing| timing.took_ns),
            reasoning: policy.and_then(|policy| said(&policy.reasoning)),
            history: policy.and_then(|policy| said(&policy.history)),
            plan: policy.and_then(|policy| said(&policy.plan)),
            question: question(record),
            reply: record.reply.as_ref().map(|reply| reply.text.as_str()),
            settles: settles(
                &trace.task,
                record,
                seen.iter().copied().filter(|id| candidates.contains(*id)),
            ),
            reply_source: record.reply.as_ref().map(|reply| name_of(&reply.source)),
            refused_replies: (trace.header.backend == Backend::Sim && record.reply.is_some())
                .then_some(record.input.refused_replies.len()),
            match_source: query(trace, record)
                .map(|_| lookup.map_or("words", |lookup| lookup.source.as_str())),
            match_categories: lookup.map(|lookup| lookup.categories.as_slice()),
            query_known: query(trace, record).map(|query| {
                language::is_known_word(&query)
                    || language::match_category(&query, &categories).kind
                        != language::MatchKind::None
            }),
            raw: policy.and_then(|policy| said(&policy.raw)),
            prompt_tokens: policy
                .and_then(|policy| policy.tokens)
                .map(|[read, _]| count(read)),
            completion_tokens: policy
                .and_then(|policy| policy.tokens)
                .map(|[_, written]| count(written)),
            tokens: recorded.map(TokenLogprobs::tokens),
            logprobs: recorded
                .into_iter()
                .flat_map(TokenLogprobs::policies)
                .map(by_policy)
                .collect(),
            listed_objects: record.listed.iter().map(InstanceId::as_str).collect(),
            new_objects,
            changes: changes(&record.changes),
            terms: record.reward.iter().map(term).collect(),
            marker_map: record.markers.iter().map(marker).collect(),
            visible_objects: record.visible.iter().map(visible).collect(),
            state_digest: record.digests.state.to_string(),
            chain_digest: trace
                .link(Some(record.step))
                .unwrap_or_default()
                .to_string(),
            trace_offset: trace.offset(record.step),
        });
    }
    rows
}

fn said(text: &str) -> Option<&str> {
    Some(text).filter(|text| !text.is_empty())
}

/// Objects that may be taken for the target: of its category, or named as its distractors. The
/// target is one of them.
fn candidates(task: &Task) -> BTreeSet<&InstanceId> {
    task.objects
        .iter()
        .filter(|object| role(task, &object.instance) != "other")
        .map(|object| &object.instance)
        .collect()
}

fn role(task: &Task, instance: &InstanceId) -> &'static str {
    if *instance == task.target {
        return "target";
    }
    let target_category = task.object(&task.target).map(|object| &object.category);
    match task.object(instance) {
        Some(object)
            if Some(&object.category) == target_category
                || task.object_distractors.contains(&object.asset) =>
        {
            "distractor"
        }
        _ => "other",
    }
}

fn goal_receptacle(record: &StepRecord, goal: &[GraphEvent]) -> Option<bool> {
    let (object, receptacle) = (record.object.as_ref()?, record.receptacle.as_ref()?);
    Some(goal.contains(&GraphEvent::Add {
        object: object.clone(),
        receptacle: receptacle.clone(),
    }))
}

/// What an object is beside the target.
pub(crate) fn object_match(task: &Task, instance: &InstanceId) -> &'static str {
    let (target, object) = (task.object(&task.target), task.object(instance));
    match (target, object) {
        _ if *instance == task.target => "target",
        (Some(target), Some(object)) if object.asset == target.asset => "instance",
        (Some(target), Some(object)) if object.category == target.category => "category",
        (_, Some(object)) if task.object_distractors.contains(&object.asset) => "distractor",
        _ => "other",
    }
}

/// What a receptacle is beside the destination.
pub(crate) fn receptacle_match(
    task: &Task,
    scene: &Scene,
    receptacle: &ReceptacleId,
) -> &'static str {
    let category = |id: &ReceptacleId| scene.receptacle(id).map(|receptacle| &receptacle.category);
    match receptacle {
        id if *id == task.dest => "dest",
        id if *id == task.src => "src",
        id if task.dest_distractors.contains(id) => "similar",
        id if category(id).is_some() && category(id) == category(&task.dest) => "similar",
        _ => "other",
    }
}

/// Of a successful `place`: whether the object is where the task began with it.
fn put_back(task: &Task, record: &StepRecord) -> Option<bool> {
    let (object, receptacle) = (record.object.as_ref()?, record.receptacle.as_ref()?);
    let placed = record.tool_name() == "place" && record.outcome.is_ok();
    placed.then(|| task.initial.receptacle_of(object) == Some(receptacle))
}

/// What a step let fall.
fn fell(task: &Task, record: &StepRecord) -> Option<&'static str> {
    let on_floor = |event: &&GraphEvent| matches!(event, GraphEvent::Add { receptacle, .. } if receptacle.as_str() == FLOOR);
    let mut fallen = record
        .changes
        .physics
        .iter()
        .filter(on_floor)
        .filter_map(GraphEvent::object)
        .peekable();
    fallen.peek()?;
    Some(if fallen.any(|object| *object == task.target) {
        "target"
    } else {
        "other"
    })
}

/// The skill of the arm that a call runs. A failed `place` acted on nothing: its marker tells where
/// it aimed, else the robot's word for it does. What the robot itself calls `place_inside` is that.
fn primitive(trace: &Trace, record: &StepRecord) -> Option<Primitive> {
    let tool = record.tool_name();
    if tool != "place" {
        return Primitive::parse(tool);
    }
    let number: Option<u32> = record
        .input
        .call
        .argument()
        .and_then(|argument| argument.parse().ok());
    let aimed = record
        .markers
        .iter()
        .find_map(|marker| match &marker.target {
            MarkerTarget::Receptacle(id) if Some(marker.id) == number => Some(id),
            _ => None,
        });
    let known = record
        .receptacle
        .as_ref()
        .or(aimed)
        .and_then(|id| trace.scene.receptacle(id))
        .map(|place| place.door.exists());
    let outcomes = trace.robot.primitives.iter();
    let mut executed = outcomes.filter(|outcome| outcome.step == Some(record.step));
    if let Some(class) = executed.clone().find_map(|it| Primitive::parse(&it.skill)) {
        return Some(class);
    }
    let has_door = known.or_else(|| {
        let word = executed.find_map(|outcome| said(&outcome.target))?;
        let meant =
            trace.scene.receptacles.iter().filter(|place| {
                place.id.as_str() == word || place.category.eq_ignore_ascii_case(word)
            });
        let doors: BTreeSet<bool> = meant.map(|place| place.door.exists()).collect();
        doors.first().copied().filter(|_| doors.len() == 1)
    });
    has_door.map(Primitive::place)
}

/// Of an answered question: whether the answer fits the target and none of the other candidates
/// that were seen.
fn settles<'a>(
    task: &Task,
    record: &StepRecord,
    mut candidates: impl Iterator<Item = &'a InstanceId>,
) -> Option<bool> {
    let reply = &record.reply.as_ref()?.text;
    let fits = |id: &InstanceId| {
        task.object(id)
            .is_some_and(|object| language::fits(reply, object, None))
    };
    let told_apart = !candidates.any(|id| *id != task.target && fits(id));
    Some(language::names_object(reply) && fits(&task.target) && told_apart)
}

/// The query of a search for a category that Reel's simulator carried out: what others match by,
/// nobody knows.
fn query<'a>(trace: &Trace, record: &'a StepRecord) -> Option<Cow<'a, str>> {
    let is_search = record.tool_name() == "show_object_by_category"
        && record.outcome.error != Some(ErrorCode::BadArguments)
        && trace.header.backend == Backend::Sim;
    is_search.then(|| record.input.call.argument()).flatten()
}

/// As many tokens as a column holds.
fn count(tokens: u32) -> u32 {
    tokens.min(i32::MAX as u32)
}

fn question(record: &StepRecord) -> Option<Cow<'_, str>> {
    if record.tool_name() != "ask" {
        return None;
    }
    let call = &record.input.call;
    Some(
        call.argument()
            .unwrap_or_else(|| canonical_json(&call.arguments).into()),
    )
}
