//! The convex hull of a point cloud, exactly: corners are picked in fixed directions, put on an
//! integer grid, and every decision after that is integer arithmetic. So it is closed and convex by
//! construction, whatever the input, and the same on every platform.

/// A closed convex polyhedron with triangles as faces.
#[derive(Clone, PartialEq, Debug)]
pub struct Hull {
    /// Corners of the polyhedron, in the frame and unit of the input points.
    pub points: Vec<[f32; 3]>,
    /// Triangles over them, counter-clockwise from outside, closed.
    pub triangles: Vec<[u32; 3]>,
}

/// Steps of the grid along each side of the box around the points. Volumes of it fit 64 bits.
const STEPS: f32 = 32_768.0;
/// Corners are picked in all directions of whole numbers up to this: 98 of them.
const REACH: i8 = 2;

/// The hull of those of the points that are farthest in a fixed set of directions, at most 98; its
/// bounding box is that of all points. None when all of them lie in one plane.
pub(super) fn hull(points: &[[f32; 3]]) -> Option<Hull> {
    let corners: Vec<[f32; 3]> = corners(points);
    let low = [0, 1, 2].map(|axis| {
        corners
            .iter()
            .map(|point| point[axis])
            .fold(f32::INFINITY, f32::min)
    });
    let high = [0, 1, 2].map(|axis| {
        corners
            .iter()
            .map(|point| point[axis])
            .fold(f32::NEG_INFINITY, f32::max)
    });
    let step = [0, 1, 2].map(|axis| (high[axis] - low[axis]) / STEPS);
    let on_grid = |point: &[f32; 3]| {
        [0, 1, 2].map(|axis| {
            if step[axis] > 0.0 {
                ((point[axis] - low[axis]) / step[axis] + 0.5) as i64
            } else {
                0
            }
        })
    };
    let mut grid: Vec<[i64; 3]> = corners.iter().map(on_grid).collect();
    grid.sort_unstable();
    grid.dedup();
    let faces = wrap(&grid)?;
    let mut used: Vec<usize> = faces.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let place = |index: &usize| {
        used.binary_search(index)
            .expect("every corner of a face is used") as u32
    };
    let off_grid = |index: &usize| {
        let point = grid[*index];
        [0, 1, 2]
            .map(|axis| (low[axis] + point[axis] as f32 * step[axis]).clamp(low[axis], high[axis]))
    };
    Some(Hull {
        points: used.iter().map(off_grid).collect(),
        triangles: faces
            .iter()
            .map(|face| face.each_ref().map(place))
            .collect(),
    })
}

/// The farthest point in each direction; the first one of equals.
fn corners(points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut corners = Vec::new();
    let range = || -REACH..=REACH;
    for direction in
        range().flat_map(|x| range().flat_map(move |y| range().map(move |z| [x, y, z])))
    {
        // Even ones point where their half does.
        if direction.iter().all(|step| step % 2 == 0) {
            continue;
        }
        let direction = direction.map(f32::from);
        let mut best: Option<(f32, [f32; 3])> = None;
        for point in points {
            let far = point[0] * direction[0] + point[1] * direction[1] + point[2] * direction[2];
            if best.is_none_or(|(most, _)| far > most) {
                best = Some((far, *point));
            }
        }
        corners.extend(best.map(|(_, point)| point));
    }
    corners
}

/// The hull of distinct points as triangles over them: one point after another is added, the faces
/// that see it are replaced by those from the edge of what it sees.
fn wrap(points: &[[i64; 3]]) -> Option<Vec<[usize; 3]>> {
    let (a, others) = (0, 1..points.len());
    let b = others.clone().next()?;
    let c = others
        .clone()
        .find(|c| cross(sub(points[b], points[a]), sub(points[*c], points[a])) != [0; 3])?;
    let d = others
        .clone()
        .find(|d| volume(points, [a, b, c], *d) != 0)?;
    let (b, c) = if volume(points, [a, b, c], d) > 0 {
        (c, b)
    } else {
        (b, c)
    };
    // Counter-clockwise from outside: what is inside has a negative volume over every face.
    let mut faces = vec![[a, b, c], [a, c, d], [a, d, b], [b, d, c]];
    for point in others {
        let (seen, mut kept): (Vec<_>, Vec<_>) = faces
            .iter()
            .partition(|face| volume(points, **face, point) > 0);
        let edges =
            |face: &[usize; 3]| [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]];
        let rim = seen
            .iter()
            .flat_map(edges)
            .filter(|[from, to]| !seen.iter().flat_map(edges).any(|edge| edge == [*to, *from]));
        kept.extend(rim.map(|[from, to]| [from, to, point]));
        faces = kept;
    }
    Some(faces)
}

/// Six times the volume of the tetrahedron over a face; positive where the point sees
/// the face from outside.
fn volume(points: &[[i64; 3]], [a, b, c]: [usize; 3], point: usize) -> i64 {
    let normal = cross(sub(points[b], points[a]), sub(points[c], points[a]));
    let away = sub(points[point], points[a]);
    normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2]
}

fn sub(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    fn check(hull: &Hull) {
        let mut edges = BTreeSet::new();
        for [a, b, c] in &hull.triangles {
            for edge in [(*a, *b), (*b, *c), (*c, *a)] {
                assert!(
                    edges.insert(edge),
                    "an edge is used twice in one direction: {hull:?}"
                );
            }
        }
        assert!(
            edges.iter().all(|&(a, b)| edges.contains(&(b, a))),
            "there is a hole: {hull:?}"
        );
        assert_eq!(
            hull.points.len() + hull.triangles.len(),
            edges.len() / 2 + 2,
            "Euler: {hull:?}"
        );
    }

    #[test]
    fn a_box_has_its_corners_and_a_sheet_has_no_hull() {
        let corners: Vec<[f32; 3]> = (0..8)
            .map(|corner: u8| {
                [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 0.1 } else { -0.1 })
            })
            .collect();
        let hull_of_box =
            hull(&[corners.clone(), vec![[0.0; 3], [0.1, 0.05, 0.0]]].concat()).unwrap();
        assert_eq!(
            (hull_of_box.points.len(), hull_of_box.triangles.len()),
            (8, 12)
        );
        check(&hull_of_box);
        assert_eq!(hull(&corners[..4]), None);
        assert_eq!(hull(&corners[..1]), None);
    }

    proptest! {
        #[test]
        fn hulls_are_closed_and_hold_every_corner(
            points in prop::collection::vec(prop::array::uniform3(prop_oneof![-1.0f32..1.0, Just(0.5), Just(-0.5)]), 4..80),
        ) {
            if let Some(hull) = hull(&points) {
                check(&hull);
                for axis in 0..3 {
                    let low = |points: &[[f32; 3]]| points.iter().map(|point| point[axis]).fold(f32::MAX, f32::min);
                    let high = |points: &[[f32; 3]]| points.iter().map(|point| point[axis]).fold(f32::MIN, f32::max);
                    prop_assert_eq!(low(&points), low(&hull.points));
                    prop_assert!((high(&points) - high(&hull.points)).abs() < 1e-6);
                }
            }
        }
    }
}
