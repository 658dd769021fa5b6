//! What is wrong with a scene: furniture that overlaps, that cannot be reached or seen, doors
//! that hit something, narrow passages, captions that mislead. Asks the simulator's own models
//! and map; never mends anything.

use std::collections::BTreeSet;

use reel_sim::{
    geometry::Shape,
    model::{DoorModel, DoorMotion, SceneModel, scene_model},
    nav::{CELL_M, NavMap},
};
use reel_world::{Receptacle, Scene};
use serde::Serialize;

/// Least width of a passage, in metres.
pub const PASSAGE_M: f32 = 0.9;
/// Bodies that share less than this only touch, in metres.
const TOUCH_M: f32 = 0.01;
/// How far from a receptacle the robot may stand, in metres: where it looks for viewpoints.
const NEAR_M: f32 = 2.0;
/// Of five points of a surface so many are to be seen.
const SEEN_LEAST: usize = 4;
/// The same for a shelf, a drawer or a compartment, the back of which nobody sees from above.
const SEEN_LEAST_IN_PART: usize = 3;
/// Steps of a door from closed to open.
const SWING_STEPS: usize = 18;
/// Half the thickness of a wall, in metres.
const HALF_WALL_M: f32 = 0.05;

/// A sort of fault.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneFault {
    /// Two bodies, or a body and a wall, are in the same place.
    Overlap,
    /// A body is not within its room.
    OutOfRoom,
    /// A door hits something while it opens.
    Door,
    /// The robot cannot get there.
    Unreachable,
    /// The robot can get there, but from nowhere sees the surface.
    NoSight,
    /// The way there is narrower than [`PASSAGE_M`].
    Narrow,
    /// No caption, one that others have too, or one that the looks contradict.
    Caption,
}

/// Something that is wrong, where and how.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Finding {
    /// What sort of thing.
    pub fault: SceneFault,
    /// The receptacle or room.
    pub at: String,
    /// Where on the floor, in metres.
    pub place: [f64; 2],
    /// What is wrong, in a sentence for people.
    pub message: String,
}

/// Everything that is wrong with a scene, in the order of its furniture.
pub fn check(scene: &Scene) -> Vec<Finding> {
    Check::new(scene).run()
}

/// A rectangle on the floor with heights: lower and upper corner.
type Block = [[f32; 3]; 2];

struct Check<'a> {
    scene: &'a Scene,
    model: SceneModel,
    map: NavMap,
    walls: Vec<Block>,
    start: [f32; 2],
    findings: Vec<Finding>,
}

impl<'a> Check<'a> {
    fn new(scene: &'a Scene) -> Self {
        let model = scene_model(scene, &BTreeSet::new());
        let map = NavMap::new(&model);
        let walls = model.walls.iter().map(|wall| {
            let along = usize::from(wall.from[0] == wall.to[0]);
            let low = [0, 1].map(|axis| {
                wall.from[axis].min(wall.to[axis]) as f32
                    - if axis == along { 0.0 } else { HALF_WALL_M }
            });
            let high = [0, 1].map(|axis| {
                wall.from[axis].max(wall.to[axis]) as f32
                    + if axis == along { 0.0 } else { HALF_WALL_M }
            });
            [
                [low[0], low[1], 0.0],
                [high[0], high[1], wall.height as f32],
            ]
        });
        let walls = walls.collect();
        let middle = [0, 1].map(|axis| (model.bounds[0][axis] + model.bounds[1][axis]) * 0.5);
        let wanted = scene
            .robot_start
            .map_or(middle, |[x, y, _]| [x as f32, y as f32]);
        let start = map.free_near(wanted).unwrap_or(wanted);
        Self {
            scene,
            model,
            map,
            walls,
            start,
            findings: Vec::new(),
        }
    }

    fn run(mut self) -> Vec<Finding> {
        self.bodies();
        self.doors();
        self.ways();
        self.captions();
        self.findings
    }

    fn find(&mut self, fault: SceneFault, at: impl ToString, place: [f32; 2], what: String) {
        let place = place.map(|value| (f64::from(value) * 100.0).round() / 100.0);
        self.findings.push(Finding {
            fault,
            at: at.to_string(),
            place,
            message: what,
        });
    }

