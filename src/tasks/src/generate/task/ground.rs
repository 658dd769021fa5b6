//! A scene made ready for placing: which receptacles tasks may use, what they are called, and where
//! on and around them something fixed is in the way. Made once a scene; never changes.

use std::{collections::BTreeSet, sync::Arc};

use crate::library::LibraryObject;
use reel_sim::{
    model::{SceneModel, scene_model},
    nav::Occupancy,
};
use reel_world::{Receptacle, Rect, Scene};

use super::{compatibility::Compatibility, describe, grid::REACH_RADIUS_M};

/// So near to a surface, or to a ceiling above it, these themselves do not count
/// as obstacles, in metres.
const ABOVE_SURFACE_M: f32 = 0.01;
/// What stands higher above a surface is in nothing's way, in metres.
const TALLEST_M: f32 = 0.4;

/// Room above an object when it is spawned over its place, in metres: the gap of the task files
/// and the spawn offset.
const HEADROOM_M: f64 = 0.13;
/// The same on a shelf and in a drawer, where it is spawned as low as need be.
const HEADROOM_IN_PART_M: f64 = 0.04;

/// Lattice on which free floor is counted, in metres.
const FLOOR_STEP_M: f64 = 0.05;

/// A scene and its sites.
#[derive(Debug)]
pub struct SceneSites {
    /// The scene that the sites belong to.
    pub scene: Arc<Scene>,
    /// The receptacles that tasks may use, in the scene's order.
    pub sites: Vec<Site>,
}

/// A receptacle that tasks may use.
#[derive(Debug)]
pub struct Site {
    /// The receptacle of the scene that this site describes.
    pub receptacle: Receptacle,
    /// What it is called, so that no other receptacle of the scene is meant.
    pub captions: Vec<String>,
    /// The receptacles of the scene that are like it, by index of the site.
    pub alike: Vec<usize>,
    /// Free height above the surface, in metres.
    pub clearance_m: f64,
    /// The side a hand comes from, where a door or the furniture around it leaves only one.
    pub front: Option<Side>,
    /// Free height that an object needs when it is spawned here, besides its own, in metres.
    pub headroom_m: f64,
    /// What the furniture takes of the floor.
    body: Rect,
    /// What stands above the surface, its own parts included.
    above: Occupancy,
    /// What stands on the floor, but for itself.
    around: Occupancy,
}

/// A side of a surface.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Side {
    /// 0 is x, 1 is y.
    pub axis: usize,
    /// Whether it is the one of the larger coordinate.
    pub upper: bool,
}

impl Side {
    /// All four sides: lower and upper of x, then of y.
    pub const ALL: [Side; 4] = [
        Side {
            axis: 0,
            upper: false,
        },
        Side {
            axis: 0,
            upper: true,
        },
        Side {
            axis: 1,
            upper: false,
        },
        Side {
            axis: 1,
            upper: true,
        },
    ];

    /// How far a point in a rectangle is from this side.
    pub fn distance(self, rect: &Rect, point: [f64; 2]) -> f64 {
        let Side { axis, upper } = self;
        if upper {
            rect.max[axis] - point[axis]
        } else {
            point[axis] - rect.min[axis]
        }
    }

    /// The point of this side nearest to a point in the rectangle.
    pub fn nearest(self, rect: &Rect, mut point: [f64; 2]) -> [f64; 2] {
        point[self.axis] = if self.upper {
            rect.max[self.axis]
        } else {
            rect.min[self.axis]
        };
        point
    }

    fn facing([x, y]: [f32; 2]) -> Self {
        if x.abs() > y.abs() {
            Side {
                axis: 0,
                upper: x > 0.0,
            }
        } else {
            Side {
                axis: 1,
                upper: y > 0.0,
            }
        }
    }
}

