//! From records to messages.

use reel_world::{
    Digest, ErrorClass, FrameDigests, GraphEvent, TokenLogprobs, ToolCall, WorldGraph,
    record::{
        BodyState, EndRecord, EpisodeHeader, Graphs, Lookup, MarkerTarget, PolicyOutput,
        RefusedReply, Reported, RobotState, Score, StartRecord, StateDigests, StepRecord,
        UserReply, UserSource, VisibleObject,
    },
};
use serde::Serialize;
use serde_json::Value;

use crate::{
    Timing,
    robot::Odometry,
    schema::reel::{self, episode_event::Event, marker::Target},
};

/// The header, as the first message of `/episode`.
pub(crate) fn episode_start(header: &EpisodeHeader) -> reel::EpisodeEvent {
    event(Event::Start(start(header)))
}

/// The header, but for the version of Reel.
pub(crate) fn start(header: &EpisodeHeader) -> reel::EpisodeStart {
    let policy = reel::Policy {
        name: header.policy.name.clone(),
        checkpoint: header.policy.checkpoint.clone(),
        parameters_json: header
            .policy
            .parameters
            .iter()
            .map(|(key, value)| (key.clone(), value.to_string()))
            .collect(),
    };
    reel::EpisodeStart {
        episode_id: header.episode_id.clone(),
        run_id: header.run_id.clone(),
        group_id: header.group_id.clone(),
        rollout_index: header.rollout_index,
        task_id: header.task_id.clone(),
        family: word(&header.family),
        scene_id: header.scene_id.clone(),
        task_digest: bytes(&header.task_digest),
        scene_digest: bytes(&header.scene_digest),
        seed: header.seed,
        sim_version: header.sim_version,
        build: String::new(),
        profile: word(&header.profile),
        reward_preset: header.reward_preset.clone(),
        policy: Some(policy),
        backend: word(&header.backend),
        skills: (!header.skills.are_perfect()).then(|| word(&header.skills)),
        meshes: header
            .meshes
            .iter()
            .map(|(asset, mesh)| (asset.to_string(), bytes(mesh)))
            .collect(),
        parent: header.parent.as_ref().map(|parent| reel::Parent {
            trace: bytes(&parent.trace),
            call: parent.call,
        }),
    }
}

/// What `/episode` says once everything rests.
pub(crate) fn episode_settled(start: &StartRecord) -> reel::EpisodeEvent {
    event(Event::Settled(reel::EpisodeSettled {
        visible: visible(&start.visible),
        shortest_path_m: start.shortest_path_m,
    }))
}

/// The end, as the last message of `/episode`.
pub(crate) fn episode_end(end: &EndRecord) -> reel::EpisodeEvent {
    let metrics = &end.metrics;
    let metrics = reel::Metrics {
        success: metrics.success,
        completion: Some(metrics.completion),
        total_reward: Some(metrics.total_reward),
        discounted_return: Some(metrics.discounted_return),
        length: metrics.length,
        asks: metrics.asks,
        spl: metrics.spl,
    };
    event(Event::End(reel::EpisodeEnd {
        reason: word(&end.reason),
        metrics: Some(metrics),
        chain: Vec::new(),
        steps: end.steps,
    }))
}

/// What was said of the result, as the message of `/reported`.
pub(crate) fn reported(said: &Reported) -> reel::ReportedOutcome {
    reel::ReportedOutcome {
        success: said.success,
        scores: said.scores.iter().map(score).collect(),
    }
}

fn score(score: &Score) -> reel::Score {
    reel::Score {
        name: score.name.clone(),
        value: score.value,
        label: score.label.clone(),
        explanation: score.explanation.clone(),
    }
}

/// Both graphs of a moment: `start` or `end`.
pub(crate) fn world_graphs(moment: &str, graphs: &Graphs) -> reel::WorldGraphs {
    reel::WorldGraphs {
        moment: moment.to_owned(),
        physics: Some(world_graph(&graphs.physics)),
        registry: Some(world_graph(&graphs.registry)),
    }
}