    fn bodies(&mut self) {
        for index in 0..self.model.furniture.len() {
            let (piece, receptacle) =
                (&self.model.furniture[index], &self.scene.receptacles[index]);
            let (id, bounds) = (receptacle.id.clone(), piece.bounds);
            let others = self.model.furniture[..index]
                .iter()
                .zip(&self.scene.receptacles);
            let overlaps: Vec<_> = others
                .enumerate()
                .filter(|(other, _)| !self.same_piece(*other, index))
                .map(|(_, other)| other)
                .filter(|(_, other)| {
                    receptacle.covers != Some(other.id.clone()) && other.covers != Some(id.clone())
                })
                .map(|(other, of)| (of.id.to_string(), other.bounds))
                .chain(self.walls.iter().map(|wall| ("a wall".to_owned(), *wall)))
                .filter_map(|(name, other)| Some((name, shared(&bounds, &other)?)))
                .collect();
            let room = self
                .scene
                .rooms
                .iter()
                .find(|room| room.name == receptacle.room);
            let rects = room.map(|room| room.footprint()).unwrap_or_default();
            let corners =
                [0, 1, 2, 3].map(|corner| [bounds[corner & 1][0], bounds[corner >> 1][1]]);
            let outside = corners.into_iter().find(|corner| {
                let near = corner.map(f64::from);
                !rects.iter().any(|rect| {
                    (0..2).all(|axis| {
                        rect.min[axis] - 0.005 <= near[axis] && near[axis] <= rect.max[axis] + 0.005
                    })
                })
            });
            for (name, place) in overlaps {
                self.find(SceneFault::Overlap, &id, place, format!("stands in {name}"));
            }
            if let Some(place) = outside {
                self.find(
                    SceneFault::OutOfRoom,
                    &id,
                    place,
                    format!("reaches out of its room {}", receptacle.room),
                );
            }
        }
    }

    /// Whether two receptacles belong to one piece of furniture.
    fn same_piece(&self, a: usize, b: usize) -> bool {
        let whole = |index: usize| self.model.furniture[index].part_of.unwrap_or(index);
        whole(a) == whole(b)
    }

    fn doors(&mut self) {
        for index in 0..self.model.furniture.len() {
            let Some(door) = &self.model.furniture[index].door else {
                continue;
            };
            let others = self
                .model
                .furniture
                .iter()
                .enumerate()
                .filter(|(other, _)| !self.same_piece(*other, index));
            let obstacles: Vec<(String, Block)> = others
                .map(|(_, other)| (other.id.to_string(), other.bounds))
                .chain(self.walls.iter().map(|wall| ("a wall".to_owned(), *wall)))
                .collect();
            let hit = points_while_opening(door)
                .into_iter()
                .find_map(|(point, open)| {
                    let (name, _) = obstacles.iter().find(|(_, block)| holds(block, point))?;
                    Some((
                        name.clone(),
                        point,
                        open * door.motion.open_position().abs(),
                    ))
                });
            if let Some((name, [x, y, _], position)) = hit {
                let message = match door.motion {
                    DoorMotion::Hinge(_) => {
                        let degrees = position.to_degrees();
                        format!("its door hits {name} when {degrees:.0} degrees open")
                    }
                    DoorMotion::Slide(_) => {
                        let centimetres = position * 100.0;
                        format!("hits {name} when {centimetres:.0} cm out")
                    }
                };
                let id = self.model.furniture[index].id.clone();
                self.find(SceneFault::Door, id, [x, y], message);
            }
        }
    }

