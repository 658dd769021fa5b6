//! Where objects can rest on solids: level faces with free space above.

use reel_world::{Rect, Solid, SolidShape};

use crate::affine::{Affine, Bounds};

/// Least side of a surface, in metres.
const SIDE_MIN_M: f64 = 0.12;
/// Least free height above a surface, in metres.
const HEADROOM_MIN_M: f64 = 0.12;
/// A face this far from level, as the z of its normal, still holds objects.
const LEVEL_MIN: f64 = 0.9995;
/// What reaches less above a face than this lies flush with it, in metres.
const FLUSH_M: f64 = 0.012;
/// Height of the opening that a hand needs above a face, in metres.
const OPENING_M: f64 = 0.3;
/// How far inside of its edge a face is looked at from, and how far beyond it, in metres.
const EDGE_M: f64 = 0.02;
const APPROACH_M: f64 = 0.5;

/// A level face with space above it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Face {
    pub(crate) rect: Rect,
    pub(crate) z: f64,
    /// Free height above it; infinite under the sky.
    pub(crate) headroom: f64,
}

impl Face {
    pub(crate) fn area(&self) -> f64 {
        area(&self.rect)
    }
}

/// The level faces of some solids that objects have space on, highest first. `around` is all that
/// takes space.
pub(crate) fn faces(of: &[&Solid], around: &[&Solid]) -> Vec<Face> {
    let obstacles: Vec<Bounds> = around
        .iter()
        .map(|primitive| Bounds::of(primitive))
        .collect();
    let faces = of.iter().filter_map(|primitive| {
        let (rect, z) = upper_face(primitive)?;
        free_part(rect, z, &obstacles)
    });
    let mut faces: Vec<Face> = faces.collect();
    faces.sort_by(|a, b| b.z.total_cmp(&a.z));
    faces
}

/// Whether a face can be reached from one of its sides at least: half of what lies above its edge
/// there is free of solids.
pub(crate) fn is_open(face: &Face, around: &[&Solid]) -> bool {
    let obstacles: Vec<Bounds> = around.iter().map(|solid| Bounds::of(solid)).collect();
    let height = face.headroom.min(OPENING_M);
    (0..2).any(|axis| {
        [false, true].into_iter().any(|upper| {
            let edge = if upper {
                face.rect.max[axis] - EDGE_M
            } else {
                face.rect.min[axis] + EDGE_M
            };
            let beyond = |obstacle: &Bounds| {
                if upper {
                    obstacle.high[axis] > edge && obstacle.low[axis] < edge + APPROACH_M
                } else {
                    obstacle.low[axis] < edge && obstacle.high[axis] > edge - APPROACH_M
                }
            };
            let beyond: Vec<&Bounds> = obstacles.iter().filter(|it| beyond(it)).collect();
            let across = 1 - axis;
            let width = face.rect.max[across] - face.rect.min[across];
            let points = (0..5).flat_map(|side| (0..3).map(move |rise| (side, rise)));
            let free = points.filter(|(side, rise)| {
                let at = face.rect.min[across] + width * (f64::from(*side) + 0.5) / 5.0;
                let z = face.z + height * (f64::from(*rise) + 0.5) / 3.0;
                let holds = |obstacle: &&&Bounds| {
                    (obstacle.low[across]..=obstacle.high[across]).contains(&at)
                        && (obstacle.low[2]..=obstacle.high[2]).contains(&z)
                };
                !beyond.iter().any(|obstacle| holds(&obstacle))
            });
            free.count() > 7
        })
    })
}

/// The face that counts as the surface of a piece: open to the sky and large; of such, the highest.
pub(crate) fn top(faces: &[Face]) -> Option<Face> {
    let open = || faces.iter().filter(|face| face.headroom.is_infinite());
    let largest = open().map(Face::area).fold(0.0, f64::max);
    let top = open().find(|face| face.area() >= largest * 0.5);
    top.or_else(|| faces.iter().max_by(|a, b| a.area().total_cmp(&b.area())))
        .copied()
}

