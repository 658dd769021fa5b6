//! The physics filter: every object is spawned above its place and has to come to rest there
//! (paper, Two-Stage Task Filtering; docs/spec.md#task-filters). The simulator does what it
//! does at the start of every episode; here is only what must come of it, and whether the robot
//! can get near then.

use std::sync::Arc;

use reel_sim::{PreparedTask, Simulator, physics::SPAWN_OFFSET_M};
use reel_world::{ObjectInstance, Profile, Scene, Task};
use serde::Serialize;

/// An object may end so far below where it was spawned, in metres.
pub const FALL_MAX_M: f64 = 0.3;
/// No object may end farther from the origin along an axis, in metres.
pub const FARTHEST_M: f64 = 50.0;

/// Why a task fails in physics.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SettleError {
    /// An object fell by more than [`FALL_MAX_M`].
    Fell,
    /// An object flew out of the scene, or its state is not finite.
    FlewAway,
    /// An object rests elsewhere than the graph says.
    Displaced,
}

impl SettleError {
    /// The reason as a phrase for reports, e.g. `an object flew away`.
    pub fn as_str(self) -> &'static str {
        match self {
            SettleError::Fell => "an object fell by more than 0.3 m",
            SettleError::FlewAway => "an object flew away",
            SettleError::Displaced => "an object rests elsewhere than the graph says",
        }
    }
}

/// Spawns the task's objects 0.1 m above their places and runs 500 steps of 1/240 s.
pub fn spawn(scene: &Arc<Scene>, task: &Arc<Task>) -> Simulator {
    Simulator::new(
        PreparedTask::new(scene.clone(), task.clone()),
        Profile::Paper,
        0,
    )
}

/// The final rest positions, in the order of the objects, if every object came to
/// rest on its receptacle.
pub fn settle(spawned: &Simulator) -> Result<Vec<[f64; 3]>, SettleError> {
    let bodies = spawned.bodies();
    let rest = |(index, object): (usize, &ObjectInstance)| {
        let body = &bodies[index];
        assert_eq!(
            body.body,
            object.instance.as_str(),
            "objects come first, in the order of the task"
        );
        let position = body.position.map(f64::from);
        if spawned.fault() || !position.iter().all(|value| value.abs() <= FARTHEST_M) {
            return Err(SettleError::FlewAway);
        }
        if position[2] < object.position[2] + f64::from(SPAWN_OFFSET_M) - FALL_MAX_M {
            return Err(SettleError::Fell);
        }
        let place = spawned
            .support_of(index)
            .flatten()
            .map(|furniture| &spawned.model().furniture[furniture].id);
        if place == Some(&object.receptacle) {
            Ok(position)
        } else {
            Err(SettleError::Displaced)
        }
    };
    spawned
        .task()
        .objects
        .iter()
        .enumerate()
        .map(rest)
        .collect()
}

/// Whether the robot finds somewhere to stand from which each object that shall move is near
/// enough and in sight.
///
/// The static filter knows no robot: beside a bed there may be room for the 5 cm that it asks for,
/// and none for a base.
pub fn can_be_approached(spawned: &Simulator) -> bool {
    let (task, nav, bodies) = (spawned.task(), spawned.nav(), spawned.bodies());
    task.objects
        .iter()
        .enumerate()
        .filter(|(_, object)| task.moves(object))
        .all(|(index, _)| {
            let [x, y, z] = bodies[index].position;
            let place = spawned.support_of(index).flatten();
            let [out_x, out_y] = place.map_or([0.0; 2], |furniture| {
                spawned.model().furniture[furniture].open_shift()
            });
            let target = [x + out_x, y + out_y, z];
            let in_part = place
                .is_some_and(|furniture| spawned.model().furniture[furniture].part_of.is_some());
            let approach = nav.approach(spawned.robot().base, target, place);
            // What lies deep in a low shelf is within reach of places that do not see it.
            approach.is_some_and(|viewpoint| {
                !in_part || nav.line_of_sight(viewpoint.camera.position, target, None)
            })
        })
}