    fn ways(&mut self) {
        let wide = Wide::from(self);
        for room in &self.scene.rooms {
            let cells = room.footprint().into_iter().flat_map(|rect| {
                let centre = |axis: usize| ((rect.min[axis] + rect.max[axis]) * 0.5) as f32;
                self.map.free_near([centre(0), centre(1)])
            });
            let places: Vec<[f32; 2]> = cells.collect();
            let reached = places
                .iter()
                .any(|place| self.map.path_length(self.start, *place).is_some());
            if !reached {
                let place = places.first().copied().unwrap_or(self.start);
                self.find(
                    SceneFault::Unreachable,
                    &room.name,
                    place,
                    "the robot cannot get into this room".to_owned(),
                );
            }
        }
        for index in 0..self.model.furniture.len() {
            let piece = &self.model.furniture[index];
            let id = piece.id.clone();
            let surface = &piece.surface;
            let middle = [0, 1].map(|axis| (surface.min[axis] + surface.max[axis]) * 0.5);
            let Some(viewpoint) = self.map.viewpoint(&self.model, self.start, index) else {
                let (fault, what) = if self.can_come_near(&piece.bounds) {
                    (
                        SceneFault::NoSight,
                        "the robot can come near, but something stands before it wherever it looks from",
                    )
                } else {
                    (SceneFault::Unreachable, "the robot cannot come near")
                };
                self.find(fault, id, middle, what.to_owned());
                continue;
            };
            let seen = self.seen(index, viewpoint.camera.position);
            let [x, y] = viewpoint.base;
            let least = match piece.part_of {
                Some(_) => SEEN_LEAST_IN_PART,
                None => SEEN_LEAST,
            };
            if seen < least {
                let what = format!(
                    "from its viewpoint ({x:.2}, {y:.2}) {seen} of 5 points of the surface are seen"
                );
                self.find(SceneFault::NoSight, id, middle, what);
            } else if !wide.reaches(viewpoint.base) {
                let what = format!("the way to its viewpoint is narrower than {PASSAGE_M} m");
                self.find(SceneFault::Narrow, id, viewpoint.base, what);
            }
        }
    }

    /// Whether the robot gets to a place from which receptacles are looked at.
    fn can_come_near(&self, [low, high]: &Block) -> bool {
        let steps = |axis: usize| {
            let (from, to) = (low[axis] - NEAR_M, high[axis] + NEAR_M);
            (0..=((to - from) / 0.1) as usize).map(move |step| from + step as f32 * 0.1)
        };
        let mut places = steps(0).flat_map(|x| steps(1).map(move |y| [x, y]));
        places.any(|place| {
            self.map.standable(place)
                && self.map.path_length(self.start, place).is_some()
                && self.map.line_of_sight(
                    [place[0], place[1], 2.0],
                    [(low[0] + high[0]) * 0.5, (low[1] + high[1]) * 0.5, 2.0],
                    None,
                )
        })
    }

    /// How many of five points of a surface are seen from a place: its middle and its corners,
    /// those of a box less far out.
    fn seen(&self, index: usize, eye: [f32; 3]) -> usize {
        let piece = &self.model.furniture[index];
        let surface = &piece.open_surface();
        let (near, far) = if piece.door.is_some() || piece.part_of.is_some() {
            (0.25, 0.75)
        } else {
            (0.1, 0.9)
        };
        let shares = [
            [0.5, 0.5],
            [near, near],
            [far, near],
            [near, far],
            [far, far],
        ];
        let points = shares.map(|share| {
            let along = |axis: usize| {
                surface.min[axis] + (surface.max[axis] - surface.min[axis]) * share[axis]
            };
            [along(0), along(1), surface.z + 0.02]
        });
        points
            .into_iter()
            .filter(|point| self.map.line_of_sight(eye, *point, None))
            .count()
    }

    fn captions(&mut self) {
        for (index, receptacle) in self.scene.receptacles.iter().enumerate() {
            let place = [0, 1].map(|axis| {
                ((receptacle.surface_min[axis] + receptacle.surface_max[axis]) * 0.5) as f32
            });
            if receptacle.captions.is_empty() {
                self.find(
                    SceneFault::Caption,
                    &receptacle.id,
                    place,
                    "has no caption".to_owned(),
                );
            }
            for caption in receptacle.captions.keys() {
                let namesake = self.scene.receptacles[..index].iter().find(|other| {
                    other
                        .captions
                        .keys()
                        .any(|theirs| theirs.eq_ignore_ascii_case(caption))
                });
                if let Some(other) = namesake {
                    self.find(
                        SceneFault::Caption,
                        &receptacle.id,
                        place,
                        format!("\"{caption}\" is said of {} too", other.id),
                    );
                }
                if let Some(word) = contradicted(receptacle, caption) {
                    self.find(
                        SceneFault::Caption,
                        &receptacle.id,
                        place,
                        format!("\"{caption}\" says {word}, its attributes do not"),
                    );
                }
            }
        }
    }
}

