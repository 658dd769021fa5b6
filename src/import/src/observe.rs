//! What can be seen of a world that somebody else simulates, or that is real: the state that
//! results show, and the record of a step that follows from the states around it. Knows
//! neither files nor protocols.

use std::collections::BTreeMap;

use reel_world::{
    Digest, ErrorCode, FrameDigests, InstanceId, Outcome, Profile, ReceptacleId, Scene, Skills,
    Task, Tool, WorldGraph,
    record::{
        Backend, EpisodeHeader, GraphChanges, Graphs, Marker, MarkerTarget, PolicyInfo, RobotState,
        StateDigests, StepInput, StepRecord, UserReply,
    },
};
use serde_json::{Map, Value};

use crate::graph;

/// What is known of the world after a step.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct ObservedState {
    /// Where everything is; none where nothing shows it.
    pub graph: Option<WorldGraph>,
    /// What the gripper holds.
    pub held: Option<InstanceId>,
    /// The marker map: numbers and what they stand for.
    pub markers: Option<Vec<(u32, String)>>,
    /// Where the robot stands.
    pub landmark: Option<ReceptacleId>,
    /// Of the camera, in metres; a height that is not told is 0.
    pub position: Option<[f32; 3]>,
}

/// The header of an episode that somebody else played: no seed, no simulator, no name yet. Who
/// played it and in which run is for the caller to say.
pub fn header(task: &Task, scene: &Scene) -> EpisodeHeader {
    EpisodeHeader {
        episode_id: String::new(),
        run_id: String::new(),
        group_id: None,
        rollout_index: None,
        task_id: task.task_id.clone(),
        family: task.family,
        scene_id: scene.scene_id.clone(),
        task_digest: Digest::of_json(task),
        scene_digest: Digest::of_json(scene),
        seed: 0,
        sim_version: 0,
        build: String::new(),
        profile: Profile::RealRepo,
        reward_preset: String::new(),
        policy: PolicyInfo::default(),
        backend: Backend::Proxy,
        skills: Skills::Perfect,
        meshes: std::collections::BTreeMap::new(),
        parent: None,
    }
}

/// What a call came to.
#[derive(Clone, PartialEq, Debug)]
pub struct CallObservation {
    /// The call that the policy made, as the input of a step.
    pub input: StepInput,
    /// The tool that the call means; `None` if it is none of ours.
    pub tool: Option<Tool>,
    /// What the policy got.
    pub outcome: Outcome,
    /// What the user answered.
    pub reply: Option<UserReply>,
    /// Of the image, where there was one.
    pub frame: Option<FrameDigests>,
}

impl ObservedState {
    /// The state after a result with this debug payload. A graph that it does not
    /// show is as before.
    pub fn after(&self, debug_info: &Map<String, Value>) -> ObservedState {
        let mut state = self.clone();
        state.update(debug_info);
        state.graph = graph::of_debug_info(debug_info, self.graph.as_ref()).or(state.graph);
        state
    }

    /// Takes in a debug payload, but for its graph; what it does not name stays.
    pub(crate) fn update(&mut self, debug_info: &Map<String, Value>) {
        let name = |value: &Value| {
            value
                .as_str()
                .filter(|name| !name.is_empty())
                .map(str::to_owned)
        };
        if let Some(value) = debug_info.get("CURRENT_INV") {
            self.held = name(value).map(Into::into);
        }
        if let Some(value) = debug_info.get("CURRENT_LANDMARK") {
            self.landmark = name(value).map(Into::into);
        }
        if let Some(value) = debug_info.get("CURRENT_POS") {
            self.position = position(value);
        }
        if let Some(value) = debug_info.get("CURRENT_MARKER_MAP") {
            self.markers = value.as_object().map(|map| {
                let number = |(key, target): (&String, &Value)| {
                    Some((key.trim().parse().ok()?, name(target)?))
                };
                map.iter()
                    .filter_map(number)
                    .collect::<BTreeMap<u32, String>>()
                    .into_iter()
                    .collect()
            });
        }
    }

    /// The robot, as far as it is known.
    pub fn robot(&self) -> RobotState {
        let [x, y, z] = self.position.unwrap_or_default();
        RobotState {
            base: [x, y],
            camera: [x, y, z],
            ..RobotState::default()
        }
    }

