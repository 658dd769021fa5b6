//! From messages to records. Every refusal says which field is wrong and how.

use std::collections::BTreeMap;

use prost::Message;
use reel_world::{
    Digest, ErrorCode, FrameDigests, GraphEvent, Outcome, ReceptacleState, Skills, TokenLogprobs,
    ToolCall, WorldGraph,
    record::{
        BodyState, EndRecord, EpisodeHeader, GraphChanges, Graphs, Lookup, Marker, MarkerTarget,
        Metrics, Parent, PolicyInfo, PolicyOutput, RefusedReply, Reported, RewardTerm, RobotState,
        Score, StateDigests, UserReply, UserSource, VisibleObject,
    },
};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::encode::class_word;
use crate::{
    robot::Odometry,
    schema::reel::{self, marker::Target},
};

/// What a message holds, or what is wrong with it.
type Read<T> = Result<T, String>;

/// The decoded content of one `/sim/digest` message.
pub(crate) struct DigestMessage {
    pub step: Option<u32>,
    pub sim_step: u64,
    pub bodies: Vec<BodyState>,
    pub robot: RobotState,
    pub digests: StateDigests,
}

/// Decodes a protobuf message; fails if Reel would encode it differently.
pub(crate) fn decode_message<M: Message + Default>(bytes: &[u8]) -> Read<M> {
    let message = M::decode(bytes)
        .map_err(|error| format!("it is not the protobuf message it should be ({error})"))?;
    // One record has one encoding: what would be dropped in silence is not covered
    // by the hash chain.
    if message.encode_to_vec() == bytes {
        Ok(message)
    } else {
        Err("it holds fields that this version of Reel does not know, or is not encoded as Reel encodes".to_owned())
    }
}

pub(crate) fn read_header(start: reel::EpisodeStart) -> Read<EpisodeHeader> {
    let policy = start.policy.ok_or("policy is missing")?;
    let parameters: Read<BTreeMap<String, Value>> = policy
        .parameters_json
        .into_iter()
        .map(|(key, text)| Ok((key, json(&text)?)))
        .collect();
    let parent = |parent: reel::Parent| {
        Read::Ok(Parent {
            trace: digest(&parent.trace)?,
            call: parent.call,
        })
    };
    Ok(EpisodeHeader {
        episode_id: start.episode_id,
        run_id: start.run_id,
        group_id: start.group_id,
        rollout_index: start.rollout_index,
        task_id: start.task_id,
        family: parse_word(&start.family)?,
        scene_id: start.scene_id,
        task_digest: digest(&start.task_digest)?,
        scene_digest: digest(&start.scene_digest)?,
        seed: start.seed,
        sim_version: start.sim_version,
        build: start.build,
        profile: parse_word(&start.profile)?,
        reward_preset: start.reward_preset,
        policy: PolicyInfo {
            name: policy.name,
            checkpoint: policy.checkpoint,
            parameters: parameters?,
        },
        backend: parse_word(&start.backend)?,
        skills: start
            .skills
            .map_or(Ok(Skills::Perfect), |skills| parse_word(&skills))?,
        meshes: start
            .meshes
            .into_iter()
            .map(|(asset, mesh)| Ok((asset.into(), digest(&mesh)?)))
            .collect::<Read<_>>()?,
        parent: start.parent.map(parent).transpose()?,
    })
}

pub(crate) fn read_visible(objects: Vec<reel::VisibleObject>) -> Read<Vec<VisibleObject>> {
    let side = |pixel: u32| {
        u16::try_from(pixel)
            .map_err(|_| format!("pixel {pixel} of a bounding box is above {}", u16::MAX))
    };
    let object = |seen: reel::VisibleObject| {
        let bbox = [
            side(seen.x_min)?,
            side(seen.y_min)?,
            side(seen.x_max)?,
            side(seen.y_max)?,
        ];
        Ok(VisibleObject {
            object: seen.object.into(),
            pixels: seen.pixels,
            bbox,
        })
    };
    objects.into_iter().map(object).collect()
}

pub(crate) fn read_end(
    end: reel::EpisodeEnd,
    graphs: Graphs,
    reported: Reported,
) -> Read<EndRecord> {
    let metrics = end.metrics.ok_or("metrics are missing")?;
    let metrics = Metrics {
        success: metrics.success,
        completion: metrics.completion.ok_or("completion is missing")?,
        total_reward: metrics.total_reward.ok_or("total_reward is missing")?,
        discounted_return: metrics
            .discounted_return
            .ok_or("discounted_return is missing")?,
        length: metrics.length,
        asks: metrics.asks,
        spl: metrics.spl,
    };
    Ok(EndRecord {
        reason: parse_word(&end.reason)?,
        graphs,
        metrics,
        steps: end.steps,
        reported,
    })
}

