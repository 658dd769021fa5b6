//! What a part covers of the floor plan: its exact convex outline and its height range.
//!
//! Knows nothing of grids but the square of a cell; never looks at colours or at whether
//! a part is solid.

use crate::geometry::{Part, Shape, distance_2d};

/// Resolution of polygon corners, in metres. Corners are whole numbers of it, so that
/// the hull is exact.
const CORNER_M: f32 = 1e-4;
/// Overlap that does not count yet, in metres: a wall that ends on a cell's edge does
/// not take that cell.
const TOUCH_M: f32 = 1e-3;

/// The part of the floor plan below a part.
#[derive(Clone, PartialEq, Debug)]
pub(super) struct Footprint {
    outline: Outline,
    /// Height of its lowest point, in metres.
    pub(super) bottom: f32,
    /// Height of its highest point, in metres.
    pub(super) top: f32,
    /// Bounding rectangle: lower and upper corner.
    pub(super) bounds: [[f32; 2]; 2],
}

#[derive(Clone, PartialEq, Debug)]
enum Outline {
    /// The edges of a convex polygon: a point on each and its outward unit normal.
    Polygon(Vec<[[f32; 2]; 2]>),
    Disc {
        center: [f32; 2],
        radius: f32,
    },
}

impl Footprint {
    /// The footprint of a part; `None` if a number in it is not finite. Cuboids are exact, upright
    /// round parts are discs, and tilted round parts count as the box around them.
    pub(super) fn of(part: &Part) -> Option<Self> {
        let corners = part.box_corners();
        if !corners.as_flattened().iter().all(|value| value.abs() < 1e4) {
            return None;
        }
        let [_, _, z] = part.pose.rotate([0.0, 0.0, 1.0]);
        let upright = z.abs() > 1.0 - 1e-6;
        let [x, y, height] = part.pose.position;
        let radius = match part.shape {
            Shape::Ball { radius } => Some(radius),
            Shape::Cylinder { radius, .. }
            | Shape::Capsule { radius, .. }
            | Shape::Cone { radius, .. }
                if upright =>
            {
                Some(radius)
            }
            _ => None,
        };
        let (bottom, top) = match part.shape {
            Shape::Ball { radius } => (height - radius, height + radius),
            _ => corners
                .iter()
                .fold((f32::MAX, f32::MIN), |(low, high), corner| {
                    (low.min(corner[2]), high.max(corner[2]))
                }),
        };
        let (outline, bounds) = match radius {
            Some(radius) => (
                Outline::Disc {
                    center: [x, y],
                    radius,
                },
                [[x - radius, y - radius], [x + radius, y + radius]],
            ),
            None => {
                let hull = convex_hull(corners.map(|[x, y, _]| [x, y]));
                let bounds = hull.iter().fold(
                    [[f32::MAX; 2], [f32::MIN; 2]],
                    |[[left, back], [right, front]], [x, y]| {
                        [[left.min(*x), back.min(*y)], [right.max(*x), front.max(*y)]]
                    },
                );
                (Outline::Polygon(edges(&hull)), bounds)
            }
        };
        Some(Self {
            outline,
            bottom,
            top,
            bounds,
        })
    }

    /// Whether it overlaps the axis-aligned square around `center`; touching is not overlapping.
    pub(super) fn overlaps_square(&self, center: [f32; 2], half: f32) -> bool {
        let [[left, back], [right, front]] = self.bounds;
        let [x, y] = center;
        let reach = half - TOUCH_M;
        if x + reach <= left || x - reach >= right || y + reach <= back || y - reach >= front {
            return false;
        }
        match &self.outline {
            Outline::Disc {
                center: [u, v],
                radius,
            } => {
                let (dx, dy) = (
                    ((u - x).abs() - reach).max(0.0),
                    ((v - y).abs() - reach).max(0.0),
                );
                dx * dx + dy * dy < radius * radius
            }
            Outline::Polygon(edges) => edges.iter().all(|[from, normal]| {
                let outside = (x - from[0]) * normal[0] + (y - from[1]) * normal[1];
                outside < reach * (normal[0].abs() + normal[1].abs())
            }),
        }
    }

    /// Whether a point lies in it or at most `margin` beyond an edge.
    pub(super) fn contains(&self, point: [f32; 2], margin: f32) -> bool {
        match &self.outline {
            Outline::Disc { center, radius } => distance_2d(*center, point) <= radius + margin,
            Outline::Polygon(edges) => edges.iter().all(|[from, normal]| {
                let outside = (point[0] - from[0]) * normal[0] + (point[1] - from[1]) * normal[1];
                outside <= margin
            }),
        }
    }
}

/// A point on each edge and its outward unit normal. A single corner has no edges.
fn edges(corners: &[[f32; 2]]) -> Vec<[[f32; 2]; 2]> {
    let next = corners.iter().cycle().skip(1);
    let pairs = corners.iter().zip(next).filter(|(from, to)| from != to);
    pairs
        .map(|(from, to)| {
            let length = distance_2d(*from, *to);
            [
                *from,
                [(to[1] - from[1]) / length, (from[0] - to[0]) / length],
            ]
        })
        .collect()
}

/// The convex hull, counter-clockwise, by Andrew's monotone chain over
/// whole multiples of [`CORNER_M`].
fn convex_hull(points: [[f32; 2]; 8]) -> Vec<[f32; 2]> {
    let mut points = points.map(|point| point.map(|value| libm::roundf(value / CORNER_M) as i64));
    points.sort_unstable();
    let half = |points: &mut dyn Iterator<Item = [i64; 2]>| {
        let mut chain: Vec<[i64; 2]> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0]) > 0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.into_iter());
    hull.extend(half(&mut points.into_iter().rev()));
    if hull.is_empty() {
        hull.push(points[0]);
    }
    hull.into_iter()
        .map(|corner| corner.map(|value| value as f32 * CORNER_M))
        .collect()
}