    /// What the markers stand for: a name of the graph is a receptacle.
    pub(crate) fn markers(&self) -> Vec<Marker> {
        let receptacles = self.graph.as_ref().map(|graph| &graph.receptacles);
        let target = |name: &str| match receptacles {
            Some(receptacles) if receptacles.contains_key(name) => {
                MarkerTarget::Receptacle(name.into())
            }
            _ => MarkerTarget::Object(name.into()),
        };
        self.markers
            .iter()
            .flatten()
            .map(|(id, name)| Marker {
                id: *id,
                target: target(name),
            })
            .collect()
    }
}

/// The record of a step, without its rewards. `before` and `after` know
/// their graphs, where anything shows them.
pub fn record(
    step: u32,
    shown: CallObservation,
    before: &ObservedState,
    after: &ObservedState,
) -> StepRecord {
    let CallObservation {
        input,
        tool,
        outcome,
        reply,
        frame,
    } = shown;
    // What the server does not have is no tool, e.g. `ask` at the training server.
    let tool = tool.filter(|_| outcome.error != Some(ErrorCode::UnknownTool));
    let (object, receptacle) = acted_on(tool.as_ref(), &outcome, before, after);
    let changed = match (&before.graph, &after.graph) {
        (Some(before), Some(after)) => after.difference(before),
        _ => Vec::new(),
    };
    let markers = after.markers();
    let told = matches!(
        tool,
        Some(Tool::WalkAround | Tool::ShowObjectByCategory { .. } | Tool::GazeAt { .. })
    ) && outcome.is_ok();
    let listed = markers
        .iter()
        .filter(|_| told)
        .filter_map(|marker| match &marker.target {
            MarkerTarget::Object(object) => Some(object.clone()),
            MarkerTarget::Receptacle(_) => None,
        });
    StepRecord {
        step,
        listed: listed.collect(),
        input,
        outcome,
        tool: tool.as_ref().map(|tool| tool.paper_name().to_owned()),
        reply,
        markers,
        visible: Vec::new(),
        object,
        receptacle,
        held: after.held.clone(),
        changes: GraphChanges {
            physics: changed.clone(),
            registry: changed,
        },
        bodies: Vec::new(),
        robot: after.robot(),
        sim_step: 0,
        reward: Vec::new(),
        digests: StateDigests {
            frame,
            ..StateDigests::default()
        },
    }
}

/// The object and the receptacle that a successful call acted on.
fn acted_on(
    tool: Option<&Tool>,
    outcome: &Outcome,
    before: &ObservedState,
    after: &ObservedState,
) -> (Option<InstanceId>, Option<ReceptacleId>) {
    let Some(tool) = tool.filter(|_| outcome.is_ok()) else {
        return (None, None);
    };
    let marked = |number: u32| {
        before
            .markers()
            .into_iter()
            .find(|marker| marker.id == number)
            .map(|marker| marker.target)
    };
    let object = |number: u32| match marked(number) {
        Some(MarkerTarget::Object(object)) => Some(object),
        _ => None,
    };
    let receptacle = |number: u32| match marked(number) {
        Some(MarkerTarget::Receptacle(receptacle)) => Some(receptacle),
        _ => None,
    };
    match tool {
        Tool::NavTo { receptacle } => (None, Some(receptacle.clone())),
        Tool::WalkAround => (None, after.landmark.clone()),
        Tool::GazeAt { marker } => (object(*marker), receptacle(*marker)),
        Tool::Pick { marker } => {
            let object = object(*marker).or_else(|| after.held.clone());
            let place = object
                .as_ref()
                .and_then(|object| before.graph.as_ref()?.receptacle_of(object).cloned());
            (object, place)
        }
        Tool::Place { marker } => (before.held.clone(), receptacle(*marker)),
        Tool::Open { marker } | Tool::Close { marker } => (None, receptacle(*marker)),
        _ => (None, None),
    }
}

/// Two or three numbers, which some versions of the server wrote as texts.
fn position(value: &Value) -> Option<[f32; 3]> {
    let number = |value: &Value| {
        value
            .as_f64()
            .or_else(|| value.as_str()?.trim().parse().ok())
    };
    let numbers: Vec<f32> = value
        .as_array()?
        .iter()
        .filter_map(number)
        .map(|number| number as f32)
        .collect();
    let position = match numbers[..] {
        [x, y] => [x, y, 0.0],
        [x, y, z] => [x, y, z],
        _ => return None,
    };
    position
        .iter()
        .all(|number| number.is_finite())
        .then_some(position)
}

/// One graph for both authorities: who stands by knows of one alone.
pub fn same_graph_for_both(graph: &WorldGraph) -> Graphs {
    Graphs {
        physics: graph.clone(),
        registry: graph.clone(),
    }
}