pub(crate) fn read_reported(message: reel::ReportedOutcome) -> Reported {
    Reported {
        success: message.success,
        scores: message.scores.into_iter().map(score).collect(),
    }
}

fn score(message: reel::Score) -> Score {
    Score {
        name: message.name,
        value: message.value,
        label: message.label,
        explanation: message.explanation,
    }
}

pub(crate) fn read_graphs(message: reel::WorldGraphs) -> Read<Graphs> {
    let graph = |graph: Option<reel::WorldGraph>| world_graph(graph.ok_or("a graph is missing")?);
    Ok(Graphs {
        physics: graph(message.physics)?,
        registry: graph(message.registry)?,
    })
}

pub(crate) fn read_tool_call(message: reel::ToolCall) -> Read<(ToolCall, Option<Lookup>)> {
    let lookup = message.lookup.map(|it| Lookup {
        categories: it.categories,
        source: it.source,
    });
    Ok((
        ToolCall {
            name: message.name,
            arguments: json(&message.arguments_json)?,
        },
        lookup,
    ))
}

pub(crate) fn read_policy_output(message: reel::PolicyOutput) -> PolicyOutput {
    PolicyOutput {
        raw: message.raw,
        reasoning: message.reasoning,
        history: message.history,
        plan: message.plan,
        tokens: message.tokens.map(|tokens| [tokens.input, tokens.output]),
        latency_ns: message.latency_ns,
        logprobs: None,
    }
}

pub(crate) fn read_logprobs(message: reel::TokenLogprobs) -> Read<TokenLogprobs> {
    let mut policies = BTreeMap::new();
    for reel::PolicyLogprobs { policy, logprobs } in message.policies {
        if policies.insert(policy.clone(), logprobs).is_some() {
            return Err(format!("policy {policy:?} stands there twice"));
        }
    }
    TokenLogprobs::new(message.tokens, policies).map_err(|error| error.to_string())
}

pub(crate) fn read_reply(message: reel::UserDialogue) -> Read<UserReply> {
    if !message.rules.is_empty() {
        return Err("a reply that was given has rules that it broke".to_owned());
    }
    Ok(UserReply {
        text: message.text,
        source: parse_word(&message.source)?,
    })
}

pub(crate) fn read_refused_reply(message: reel::UserDialogue) -> Read<RefusedReply> {
    match parse_word(&message.source)? {
        UserSource::Model => Ok(RefusedReply {
            text: message.text,
            rules: message.rules,
        }),
        UserSource::RuleBased | UserSource::Human => {
            Err("only replies of a model are refused".to_owned())
        }
    }
}

pub(crate) fn read_outcome(message: &reel::ToolResult) -> Read<Outcome> {
    let code = |text: &String| {
        ErrorCode::parse(text).ok_or_else(|| format!("{text:?} is not an error code"))
    };
    let error = message.error.as_ref().map(code).transpose()?;
    let class = error.map(|code| class_word(code.class()));
    if class != message.error_class.as_deref() {
        return Err(format!(
            "error_class is {:?}, but the error code has {class:?}",
            message.error_class
        ));
    }
    Ok(Outcome {
        text: message.text.clone(),
        error,
    })
}

pub(crate) fn read_markers(markers: Vec<reel::Marker>) -> Read<Vec<Marker>> {
    let marker = |marker: reel::Marker| {
        let target = match marker.target.ok_or("a marker stands for nothing")? {
            Target::Object(id) => MarkerTarget::Object(id.into()),
            Target::Receptacle(id) => MarkerTarget::Receptacle(id.into()),
        };
        Ok(Marker {
            id: marker.id,
            target,
        })
    };
    markers.into_iter().map(marker).collect()
}

pub(crate) fn read_changes(message: reel::WorldDiff) -> Read<GraphChanges> {
    let events =
        |events: Vec<reel::GraphEvent>| events.into_iter().map(graph_event).collect::<Read<_>>();
    Ok(GraphChanges {
        physics: events(message.physics)?,
        registry: events(message.registry)?,
    })
}

pub(crate) fn read_reward(terms: Vec<reel::RewardTerm>) -> Read<Vec<RewardTerm>> {
    let term = |term: reel::RewardTerm| {
        let value = term
            .value
            .ok_or_else(|| format!("the value of term {:?} is missing", term.component))?;
        Ok(RewardTerm {
            component: term.component,
            value,
            reason: term.reason,
        })
    };
    terms.into_iter().map(term).collect()
}