/// A colour or material of a caption that the attributes do not have.
fn contradicted(receptacle: &Receptacle, caption: &str) -> Option<String> {
    let known: BTreeSet<&str> = receptacle
        .attributes
        .values()
        .flatten()
        .map(String::as_str)
        .collect();
    let said = crate::attributes::from_furniture_captions([caption]);
    let words = said
        .into_iter()
        .filter(|(kind, _)| !matches!(kind.as_str(), "size" | "shape"))
        .flat_map(|(_, words)| words);
    if known.is_empty() {
        None
    } else {
        words
            .into_iter()
            .find(|word| !known.contains(word.as_str()))
    }
}

/// Middle of what two blocks share, if that is more than a touch.
fn shared(a: &Block, b: &Block) -> Option<[f32; 2]> {
    let low: [f32; 3] = std::array::from_fn(|axis| a[0][axis].max(b[0][axis]));
    let high: [f32; 3] = std::array::from_fn(|axis| a[1][axis].min(b[1][axis]));
    let meet = (0..3).all(|axis| high[axis] - low[axis] > TOUCH_M);
    meet.then(|| [0, 1].map(|axis| (low[axis] + high[axis]) * 0.5))
}

fn holds([low, high]: &Block, point: [f32; 3]) -> bool {
    (0..3).all(|axis| low[axis] + TOUCH_M < point[axis] && point[axis] < high[axis] - TOUCH_M)
}

/// Points of a door while it opens, with the share of the way: of a drawer the corners of its
/// parts.
fn points_while_opening(door: &DoorModel) -> Vec<([f32; 3], f32)> {
    let DoorMotion::Hinge(_) = door.motion else {
        let steps = 1..=SWING_STEPS;
        return steps
            .map(|step| step as f32 / SWING_STEPS as f32)
            .flat_map(|open| {
                let parts = door.parts_at(open).filter(|part| part.solid);
                parts.flat_map(move |part| part.box_corners().map(|corner| (corner, open)))
            })
            .collect();
    };
    // The panel reaches from the hinge to twice its middle.
    let Some(panel) = door.parts.iter().find(|part| part.solid) else {
        return Vec::new();
    };
    let [_, middle, height] = panel.pose.position;
    let Shape::Cuboid {
        half: [.., half_height],
    } = panel.shape
    else {
        return Vec::new();
    };
    let mut points = Vec::new();
    for step in 0..=SWING_STEPS {
        let open = step as f32 / SWING_STEPS as f32;
        let pose = door.opened(open);
        for share in 1..=8 {
            for up in [-0.95, 0.0, 0.95] {
                let point = [
                    0.0,
                    2.0 * middle * share as f32 / 8.0,
                    height + half_height * up,
                ];
                points.push((pose.apply(point), open));
            }
        }
    }
    points
}

/// The floor that is reached over passages of full width.
struct Wide {
    low: [f32; 2],
    width: usize,
    reached: Vec<bool>,
}

