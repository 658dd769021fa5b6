//! Where a held object is put: the clamp algorithm, the collision-free point of a surface
//! nearest to the robot.

use crate::{geometry::Pose, model::Surface};

/// Grid of candidate points on a surface, in metres.
const STEP_M: f32 = 0.02;
/// Free distance to the surface's edge, where it is large enough.
const EDGE_MARGIN_M: f32 = 0.05;
/// Free distance to other objects.
const OBJECT_MARGIN_M: f32 = 0.03;
/// How far above the surface the object is let go.
const DROP_M: f32 = 0.02;
/// Most that an object may stand over on each side of a surface that is too small for it, as a
/// share of its half extent.
const OVERHANG: f32 = 0.25;

/// Horizontal distance of a point to the surface's rectangle, in metres.
pub fn distance_to_surface(surface: &Surface, point: [f32; 2]) -> f32 {
    let outside = |axis: usize| {
        (surface.min[axis] - point[axis])
            .max(point[axis] - surface.max[axis])
            .max(0.0)
    };
    let (x, y) = (outside(0), outside(1));
    libm::sqrtf(x * x + y * y)
}

/// The pose of an object (half extents `half`, unturned or turned by 90 degrees) on a surface,
/// nearest to the robot and clear of `obstacles` (bounding boxes); none if it fits nowhere. Ties go
/// to the smaller y, then x.
pub fn clamp(
    surface: &Surface,
    half: [f32; 3],
    robot: [f32; 2],
    obstacles: &[[[f32; 3]; 2]],
) -> Option<Pose> {
    if 2.0 * half[2] > surface.clearance {
        return None;
    }
    let turned = [half[1], half[0], half[2]];
    let quarter = std::f32::consts::FRAC_PI_2;
    best_point(surface, half, robot, obstacles)
        .map(|point| (point, half, 0.0))
        .or_else(|| {
            best_point(surface, turned, robot, obstacles).map(|point| (point, turned, quarter))
        })
        .map(|(point, half, yaw)| {
            Pose::yawed([point[0], point[1], surface.z + half[2] + DROP_M], yaw)
        })
}

fn best_point(
    surface: &Surface,
    half: [f32; 3],
    robot: [f32; 2],
    obstacles: &[[[f32; 3]; 2]],
) -> Option<[f32; 2]> {
    let xs = candidates(surface.min[0], surface.max[0], half[0])?;
    let ys = candidates(surface.min[1], surface.max[1], half[1])?;
    let mut best: Option<(f32, [f32; 2])> = None;
    for &y in &ys {
        for &x in &xs {
            let distance = (x - robot[0]) * (x - robot[0]) + (y - robot[1]) * (y - robot[1]);
            let nearer = best.is_none_or(|(least, _)| distance < least);
            if nearer
                && obstacles
                    .iter()
                    .all(|bounds| clear(bounds, [x, y], half, surface))
            {
                best = Some((distance, [x, y]));
            }
        }
    }
    best.map(|(_, point)| point)
}

/// Centres along one axis: a grid where the object fits with its margin, else the middle.
fn candidates(min: f32, max: f32, half: f32) -> Option<Vec<f32>> {
    let room = (max - min) * 0.5 - half;
    let middle = (min + max) * 0.5;
    if room < -OVERHANG * half {
        return None;
    }
    if room <= EDGE_MARGIN_M {
        return Some(vec![middle]);
    }
    let reach = room - EDGE_MARGIN_M;
    let count = (2.0 * reach / STEP_M) as usize + 1;
    Some(
        (0..count)
            .map(|index| middle - reach + index as f32 * STEP_M)
            .collect(),
    )
}

fn clear(bounds: &[[f32; 3]; 2], point: [f32; 2], half: [f32; 3], surface: &Surface) -> bool {
    let apart = |axis: usize| {
        point[axis] + half[axis] + OBJECT_MARGIN_M <= bounds[0][axis]
            || point[axis] - half[axis] - OBJECT_MARGIN_M >= bounds[1][axis]
    };
    let above = bounds[0][2] >= surface.z + surface.clearance;
    let below = bounds[1][2] <= surface.z - 0.05;
    apart(0) || apart(1) || above || below
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: Surface = Surface {
        min: [0.0, 0.0],
        max: [1.0, 0.6],
        z: 0.7,
        clearance: 1.0,
    };

    #[test]
    fn nearest_point_to_the_robot() {
        let pose = clamp(&TABLE, [0.05, 0.05, 0.1], [2.0, 0.3], &[]).unwrap();
        assert!((pose.position[0] - 0.9).abs() < STEP_M, "{pose:?}");
        assert!((pose.position[1] - 0.3).abs() < STEP_M, "{pose:?}");
        assert!((pose.position[2] - 0.82).abs() < 1e-6, "{pose:?}");
    }

    #[test]
    fn keeps_clear_of_what_is_there() {
        let cup = [[0.8, 0.1, 0.7], [1.0, 0.5, 0.8]];
        let half = [0.05, 0.05, 0.1];
        let pose = clamp(&TABLE, half, [2.0, 0.3], &[cup]).unwrap();
        assert!(clear(
            &cup,
            [pose.position[0], pose.position[1]],
            half,
            &TABLE
        ));
        let wall_to_wall = [[0.0, 0.0, 0.7], [1.0, 0.6, 0.8]];
        assert_eq!(clamp(&TABLE, half, [2.0, 0.3], &[wall_to_wall]), None);
    }

    #[test]
    fn turns_or_refuses_what_does_not_fit() {
        let long = clamp(&TABLE, [0.1, 0.45, 0.02], [2.0, 0.3], &[]).unwrap();
        assert!(long.rotation[2] > 0.7, "turned by 90 degrees: {long:?}");
        assert_eq!(clamp(&TABLE, [0.8, 0.8, 0.1], [2.0, 0.3], &[]), None);
        assert_eq!(clamp(&TABLE, [0.1, 0.1, 0.6], [2.0, 0.3], &[]), None);
    }

    #[test]
    fn distance_is_zero_above_the_surface() {
        assert_eq!(distance_to_surface(&TABLE, [0.5, 0.5]), 0.0);
        assert!((distance_to_surface(&TABLE, [1.3, 1.0]) - 0.5).abs() < 1e-6);
    }
}