impl SceneSites {
    /// Surveys a scene. Lids, and what they cover, are no sites, nor is what cannot be named.
    pub fn survey(scene: Arc<Scene>) -> Self {
        let model = scene_model(&scene, &BTreeSet::new());
        let mut sites: Vec<Site> = scene
            .receptacles
            .iter()
            .enumerate()
            .filter(|(_, receptacle)| scene.is_usable(receptacle))
            .map(|(index, receptacle)| Site::survey(&scene, &model, index, receptacle))
            .filter(|site| !site.captions.is_empty())
            .collect();
        for index in 0..sites.len() {
            let category = &sites[index].receptacle.category;
            let alike = (0..sites.len())
                .filter(|other| *other != index && sites[*other].receptacle.category == *category);
            sites[index].alike = alike.collect();
        }
        Self { scene, sites }
    }

    /// The pairs of sites between which at least one object plausibly moves: source,
    /// destination, objects by index.
    pub fn triplets(
        &self,
        library: &[LibraryObject],
        table: &Compatibility,
    ) -> Vec<(usize, usize, Vec<usize>)> {
        let holds: Vec<Vec<bool>> = self
            .sites
            .iter()
            .map(|site| {
                library
                    .iter()
                    .map(|object| table.holds(&site.receptacle, object))
                    .collect()
            })
            .collect();
        let pairs = (0..self.sites.len())
            .flat_map(|src| (0..self.sites.len()).map(move |dest| (src, dest)));
        let with_objects = pairs.filter(|(src, dest)| src != dest).map(|(src, dest)| {
            let objects =
                (0..library.len()).filter(|object| holds[src][*object] && holds[dest][*object]);
            (src, dest, objects.collect::<Vec<_>>())
        });
        with_objects
            .filter(|(_, _, objects)| !objects.is_empty())
            .collect()
    }
}

impl Site {
    fn survey(scene: &Scene, model: &SceneModel, index: usize, receptacle: &Receptacle) -> Self {
        let furniture = &model.furniture[index];
        let surface = receptacle.surface_height() as f32;
        let clearance = furniture.surface.clearance;
        let part_of = receptacle.part_of.as_ref();
        let part_of = part_of.and_then(|whole| scene.receptacle(whole));
        Self {
            captions: describe::receptacle(receptacle, scene),
            receptacle: receptacle.clone(),
            alike: Vec::new(),
            clearance_m: f64::from(clearance),
            front: (receptacle.door.exists() || part_of.is_some())
                .then(|| Side::facing(furniture.facing)),
            headroom_m: if part_of.is_some() {
                HEADROOM_IN_PART_M
            } else {
                HEADROOM_M
            },
            body: part_of.unwrap_or(receptacle).surface_rect(),
            above: Occupancy::between(
                model,
                [
                    surface + ABOVE_SURFACE_M,
                    surface + (clearance - ABOVE_SURFACE_M).min(TALLEST_M),
                ],
                None,
            ),
            around: Occupancy::on_floor(model, index),
        }
    }

    /// The surface from above.
    pub fn surface(&self) -> Rect {
        self.receptacle.surface_rect()
    }

    /// Whether nothing fixed stands in a disc on the surface.
    pub fn is_free_above(&self, center: [f64; 2], radius: f64) -> bool {
        self.above
            .disc_is_free(center.map(|value| value as f32), radius as f32)
    }

    /// How many points of a lattice of 5 cm around a place, within [`REACH_RADIUS_M`] of
    /// it, are free floor.
    pub fn free_floor_near(&self, [x, y]: [f64; 2]) -> usize {
        let steps = (REACH_RADIUS_M / FLOOR_STEP_M).round() as i32;
        let offsets =
            (-steps..=steps).flat_map(|across| (-steps..=steps).map(move |along| (across, along)));
        let near =
            offsets.filter(|(across, along)| across * across + along * along <= steps * steps);
        let point = |(across, along): (i32, i32)| {
            [
                x + f64::from(across) * FLOOR_STEP_M,
                y + f64::from(along) * FLOOR_STEP_M,
            ]
        };
        near.map(point)
            .filter(|point| !self.body.contains(*point) && self.is_free_around(*point, 0.0))
            .count()
    }

    /// Whether nothing but the receptacle itself stands in a disc on the floor.
    pub fn is_free_around(&self, center: [f64; 2], radius: f64) -> bool {
        self.around
            .disc_is_free(center.map(|value| value as f32), radius as f32)
    }
}