impl Wide {
    /// Floods from the start over centres around which a disc as wide as a passage is free.
    fn from(check: &Check<'_>) -> Self {
        let [low, high] = check.model.bounds;
        let low = low.map(|value| (value / CELL_M).floor() * CELL_M);
        let [width, height] =
            [0, 1].map(|axis| ((high[axis] - low[axis]) / CELL_M).ceil() as usize + 1);
        let mut wide = Self {
            low,
            width,
            reached: vec![false; width * height],
        };
        let fits = |cell: usize| {
            check
                .map
                .cells_free_in_disc(wide_centre(low, width, cell), PASSAGE_M * 0.5 - 1e-3)
        };
        let mut known: Vec<Option<bool>> = vec![None; width * height];
        let mut open: Vec<usize> = (0..width * height)
            .filter(|cell| {
                let [x, y] = wide_centre(low, width, *cell);
                let [dx, dy] = [x - check.start[0], y - check.start[1]];
                dx * dx + dy * dy <= PASSAGE_M * PASSAGE_M * 0.25 && fits(*cell)
            })
            .collect();
        for cell in &open {
            wide.reached[*cell] = true;
        }
        while let Some(cell) = open.pop() {
            let (column, row) = (cell % width, cell / width);
            let near = [
                (column > 0).then(|| cell - 1),
                (column + 1 < width).then(|| cell + 1),
                (row > 0).then(|| cell - width),
                (row + 1 < height).then(|| cell + width),
            ];
            for next in near.into_iter().flatten() {
                if !wide.reached[next] && *known[next].get_or_insert_with(|| fits(next)) {
                    wide.reached[next] = true;
                    open.push(next);
                }
            }
        }
        wide
    }

    /// Whether a place lies on such floor: within half a passage of a reached centre.
    fn reaches(&self, [x, y]: [f32; 2]) -> bool {
        let half = PASSAGE_M * 0.5 + CELL_M;
        (0..self.reached.len())
            .filter(|cell| self.reached[*cell])
            .any(|cell| {
                let [u, v] = wide_centre(self.low, self.width, cell);
                (u - x) * (u - x) + (v - y) * (v - y) <= half * half
            })
    }
}

fn wide_centre(low: [f32; 2], width: usize, cell: usize) -> [f32; 2] {
    [
        low[0] + (cell % width) as f32 * CELL_M + CELL_M * 0.5,
        low[1] + (cell / width) as f32 * CELL_M + CELL_M * 0.5,
    ]
}

/// A place for the robot to start in: in a room one passes through, near its middle but clear of
/// furniture, looking along the longer side.
pub(super) fn spacious_place(scene: &Scene) -> Option<[f64; 3]> {
    let model = scene_model(scene, &BTreeSet::new());
    let map = NavMap::new(&model);
    let is_first = |name: &str| {
        ["living room", "corridor", "dining room"]
            .iter()
            .position(|kind| name.starts_with(kind))
    };
    let room = scene
        .rooms
        .iter()
        .min_by_key(|room| is_first(&room.name).unwrap_or(usize::MAX))?;
    let rect = *room.footprint().first()?;
    let radii = [0.8_f32, 0.7, 0.6, 0.5];
    let steps = |axis: usize| {
        let count = ((rect.max[axis] - rect.min[axis]) / 0.1) as usize;
        (1..count).map(move |step| ((rect.min[axis] + step as f64 * 0.1) * 100.0).round() / 100.0)
    };
    let middle = [0, 1].map(|axis| (rect.min[axis] + rect.max[axis]) * 0.5);
    let mut places: Vec<[f64; 2]> = steps(1)
        .flat_map(|y| steps(0).map(move |x| [x, y]))
        .collect();
    let off = |[x, y]: [f64; 2]| (x - middle[0]).abs() + (y - middle[1]).abs();
    places.sort_by(|a, b| off(*a).total_cmp(&off(*b)));
    let free = |radius: f32| {
        let half = CELL_M * 0.5;
        places
            .iter()
            .copied()
            .find(|[x, y]| map.cells_free_in_disc([*x as f32 + half, *y as f32 + half], radius))
    };
    let [x, y] = radii.into_iter().find_map(free)?;
    let yaw = if rect.max[0] - rect.min[0] >= rect.max[1] - rect.min[1] {
        0.0
    } else {
        std::f64::consts::FRAC_PI_2
    };
    Some([x, y, (yaw * 10_000.0_f64).round() / 10_000.0])
}

/// Where a piece of furniture is looked at from, as the simulator would from the scene's start.
pub(super) fn viewpoints(scene: &Scene) -> (SceneModel, Vec<Option<reel_sim::nav::Viewpoint>>) {
    let check = Check::new(scene);
    let all = (0..check.model.furniture.len())
        .map(|index| check.map.viewpoint(&check.model, check.start, index))
        .collect();
    (check.model, all)
}
