//! A trace as rows: the values of every column of [`crate::schema`]. Arrow's own JSON decoder turns the rows into
//! columns, strictly, so that a field here without a column there (or the reverse) is an error of every test.

use std::collections::BTreeSet;

use arrow::{array::RecordBatch, error::ArrowError, json::ReaderBuilder};
use reel_trace::Trace;
use reel_world::{
    ErrorClass, GraphEvent, InstanceId, Task, ToolSpec, WorldGraph, canonical_json,
    record::{EpisodeHeader, MarkerTarget, StepRecord},
};
use serde::Serialize;
use serde_json::Value;

use crate::Table;

/// Step number of what was before the first decision.
const BEFORE_THE_FIRST: i32 = -1;

/// The rows of one trace in one table.
///
/// # Errors
/// When Arrow refuses a value, e.g. a number too large for its column.
pub(crate) fn batch(trace: &Trace, table: Table) -> Result<RecordBatch, ArrowError> {
    match table {
        Table::Episodes => decode(table, &[episode(trace)]),
        Table::WorldDiffs => decode(table, &world_diffs(trace)),
        Table::Rewards => decode(table, &rewards(trace)),
        Table::Tasks => decode(table, &[task(trace)]),
        Table::Objects => decode(table, &objects(trace)),
        Table::Markers => decode(table, &markers(trace)),
        Table::VisibleObjects => decode(table, &visible_objects(trace)),
        Table::Dialogue => decode(table, &dialogue(trace)),
    }
}

fn decode<R: Serialize>(table: Table, rows: &[R]) -> Result<RecordBatch, ArrowError> {
    let schema = table.schema();
    let size = rows.len().max(1);
    let mut decoder = ReaderBuilder::new(schema.clone()).with_strict_mode(true).with_batch_size(size).build_decoder()?;
    decoder.serialize(rows)?;
    Ok(decoder.flush()?.unwrap_or_else(|| RecordBatch::new_empty(schema)))
}

#[derive(Serialize)]
struct Episode<'a> {
    episode_id: &'a str,
    run_id: &'a str,
    group_id: Option<&'a str>,
    rollout_index: Option<u32>,
    task_id: &'a str,
    task_digest: String,
    family: &'static str,
    task_type: Option<&'a str>,
    scene_id: &'a str,
    policy: &'a str,
    checkpoint: Option<&'a str>,
    seed: u64,
    profile: &'static str,
    preset: &'a str,
    sim_version: u32,
    build: &'a str,
    backend: Value,
    end_reason: Option<Value>,
    success: Option<bool>,
    completion: Option<f64>,
    total_reward: Option<f64>,
    discounted_return: Option<f64>,
    length: Option<u32>,
    asks: Option<u32>,
    spl: Option<f64>,
    instruction: &'a str,
    fuzzy: bool,
    purpose: Option<&'a str>,
    target: &'a str,
    target_category: &'a str,
    target_caption: Option<&'a str>,
    src: &'a str,
    dest: &'a str,
    shortest_path_m: Option<f64>,
    path_length_m: f64,
    trace_uri: String,
    trace_digest: String,
    trace_bytes: u64,
    steps: Vec<Step<'a>>,
}

fn episode(trace: &Trace) -> Episode<'_> {
    let Trace { header, task, start, end, .. } = trace;
    let target = task.object(&task.target);
    let metrics = end.as_ref().map(|end| &end.metrics);
    let last_robot = trace.steps.last().map_or(&start.robot, |step| &step.robot);
    Episode {
        episode_id: &header.episode_id,
        run_id: &header.run_id,
        group_id: header.group_id.as_deref(),
        rollout_index: header.rollout_index,
        task_id: &header.task_id,
        task_digest: header.task_digest.to_string(),
        family: header.family.as_str(),
        task_type: task.task_type.as_deref(),
        scene_id: &header.scene_id,
        policy: &header.policy.name,
        checkpoint: header.policy.checkpoint.as_deref(),
        seed: header.seed,
        profile: header.profile.as_str(),
        preset: &header.reward_preset,
        sim_version: header.sim_version,
        build: &header.build,
        backend: name_of(&header.backend),
        end_reason: end.as_ref().map(|end| name_of(&end.reason)),
        success: metrics.map(|metrics| metrics.success),
        completion: metrics.map(|metrics| metrics.completion),
        total_reward: metrics.map(|metrics| metrics.total_reward),
        discounted_return: metrics.map(|metrics| metrics.discounted_return),
        length: metrics.map(|metrics| metrics.length),
        asks: metrics.map(|metrics| metrics.asks),
        spl: metrics.and_then(|metrics| metrics.spl),
        instruction: &task.instruction,
        fuzzy: task.fuzzy,
        purpose: task.purpose.as_deref(),
        target: task.target.as_str(),
        target_category: target.map_or("", |object| &object.category),
        target_caption: target.and_then(|object| object.caption.as_deref()),
        src: task.src.as_str(),
        dest: task.dest.as_str(),
        shortest_path_m: start.shortest_path_m.map(f64::from),
        path_length_m: last_robot.path_length_m.into(),
        trace_uri: trace.path.display().to_string(),
        trace_digest: trace.chain().to_string(),
        trace_bytes: trace.bytes,
        steps: steps(trace),
    }
}