/// The level upper face of a primitive; of one that is turned, or round, the largest rectangle
/// along the axes within.
fn upper_face(primitive: &Solid) -> Option<(Rect, f64)> {
    let axes = Affine::of_quaternion(primitive.rotation).axes;
    let [x, y, z] = primitive.position;
    let (half, rise) = match primitive.shape {
        SolidShape::Box { half } => {
            let up = (0..3).find(|side| axes[*side][2].abs() > LEVEL_MIN)?;
            let (a, b) = ((up + 1) % 3, (up + 2) % 3);
            (inscribed(half[a], half[b], axes[a]), half[up])
        }
        SolidShape::Cylinder {
            radius,
            half_height,
        } if axes[2][2].abs() > LEVEL_MIN => ([radius / std::f64::consts::SQRT_2; 2], half_height),
        _ => return None,
    };
    let rect = Rect {
        min: [x - half[0], y - half[1]],
        max: [x + half[0], y + half[1]],
    };
    Some((rect, z + rise))
}

/// Half extents of a rectangle along the axes inside of one of half extents a, b, whose first side
/// points along `direction`.
fn inscribed(a: f64, b: f64, direction: [f64; 3]) -> [f64; 2] {
    let [cos, sin] = [direction[0].abs(), direction[1].abs()];
    if sin < 1e-3 {
        return [a, b];
    }
    if cos < 1e-3 {
        return [b, a];
    }
    // Its corner (u, v) has to satisfy u cos + v sin <= a and u sin + v cos <= b; as wide as the
    // turned rectangle's own bounds are.
    let (wide, deep) = (a * cos + b * sin, a * sin + b * cos);
    let scale = |u: f64, v: f64| (a / (u * cos + v * sin)).min(b / (u * sin + v * cos));
    let factor = scale(wide, deep);
    [wide * factor, deep * factor]
}

/// What is free of a face: cut where something stands on it, with the height above the rest.
fn free_part(mut rect: Rect, z: f64, obstacles: &[Bounds]) -> Option<Face> {
    let over = |rect: &Rect, obstacle: &Bounds| {
        (0..2).all(|axis| {
            obstacle.low[axis] + 1e-3 < rect.max[axis]
                && obstacle.high[axis] - 1e-3 > rect.min[axis]
        })
    };
    let stands =
        |obstacle: &&Bounds| obstacle.high[2] > z + FLUSH_M && obstacle.low[2] < z + HEADROOM_MIN_M;
    for obstacle in obstacles.iter().filter(stands) {
        if over(&rect, obstacle) {
            rect = largest_beside(&rect, obstacle)?;
        }
    }
    let above = obstacles
        .iter()
        .filter(|obstacle| obstacle.low[2] >= z + HEADROOM_MIN_M && over(&rect, obstacle));
    let headroom = above
        .map(|obstacle| obstacle.low[2] - z)
        .fold(f64::INFINITY, f64::min);
    let sides = [0, 1].map(|axis| rect.max[axis] - rect.min[axis]);
    let fits = sides.into_iter().all(|side| side >= SIDE_MIN_M);
    fits.then_some(Face { rect, z, headroom })
}

/// The largest of the four rectangles beside an obstacle.
fn largest_beside(rect: &Rect, obstacle: &Bounds) -> Option<Rect> {
    let parts = (0..2).flat_map(|axis| {
        let (mut low, mut high) = (*rect, *rect);
        low.max[axis] = low.max[axis].min(obstacle.low[axis]);
        high.min[axis] = high.min[axis].max(obstacle.high[axis]);
        [low, high]
    });
    parts
        .filter(|part| (0..2).all(|axis| part.max[axis] - part.min[axis] >= SIDE_MIN_M))
        .max_by(|a, b| area(a).total_cmp(&area(b)))
}

pub(crate) fn area(rect: &Rect) -> f64 {
    (rect.max[0] - rect.min[0]) * (rect.max[1] - rect.min[1])
}