pub(crate) fn read_sim_digest(message: reel::SimDigest) -> Read<DigestMessage> {
    let robot = message.robot.ok_or("robot is missing")?;
    let robot = RobotState {
        base: array(robot.base)?,
        yaw: robot.yaw.ok_or("yaw is missing")?,
        camera: array(robot.camera)?,
        pitch: robot.pitch.ok_or("pitch is missing")?,
        path_length_m: robot.path_length_m.ok_or("path_length_m is missing")?,
    };
    let frame = |frame: reel::FrameDigests| {
        Read::Ok(FrameDigests {
            rgb: digest(&frame.rgb)?,
            ids: digest(&frame.ids)?,
            depth: digest(&frame.depth)?,
        })
    };
    let digests = StateDigests {
        state: digest(&message.state)?,
        frame: message.frame.map(frame).transpose()?,
        physics_steps: message.physics_steps,
    };
    let bodies: Read<Vec<BodyState>> = message.bodies.into_iter().map(body).collect();
    Ok(DigestMessage {
        step: message.step,
        sim_step: message.sim_step,
        bodies: bodies?,
        robot,
        digests,
    })
}

pub(crate) fn read_odometry(message: reel::Odometry) -> Read<Odometry> {
    let reel::Odometry {
        step,
        unix_ns,
        x,
        y,
        yaw,
    } = message;
    let (x, y, yaw) = (
        x.ok_or("x is missing")?,
        y.ok_or("y is missing")?,
        yaw.ok_or("yaw is missing")?,
    );
    Ok(Odometry {
        step,
        unix_ns,
        x,
        y,
        yaw,
    })
}

fn body(body: reel::BodyState) -> Read<BodyState> {
    Ok(BodyState {
        body: body.body,
        position: array(body.position)?,
        rotation: array(body.rotation)?,
        linear_velocity: array(body.linear_velocity)?,
        angular_velocity: array(body.angular_velocity)?,
        asleep: body.asleep,
    })
}

fn world_graph(message: reel::WorldGraph) -> Read<WorldGraph> {
    let mut graph = WorldGraph::default();
    for receptacle in message.receptacles {
        let mut state = ReceptacleState {
            door: receptacle.door.as_deref().map(parse_word).transpose()?,
            ..Default::default()
        };
        for content in receptacle.content {
            if let Some(count) = state.content.insert(content.object.into(), content.count) {
                return Err(format!(
                    "an object of {} stands there twice, first with count {count}",
                    receptacle.receptacle
                ));
            }
        }
        if graph
            .receptacles
            .insert(receptacle.receptacle.as_str().into(), state)
            .is_some()
        {
            return Err(format!(
                "receptacle {} stands there twice",
                receptacle.receptacle
            ));
        }
    }
    Ok(graph)
}

fn graph_event(message: reel::GraphEvent) -> Read<GraphEvent> {
    let receptacle = message.receptacle.into();
    match (
        message.event.as_str(),
        message.object,
        message.from,
        message.to,
    ) {
        ("remove", Some(object), None, None) => Ok(GraphEvent::Remove {
            object: object.into(),
            receptacle,
        }),
        ("add", Some(object), None, None) => Ok(GraphEvent::Add {
            object: object.into(),
            receptacle,
        }),
        ("door", None, Some(from), Some(to)) => Ok(GraphEvent::Door {
            receptacle,
            from: parse_word(&from)?,
            to: parse_word(&to)?,
        }),
        (event, ..) => Err(format!(
            "graph event {event:?} is unknown or has the wrong fields"
        )),
    }
}

fn array<const N: usize>(values: Vec<f32>) -> Read<[f32; N]> {
    let found = values.len();
    values
        .try_into()
        .map_err(|_| format!("a list holds {found} numbers instead of {N}"))
}

pub(crate) fn digest(bytes: &[u8]) -> Read<Digest> {
    let bytes = bytes
        .try_into()
        .map_err(|_| format!("a digest has {} bytes instead of 32", bytes.len()))?;
    Ok(Digest(bytes))
}

fn json(text: &str) -> Read<Value> {
    serde_json::from_str(text).map_err(|error| format!("a field is not JSON ({error})"))
}

fn parse_word<T: DeserializeOwned>(word: &str) -> Read<T> {
    serde_json::from_value(Value::String(word.to_owned()))
        .map_err(|error| format!("{word:?} is not understood ({error})"))
}