#[derive(Serialize)]
struct Step<'a> {
    step: u32,
    tool: &'a str,
    call_name: &'a str,
    arguments: String,
    argument: Option<String>,
    text: &'a str,
    error_code: Option<&'static str>,
    error_class: Option<&'static str>,
    object: Option<&'a str>,
    receptacle: Option<&'a str>,
    goal_object: Option<bool>,
    goal_receptacle: Option<bool>,
    held: Option<&'a str>,
    markers: usize,
    visible: usize,
    candidates: usize,
    reward: f64,
    sim_step: u64,
    robot_x_m: f32,
    robot_y_m: f32,
    robot_yaw_rad: f32,
    path_length_m: f32,
    latency_ns: Option<u64>,
    reasoning: Option<&'a str>,
    history: Option<&'a str>,
    plan: Option<&'a str>,
    question: Option<String>,
    reply: Option<&'a str>,
    reply_source: Option<Value>,
    state_digest: String,
    chain_digest: String,
    trace_offset: u64,
}

fn steps(trace: &Trace) -> Vec<Step<'_>> {
    let goal = trace.task.goal_changes();
    let candidates = candidates(&trace.task);
    let mut seen: BTreeSet<&InstanceId> = trace.start.visible.iter().map(|visible| &visible.object).collect();
    let mut rows = Vec::with_capacity(trace.steps.len());
    for record in &trace.steps {
        seen.extend(record.visible.iter().map(|visible| &visible.object));
        seen.extend(&record.listed);
        let policy = record.input.policy.as_ref();
        rows.push(Step {
            step: record.step,
            tool: record.tool_name(),
            call_name: &record.input.call.name,
            arguments: canonical_json(&record.input.call.arguments),
            argument: argument(record),
            text: &record.outcome.text,
            error_code: record.outcome.error.map(|code| code.as_str()),
            error_class: record.outcome.error.map(|code| match code.class() {
                ErrorClass::Severe => "severe",
                ErrorClass::Moderate => "moderate",
            }),
            object: record.object.as_ref().map(InstanceId::as_str),
            receptacle: record.receptacle.as_ref().map(|id| id.as_str()),
            goal_object: record.object.as_ref().map(|object| goal.iter().any(|event| event.object() == Some(object))),
            goal_receptacle: goal_receptacle(record, &goal),
            held: record.held.as_ref().map(InstanceId::as_str),
            markers: record.markers.len(),
            visible: record.visible.len(),
            candidates: seen.iter().filter(|object| candidates.contains(*object)).count(),
            reward: record.reward_total(),
            sim_step: record.sim_step,
            robot_x_m: record.robot.base[0],
            robot_y_m: record.robot.base[1],
            robot_yaw_rad: record.robot.yaw,
            path_length_m: record.robot.path_length_m,
            latency_ns: policy.and_then(|policy| policy.latency_ns),
            reasoning: policy.and_then(|policy| said(&policy.reasoning)),
            history: policy.and_then(|policy| said(&policy.history)),
            plan: policy.and_then(|policy| said(&policy.plan)),
            question: question(record),
            reply: record.reply.as_ref().map(|reply| reply.text.as_str()),
            reply_source: record.reply.as_ref().map(|reply| name_of(&reply.source)),
            state_digest: record.digests.state.to_string(),
            chain_digest: record.digests.chain.to_string(),
            trace_offset: trace.offset(record.step),
        });
    }
    rows
}

fn said(text: &str) -> Option<&str> {
    Some(text).filter(|text| !text.is_empty())
}

/// Objects that may be taken for the target: of its category, or named as its distractors. The target is one of them.
fn candidates(task: &Task) -> BTreeSet<&InstanceId> {
    task.objects.iter().filter(|object| role(task, &object.instance) != "other").map(|object| &object.instance).collect()
}