/// The call of a step.
pub(crate) fn tool_call(step: u32, call: &ToolCall, lookup: Option<&Lookup>) -> reel::ToolCall {
    let lookup = lookup.map(|it| reel::Lookup {
        categories: it.categories.clone(),
        source: it.source.clone(),
    });
    reel::ToolCall {
        step,
        name: call.name.clone(),
        arguments_json: call.arguments.to_string(),
        lookup,
    }
}

/// What came with the call.
pub(crate) fn policy_output(step: u32, policy: &PolicyOutput) -> reel::PolicyOutput {
    reel::PolicyOutput {
        step,
        raw: policy.raw.clone(),
        reasoning: policy.reasoning.clone(),
        history: policy.history.clone(),
        plan: policy.plan.clone(),
        tokens: policy
            .tokens
            .map(|[input, output]| reel::TokenCount { input, output }),
        latency_ns: None,
    }
}

/// How long the decision took.
pub(crate) fn policy_latency(step: u32, latency_ns: u64) -> reel::PolicyLatency {
    reel::PolicyLatency { step, latency_ns }
}

/// What policies give the tokens of a decision.
pub(crate) fn logprobs(step: u32, logprobs: &TokenLogprobs) -> reel::TokenLogprobs {
    let policies = logprobs.policies();
    let policies = policies.map(|(policy, logprobs)| reel::PolicyLogprobs {
        policy: policy.to_owned(),
        logprobs: logprobs.to_vec(),
    });
    reel::TokenLogprobs {
        step,
        tokens: logprobs.tokens().to_vec(),
        policies: policies.collect(),
    }
}

/// When a call was made, and how long it took.
pub(crate) fn timing(step: u32, timing: &Timing) -> reel::Timing {
    reel::Timing {
        step,
        called_unix_ns: timing.called_unix_ns,
        took_ns: timing.took_ns,
    }
}

/// Where the robot was.
pub(crate) fn odometry(measured: &Odometry) -> reel::Odometry {
    let Odometry {
        step,
        unix_ns,
        x,
        y,
        yaw,
    } = *measured;
    reel::Odometry {
        step,
        unix_ns,
        x: Some(x),
        y: Some(y),
        yaw: Some(yaw),
    }
}

/// A reply: `outside` or `answer`.
pub(crate) fn user_dialogue(step: u32, kind: &str, reply: &UserReply) -> reel::UserDialogue {
    reel::UserDialogue {
        step,
        kind: kind.to_owned(),
        text: reply.text.clone(),
        source: word(&reply.source),
        rules: Vec::new(),
    }
}

/// A reply that the policy did not get.
pub(crate) fn refused_reply(step: u32, refused: &RefusedReply) -> reel::UserDialogue {
    reel::UserDialogue {
        step,
        kind: "refused".to_owned(),
        text: refused.text.clone(),
        source: word(&UserSource::Model),
        rules: refused.rules.clone(),
    }
}

/// What the call came to.
pub(crate) fn tool_result(record: &StepRecord) -> reel::ToolResult {
    let markers = record.markers.iter().map(|marker| {
        let target = match &marker.target {
            MarkerTarget::Object(id) => Target::Object(id.to_string()),
            MarkerTarget::Receptacle(id) => Target::Receptacle(id.to_string()),
        };
        reel::Marker {
            id: marker.id,
            target: Some(target),
        }
    });
    reel::ToolResult {
        step: record.step,
        text: record.outcome.text.clone(),
        error: record.outcome.error.map(|code| code.as_str().to_owned()),
        error_class: record
            .outcome
            .error
            .map(|code| class_word(code.class()).to_owned()),
        tool: record.tool.clone(),
        markers: markers.collect(),
        visible: visible(&record.visible),
        listed: record.listed.iter().map(ToString::to_string).collect(),
        object: record.object.as_ref().map(ToString::to_string),
        receptacle: record.receptacle.as_ref().map(ToString::to_string),
        held: record.held.as_ref().map(ToString::to_string),
    }
}

