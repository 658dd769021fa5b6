//! The bodies of an episode's scene: what each is to the task, its surfaces, and where it is at every
//! moment. For formats whose viewers draw the scene themselves (glTF, Rerun).

use std::collections::{BTreeMap, BTreeSet};

use reel_sim::{PreparedTask, geometry::Pose, held_pose, render::TriangleSurface, robot_pose};
use reel_trace::Trace;
use reel_world::{
    FrameInstance, InstanceId, InstanceKind, instances,
    record::{BodyState, RobotState},
};

/// A body that frames show.
pub(crate) struct SceneBody {
    /// What it is; a door has the receptacle that it belongs to.
    pub instance: FrameInstance,
    /// Whether it is the door of that receptacle.
    pub is_door: bool,
    /// Whether the goal wants this object elsewhere.
    pub target: bool,
    /// Whether the goal wants something on or in this receptacle.
    pub goal: bool,
    /// Its surfaces in its own frame, in metres.
    pub surfaces: Vec<TriangleSurface>,
    /// Where it is at each of the [`moments`]; none where it never moves and its frame is the scene's.
    pub poses: Option<Vec<Pose>>,
}

impl SceneBody {
    /// Its name among all bodies: an id, or `door:` and the id of the receptacle.
    pub fn name(&self) -> String {
        match self.is_door {
            true => format!("door:{}", self.instance.name),
            false => self.instance.name.clone(),
        }
    }

    /// What kind of thing it is, in a word.
    pub fn kind(&self) -> &'static str {
        match self.instance.kind {
            _ if self.is_door => "door",
            InstanceKind::Shell => "shell",
            InstanceKind::Receptacle => "receptacle",
            InstanceKind::Object => "object",
            InstanceKind::Robot => "robot",
        }
    }
}

/// Every body of the episode's scene, in the order of the simulator.
pub(crate) fn scene_bodies(trace: &Trace, moments: &[Moment<'_>]) -> Vec<SceneBody> {
    let stage = PreparedTask::with_meshes(
        trace.scene.clone(),
        trace.task.clone(),
        trace.meshes.clone(),
    );
    let known = instances(&trace.task, &trace.scene);
    let named: BTreeMap<u16, &FrameInstance> = known.iter().map(|it| (it.id, it)).collect();
    let wanted: BTreeSet<&InstanceId> = trace.task.goal_objects().map(|it| &it.instance).collect();
    let goals: BTreeSet<String> = (trace.task.goal_objects())
        .filter_map(|it| trace.task.goal.receptacle_of(&it.instance))
        .map(ToString::to_string)
        .collect();
    let bodies = stage.drawn_bodies().into_iter();
    let bodies = bodies.filter_map(|drawn| {
        let instance = (*named.get(&drawn.instance)?).clone();
        let (kind, is_door) = (instance.kind, drawn.is_door);
        let mut body = SceneBody {
            target: kind == InstanceKind::Object
                && wanted.contains(&InstanceId::from(&*instance.name)),
            goal: kind == InstanceKind::Receptacle && goals.contains(&instance.name),
            instance,
            is_door,
            surfaces: drawn.surfaces,
            poses: None,
        };
        let name = body.name();
        body.poses = match (kind, is_door) {
            (InstanceKind::Robot, _) => {
                Some(moments.iter().map(|it| robot_pose(it.robot)).collect())
            }
            (InstanceKind::Object, _) | (_, true) => {
                Some(moments.iter().map(|it| it.pose(&name)).collect())
            }
            _ => None,
        };
        Some(body)
    });
    bodies.collect()
}

/// Where everything is at a moment.
pub(crate) struct Moment<'a> {
    pub robot: &'a RobotState,
    bodies: BTreeMap<&'a str, &'a BodyState>,
}

impl<'a> Moment<'a> {
    fn new(robot: &'a RobotState, bodies: &'a [BodyState]) -> Self {
        let bodies = bodies.iter().map(|it| (it.body.as_str(), it)).collect();
        Self { robot, bodies }
    }

    /// What is in no record is held.
    fn pose(&self, body: &str) -> Pose {
        match self.bodies.get(body) {
            Some(state) => Pose {
                position: state.position,
                rotation: state.rotation,
            },
            None => held_pose(self.robot),
        }
    }
}

/// The start, and the end of every step.
pub(crate) fn moments(trace: &Trace) -> Vec<Moment<'_>> {
    let start = Moment::new(&trace.start.robot, &trace.start.bodies);
    let steps = trace.steps.iter();
    let ends = steps.map(|step| Moment::new(&step.robot, &step.bodies));
    std::iter::once(start).chain(ends).collect()
}