fn role(task: &Task, instance: &InstanceId) -> &'static str {
    if *instance == task.target {
        return "target";
    }
    let target_category = task.object(&task.target).map(|object| &object.category);
    match task.object(instance) {
        Some(object) if Some(&object.category) == target_category || task.object_distractors.contains(&object.asset) => {
            "distractor"
        }
        _ => "other",
    }
}

fn goal_receptacle(record: &StepRecord, goal: &[GraphEvent]) -> Option<bool> {
    let (object, receptacle) = (record.object.as_ref()?, record.receptacle.as_ref()?);
    Some(goal.contains(&GraphEvent::Add { object: object.clone(), receptacle: receptacle.clone() }))
}

fn argument(record: &StepRecord) -> Option<String> {
    let key = ToolSpec::by_name(&record.input.call.name)?.argument?.name;
    match record.input.call.arguments.get(key)? {
        Value::String(text) => Some(text.clone()),
        other => Some(other.to_string()),
    }
}

fn question(record: &StepRecord) -> Option<String> {
    if record.tool_name() != "ask" {
        return None;
    }
    argument(record).or_else(|| Some(canonical_json(&record.input.call.arguments)))
}

#[derive(Serialize)]
struct WorldDiff<'a> {
    episode_id: &'a str,
    step: u32,
    authority: &'static str,
    event: &'static str,
    object: Option<&'a str>,
    asset: Option<String>,
    receptacle: &'a str,
    door_from: Option<String>,
    door_to: Option<String>,
}

fn world_diffs(trace: &Trace) -> Vec<WorldDiff<'_>> {
    let mut rows = Vec::new();
    for record in &trace.steps {
        for (authority, events) in [("physics", &record.changes.physics), ("registry", &record.changes.registry)] {
            for event in events {
                let (name, receptacle, doors) = match event {
                    GraphEvent::Add { receptacle, .. } => ("add", receptacle, None),
                    GraphEvent::Remove { receptacle, .. } => ("remove", receptacle, None),
                    GraphEvent::Door { receptacle, from, to } => ("door", receptacle, Some((from, to))),
                };
                rows.push(WorldDiff {
                    episode_id: &trace.header.episode_id,
                    step: record.step,
                    authority,
                    event: name,
                    object: event.object().map(InstanceId::as_str),
                    asset: event.object().map(|object| object.asset().into()),
                    receptacle: receptacle.as_str(),
                    door_from: doors.map(|(from, _)| from.to_string()),
                    door_to: doors.map(|(_, to)| to.to_string()),
                });
            }
        }
    }
    rows
}

#[derive(Serialize)]
struct Reward<'a> {
    episode_id: &'a str,
    step: u32,
    preset: &'a str,
    component: &'a str,
    value: f64,
    reason: &'a str,
}

fn rewards(trace: &Trace) -> Vec<Reward<'_>> {
    let EpisodeHeader { episode_id, reward_preset, .. } = &trace.header;
    let terms = trace.steps.iter().flat_map(|record| record.reward.iter().map(|term| (record.step, term)));
    terms
        .map(|(step, term)| Reward {
            episode_id,
            step,
            preset: reward_preset,
            component: &term.component,
            value: term.value,
            reason: &term.reason,
        })
        .collect()
}

#[derive(Serialize)]
struct TaskRow<'a> {
    task_id: &'a str,
    task_digest: String,
    family: &'static str,
    task_type: Option<&'a str>,
    scene_id: &'a str,
    instruction: &'a str,
    precise_instruction: &'a str,
    fuzzy: bool,
    purpose: Option<&'a str>,
    target: &'a str,
    target_category: &'a str,
    src: &'a str,
    dest: &'a str,
    src_door: Option<String>,
    dest_door: Option<String>,
    src_distractors: Vec<&'a str>,
    dest_distractors: Vec<&'a str>,
    object_distractors: Vec<&'a str>,
    goal_changes: Vec<String>,
    objects: usize,
}

fn task(trace: &Trace) -> TaskRow<'_> {
    let task = &trace.task;
    let door = |graph: &WorldGraph, receptacle| graph.door(receptacle).map(|door| door.to_string());
    TaskRow {
        task_id: &task.task_id,
        task_digest: trace.header.task_digest.to_string(),
        family: task.family.as_str(),
        task_type: task.task_type.as_deref(),
        scene_id: &task.scene_id,
        instruction: &task.instruction,
        precise_instruction: &task.precise_instruction,
        fuzzy: task.fuzzy,
        purpose: task.purpose.as_deref(),
        target: task.target.as_str(),
        target_category: task.object(&task.target).map_or("", |object| &object.category),
        src: task.src.as_str(),
        dest: task.dest.as_str(),
        src_door: door(&task.initial, &task.src),
        dest_door: door(&task.initial, &task.dest),
        src_distractors: task.src_distractors.iter().map(|id| id.as_str()).collect(),
        dest_distractors: task.dest_distractors.iter().map(|id| id.as_str()).collect(),
        object_distractors: task.object_distractors.iter().map(|id| id.as_str()).collect(),
        goal_changes: task.goal_changes().iter().map(ToString::to_string).collect(),
        objects: task.objects.len(),
    }
}

