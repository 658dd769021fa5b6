//! Pictures of a scene without a task: each receptacle as the robot sees it from its viewpoint. Never moves anything.

use reel_sim::{
    geometry::{Part, Pose},
    render::{Detail, Drawable, render},
};
use reel_world::{Frame, ReceptacleId, Scene};

use super::check::viewpoints;

/// What the robot sees of a receptacle.
#[derive(Clone, PartialEq, Debug)]
pub struct View {
    /// Which.
    pub receptacle: ReceptacleId,
    /// The picture; none where it has no viewpoint.
    pub frame: Option<Frame>,
}

/// Every receptacle from its viewpoint, doors open, in the scene's order.
pub fn views(scene: &Scene) -> Vec<View> {
    let (model, viewpoints) = viewpoints(scene);
    let mut drawables = vec![Drawable { parts: &model.shell, pose: Pose::IDENTITY, entity: 1 }];
    for piece in &model.furniture {
        drawables.push(Drawable { parts: &piece.parts, pose: Pose::IDENTITY, entity: 1 });
        if let Some(door) = &piece.door {
            let parts: &[Part] = &door.parts;
            let pose = door.closed.then(&Pose::yawed([0.0; 3], door.open_angle));
            drawables.push(Drawable { parts, pose, entity: 1 });
        }
    }
    let ids = model.furniture.iter().map(|piece| piece.id.clone());
    let frame = |viewpoint: reel_sim::nav::Viewpoint| render(&viewpoint.camera, &drawables, Detail::Picture);
    ids.zip(viewpoints).map(|(receptacle, viewpoint)| View { receptacle, frame: viewpoint.map(frame) }).collect()
}