/// What two rectangles share, or `None`.
pub(crate) fn shared(a: &Rect, b: &Rect) -> Option<Rect> {
    let rect = Rect {
        min: [0, 1].map(|axis| a.min[axis].max(b.min[axis])),
        max: [0, 1].map(|axis| a.max[axis].min(b.max[axis])),
    };
    (0..2)
        .all(|axis| rect.min[axis] < rect.max[axis])
        .then_some(rect)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(low: [f64; 3], high: [f64; 3]) -> Solid {
        Bounds { low, high }.solid([0; 3])
    }

    fn all(solids: &[Solid]) -> Vec<Face> {
        let solids: Vec<&Solid> = solids.iter().collect();
        faces(&solids, &solids)
    }

    #[test]
    fn a_table_has_its_top_and_a_bed_its_mattress() {
        let legs = [0.0, 1.1].map(|x| block([x, 0.0, 0.0], [x + 0.1, 0.7, 0.7]));
        let table = [
            legs[0].clone(),
            legs[1].clone(),
            block([0.0, 0.0, 0.7], [1.2, 0.7, 0.74]),
        ];
        let top_face = top(&all(&table)).expect("there is a top");
        assert!((top_face.z - 0.74).abs() < 1e-9 && (top_face.area() - 0.84).abs() < 1e-9);
        let bed = [
            block([0.0, 0.0, 0.0], [2.0, 1.4, 0.45]),
            block([-0.1, 0.0, 0.0], [0.1, 1.4, 1.1]),
        ];
        let mattress = top(&all(&bed)).expect("there is a mattress");
        assert!((mattress.z - 0.45).abs() < 1e-9, "{mattress:?}");
        assert!(
            (mattress.rect.min[0] - 0.1).abs() < 1e-9,
            "the headboard takes its part"
        );
    }

    #[test]
    fn boards_under_boards_are_shelves() {
        let boards = [0.1, 0.5, 0.9].map(|z| block([0.0, 0.0, z], [0.8, 0.3, z + 0.02]));
        let found: Vec<f64> = all(&boards).iter().map(|face| face.headroom).collect();
        assert!(
            found[0].is_infinite() && (found[1] - 0.38).abs() < 1e-9,
            "{found:?}"
        );
    }

    #[test]
    fn a_board_is_open_where_one_side_of_it_is_free() {
        let mut case = vec![
            block([0.0, 0.0, 0.0], [0.8, 0.4, 0.02]),
            block([0.0, 0.0, 0.0], [0.02, 0.4, 0.8]),
            block([0.78, 0.0, 0.0], [0.8, 0.4, 0.8]),
            block([0.0, 0.38, 0.0], [0.8, 0.4, 0.8]),
            block([0.0, 0.0, 0.78], [0.8, 0.4, 0.8]),
        ];
        let open = |case: &[Solid]| {
            let around: Vec<&Solid> = case.iter().collect();
            let lowest = *all(case).last().expect("there is a board");
            is_open(&lowest, &around)
        };
        assert!(open(&case), "its front is free");
        case.push(block([0.05, -0.03, 0.1], [0.75, -0.01, 0.7]));
        assert!(!open(&case), "a door is in front of it");
    }

    #[test]
    fn a_turned_top_gives_a_rectangle_inside_of_it() {
        for degrees in [10.0_f64, 30.0, 45.0, 80.0] {
            let map = Affine::turned(2, degrees.to_radians());
            let top_of = map.primitive(&block([-0.6, -0.3, 0.0], [0.6, 0.3, 0.7]));
            let (rect, _) = upper_face(&top_of).expect("it is level");
            for corner in [rect.min, rect.max, [rect.min[0], rect.max[1]]] {
                let [a, b] = [0, 1].map(|side| {
                    (corner[0] * map.axes[side][0] + corner[1] * map.axes[side][1]).abs()
                });
                assert!(a <= 0.6 + 1e-9 && b <= 0.3 + 1e-9, "{degrees} {corner:?}");
            }
        }
    }
}