/// What a step changed.
pub(crate) fn world_diff(record: &StepRecord) -> reel::WorldDiff {
    let events = |events: &[GraphEvent]| events.iter().map(graph_event).collect();
    reel::WorldDiff {
        step: record.step,
        physics: events(&record.changes.physics),
        registry: events(&record.changes.registry),
    }
}

/// The reward of a step under the header's preset.
pub(crate) fn reward(preset: &str, record: &StepRecord) -> reel::Reward {
    let terms = record.reward.iter().map(|term| reel::RewardTerm {
        component: term.component.clone(),
        value: Some(term.value),
        reason: term.reason.clone(),
    });
    reel::Reward {
        step: record.step,
        preset: preset.to_owned(),
        terms: terms.collect(),
    }
}

/// Motion states and digests of a moment.
pub(crate) fn sim_digest(
    step: Option<u32>,
    sim_step: u64,
    bodies: &[BodyState],
    robot: &RobotState,
    digests: &StateDigests,
) -> reel::SimDigest {
    let frame = |frame: &FrameDigests| reel::FrameDigests {
        rgb: bytes(&frame.rgb),
        ids: bytes(&frame.ids),
        depth: bytes(&frame.depth),
    };
    let body = |body: &BodyState| reel::BodyState {
        body: body.body.clone(),
        position: body.position.into(),
        rotation: body.rotation.into(),
        linear_velocity: body.linear_velocity.into(),
        angular_velocity: body.angular_velocity.into(),
        asleep: body.asleep,
    };
    reel::SimDigest {
        step,
        sim_step,
        state: bytes(&digests.state),
        frame: digests.frame.as_ref().map(frame),
        physics_steps: digests.physics_steps.clone(),
        chain: Vec::new(),
        bodies: bodies.iter().map(body).collect(),
        robot: Some(reel::RobotState {
            base: robot.base.into(),
            yaw: Some(robot.yaw),
            camera: robot.camera.into(),
            pitch: Some(robot.pitch),
            path_length_m: Some(robot.path_length_m),
        }),
    }
}

/// A word of a closed set, as it stands in our JSON.
pub(crate) fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(word)) => word,
        other => unreachable!("an enum without fields is a string in JSON, not {other:?}"),
    }
}

pub(super) fn class_word(class: ErrorClass) -> &'static str {
    match class {
        ErrorClass::Severe => "severe",
        ErrorClass::Moderate => "moderate",
    }
}

fn event(event: Event) -> reel::EpisodeEvent {
    reel::EpisodeEvent { event: Some(event) }
}

fn bytes(digest: &Digest) -> Vec<u8> {
    digest.0.to_vec()
}

fn visible(objects: &[VisibleObject]) -> Vec<reel::VisibleObject> {
    let object = |seen: &VisibleObject| {
        let [x_min, y_min, x_max, y_max] = seen.bbox.map(u32::from);
        reel::VisibleObject {
            object: seen.object.to_string(),
            pixels: seen.pixels,
            x_min,
            y_min,
            x_max,
            y_max,
        }
    };
    objects.iter().map(object).collect()
}

fn world_graph(graph: &WorldGraph) -> reel::WorldGraph {
    let receptacles = graph
        .receptacles
        .iter()
        .map(|(id, state)| reel::ReceptacleState {
            receptacle: id.to_string(),
            door: state.door.as_ref().map(word),
            content: state
                .content
                .iter()
                .map(|(id, count)| reel::Content {
                    object: id.to_string(),
                    count: *count,
                })
                .collect(),
        });
    reel::WorldGraph {
        receptacles: receptacles.collect(),
    }
}

fn graph_event(event: &GraphEvent) -> reel::GraphEvent {
    let (name, from, to) = match event {
        GraphEvent::Remove { .. } => ("remove", None, None),
        GraphEvent::Add { .. } => ("add", None, None),
        GraphEvent::Door { from, to, .. } => ("door", Some(word(from)), Some(word(to))),
    };
    let object = event.object().map(ToString::to_string);
    reel::GraphEvent {
        event: name.to_owned(),
        receptacle: event.receptacle().to_string(),
        object,
        from,
        to,
    }
}
