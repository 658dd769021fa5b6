//! What an object looks like by itself, on a plain board.

use crate::library::LibraryObject;
use reel_sim::{
    geometry::{Camera, Part, Pattern, Pose, Shape},
    model::object_model,
    render::{Detail, Drawable, render},
};
use reel_world::Frame;

const BOARD: [u8; 3] = [214, 206, 190];

/// An image of an object from above and before it, so near that it fills most of the image.
pub fn object_thumbnail(object: &LibraryObject) -> Frame {
    let instance = object.instance_at(&"board".into(), "picture", [0.0; 3]);
    let model = object_model(&instance);
    let half = Shape::Cuboid {
        half: [2.0, 2.0, 0.05],
    };
    let board = Part {
        shape: half,
        pose: Pose::at([0.0, 0.0, -0.05]),
        color: BOARD,
        accent: BOARD,
        pattern: Pattern::Plain,
        solid: true,
    };
    let drawables = [
        Drawable {
            parts: &[board],
            pose: Pose::IDENTITY,
            mesh: None,
            entity: 1,
        },
        Drawable {
            parts: &model.parts,
            pose: Pose::at([0.0, 0.0, model.half[2]]),
            mesh: None,
            entity: 2,
        },
    ];
    let largest = model.half.into_iter().fold(0.0_f32, f32::max);
    let away = 0.08 + largest * 3.4;
    let eye = [away * 0.45, -away * 0.8, model.half[2] + away * 0.62];
    render(
        &Camera::looking_at(eye, [0.0, 0.0, model.half[2]]),
        &drawables,
        Detail::Full,
    )
}