#[derive(Serialize)]
struct ObjectRow<'a> {
    task_id: &'a str,
    task_digest: String,
    instance: &'a str,
    asset: &'a str,
    category: &'a str,
    caption: Option<&'a str>,
    attributes: Vec<AttributeWord<'a>>,
    width_m: f64,
    depth_m: f64,
    height_m: f64,
    receptacle: &'a str,
    role: &'static str,
}

#[derive(Serialize)]
struct AttributeWord<'a> {
    kind: &'a str,
    word: &'a str,
}

fn objects(trace: &Trace) -> Vec<ObjectRow<'_>> {
    trace
        .task
        .objects
        .iter()
        .map(|object| ObjectRow {
            task_id: &trace.task.task_id,
            task_digest: trace.header.task_digest.to_string(),
            instance: object.instance.as_str(),
            asset: object.asset.as_str(),
            category: &object.category,
            caption: object.caption.as_deref(),
            attributes: object
                .attributes
                .iter()
                .flat_map(|(kind, words)| words.iter().map(move |word| AttributeWord { kind, word }))
                .collect(),
            width_m: object.size[0],
            depth_m: object.size[1],
            height_m: object.size[2],
            receptacle: object.receptacle.as_str(),
            role: role(&trace.task, &object.instance),
        })
        .collect()
}

#[derive(Serialize)]
struct MarkerRow<'a> {
    episode_id: &'a str,
    step: u32,
    marker: u32,
    kind: &'static str,
    id: &'a str,
}

fn markers(trace: &Trace) -> Vec<MarkerRow<'_>> {
    let all = trace.steps.iter().flat_map(|record| record.markers.iter().map(|marker| (record.step, marker)));
    all.map(|(step, marker)| {
        let (kind, id) = match &marker.target {
            MarkerTarget::Object(id) => ("object", id.as_str()),
            MarkerTarget::Receptacle(id) => ("receptacle", id.as_str()),
        };
        MarkerRow { episode_id: &trace.header.episode_id, step, marker: marker.id, kind, id }
    })
    .collect()
}

#[derive(Serialize)]
struct VisibleRow<'a> {
    episode_id: &'a str,
    step: i32,
    object: &'a str,
    pixels: u32,
    x_min: u16,
    y_min: u16,
    x_max: u16,
    y_max: u16,
}

fn visible_objects(trace: &Trace) -> Vec<VisibleRow<'_>> {
    let step_number = |record: &StepRecord| i32::try_from(record.step).unwrap_or(i32::MAX);
    let start = trace.start.visible.iter().map(|visible| (BEFORE_THE_FIRST, visible));
    let later = trace.steps.iter().flat_map(|record| record.visible.iter().map(move |visible| (step_number(record), visible)));
    start
        .chain(later)
        .map(|(step, visible)| VisibleRow {
            episode_id: &trace.header.episode_id,
            step,
            object: visible.object.as_str(),
            pixels: visible.pixels,
            x_min: visible.bbox[0],
            y_min: visible.bbox[1],
            x_max: visible.bbox[2],
            y_max: visible.bbox[3],
        })
        .collect()
}

#[derive(Serialize)]
struct DialogueRow<'a> {
    episode_id: &'a str,
    step: u32,
    question: String,
    reply: Option<&'a str>,
    source: Option<Value>,
}

fn dialogue(trace: &Trace) -> Vec<DialogueRow<'_>> {
    let asked = trace.steps.iter().filter_map(|record| Some((record, question(record)?)));
    asked
        .map(|(record, question)| DialogueRow {
            episode_id: &trace.header.episode_id,
            step: record.step,
            question,
            reply: record.reply.as_ref().map(|reply| reply.text.as_str()),
            source: record.reply.as_ref().map(|reply| name_of(&reply.source)),
        })
        .collect()
}

/// An enum of ours as the word it has in JSON.
fn name_of<T: Serialize>(value: &T) -> Value {
    serde_json::to_value(value).expect("an enum of ours is a JSON string")
}
