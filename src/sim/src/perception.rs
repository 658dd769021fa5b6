//! What the published servers' tools ask of geometry and camera: where to stand, what is in view,
//! how marks are drawn. The stage holds one [`Perception`]; a test puts tables in its place, so
//! that it compares the tools and not the renderer.

use std::fmt;

use reel_world::{Frame, record::MarkerTarget};

use crate::{
    nav::Viewpoint,
    render::{OverlayMark, overlay_tinted},
    simulator::{Simulator, furniture_entity},
};

/// Something in the current image.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Segment {
    /// The object or receptacle that the segment shows.
    pub target: MarkerTarget,
    /// How many pixels of it are seen; 0 if the segmentation lists it all the same.
    pub pixels: u32,
}

/// Geometry and camera as the tools see them.
pub trait Perception: fmt::Debug + Send + Sync {
    /// Where the robot stands to look at a piece of furniture (an index into the model), `None` if
    /// every place is blocked.
    fn viewpoint(&self, simulator: &Simulator, furniture: usize) -> Option<Viewpoint>;

    /// Where the robot stands to look at an object (an index into the task) closely, `None` if
    /// there is no such place.
    fn close_up(&self, simulator: &Simulator, object: usize) -> Option<Viewpoint>;

    /// What is in the last image, in ascending instance id.
    fn segments(&self, simulator: &Simulator) -> Vec<Segment>;

    /// The category among those of all objects that a query means, where nobody outside said so.
    fn nearest_category(&self, query: &str, categories: &[&str]) -> Option<String>;

    /// Draws marks into an image; `opacity` is that of the tint, from 0 to 1.
    fn mark(&self, frame: &mut Frame, marks: &[OverlayMark], opacity: f32);
}

/// The simulator's own navigation map, renderer and vocabulary.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SimulatorPerception;

impl Perception for SimulatorPerception {
    fn viewpoint(&self, simulator: &Simulator, furniture: usize) -> Option<Viewpoint> {
        simulator
            .nav()
            .viewpoint(simulator.model(), simulator.robot.base, furniture)
    }

    fn close_up(&self, simulator: &Simulator, object: usize) -> Option<Viewpoint> {
        let position = simulator.physics.object_motion(object)?.pose.position;
        simulator.nav().approach(
            simulator.robot.base,
            position,
            simulator.support_of(object).flatten(),
        )
    }

    fn segments(&self, simulator: &Simulator) -> Vec<Segment> {
        let sights = simulator.sights();
        let pixels = |entity: u16| {
            sights
                .get(usize::from(entity))
                .copied()
                .flatten()
                .map(|sight| sight.pixels)
        };
        let furniture = simulator
            .model()
            .furniture
            .iter()
            .enumerate()
            .map(|(index, furniture)| {
                (
                    MarkerTarget::Receptacle(furniture.id.clone()),
                    pixels(furniture_entity(index)),
                )
            });
        let objects = simulator
            .task()
            .objects
            .iter()
            .enumerate()
            .map(|(index, object)| {
                (
                    MarkerTarget::Object(object.instance.clone()),
                    pixels(simulator.object_entity(index)),
                )
            });
        furniture
            .chain(objects)
            .filter_map(|(target, pixels)| {
                Some(Segment {
                    target,
                    pixels: pixels?,
                })
            })
            .collect()
    }

    fn nearest_category(&self, query: &str, categories: &[&str]) -> Option<String> {
        let categories = categories.iter().copied().collect();
        reel_world::language::match_category(query, &categories)
            .categories
            .into_iter()
            .next()
    }

    fn mark(&self, frame: &mut Frame, marks: &[OverlayMark], opacity: f32) {
        overlay_tinted(frame, marks, (opacity * 255.0) as u16);
    }
}
