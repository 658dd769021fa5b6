//! Images of a scene without a task: each receptacle as the robot sees it from its
//! viewpoint. Never moves anything.

use reel_sim::{
    geometry::Pose,
    nav::Viewpoint,
    render::{Detail, Drawable, render},
};
use reel_world::{Frame, ReceptacleId, Scene};

use super::check::viewpoints;

/// What the robot sees of a receptacle.
#[derive(Clone, PartialEq, Debug)]
pub struct View {
    /// Id of the receptacle that the view shows.
    pub receptacle: ReceptacleId,
    /// The image; none where it has no viewpoint.
    pub frame: Option<Frame>,
}

/// Every receptacle from its viewpoint, its own door open, in the scene's order.
pub fn receptacle_views(scene: &Scene) -> Vec<View> {
    let (model, viewpoints) = viewpoints(scene);
    let frame = |index: usize, viewpoint: Viewpoint| {
        let mut drawables = vec![Drawable {
            parts: &model.shell,
            pose: Pose::IDENTITY,
            mesh: None,
            entity: 1,
        }];
        for (other, piece) in model.furniture.iter().enumerate() {
            drawables.push(Drawable {
                parts: &piece.parts,
                pose: Pose::IDENTITY,
                mesh: None,
                entity: 1,
            });
            if let Some(door) = &piece.door {
                let pose = door.opened(if other == index { 1.0 } else { 0.0 });
                drawables.push(Drawable {
                    parts: &door.parts,
                    pose,
                    mesh: None,
                    entity: 1,
                });
            }
        }
        render(&viewpoint.camera, &drawables, Detail::Full)
    };
    let pieces = model.furniture.iter().zip(viewpoints).enumerate();
    pieces
        .map(|(index, (piece, viewpoint))| View {
            receptacle: piece.id.clone(),
            frame: viewpoint.map(|viewpoint| frame(index, viewpoint)),
        })
        .collect()
}
