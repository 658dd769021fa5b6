//! Tests of navigation on hand-made flats and random grids; brute force is the reference.

use std::f32::consts::FRAC_PI_2;

use proptest::prelude::*;

use super::{
    grid::Grid,
    path::{UNREACHED, costs_from, shortest},
    *,
};
use crate::{
    geometry::{Part, Pattern, Pose, Shape, distance_2d},
    model::{DoorModel, DoorMotion, Furniture, Surface},
};

fn part(shape: Shape, pose: Pose) -> Part {
    Part {
        shape,
        pose,
        color: [128; 3],
        accent: [0; 3],
        pattern: Pattern::Plain,
        solid: true,
    }
}

fn block(min: [f32; 3], max: [f32; 3]) -> Part {
    let half = std::array::from_fn(|axis| (max[axis] - min[axis]) * 0.5);
    part(
        Shape::Cuboid { half },
        Pose::at(std::array::from_fn(|axis| (max[axis] + min[axis]) * 0.5)),
    )
}

/// One room from the origin to `size` with walls around it, and no furniture.
fn room(size: [f32; 2]) -> SceneModel {
    let [width, depth] = size;
    let shell = vec![
        block([0.0, 0.0, -0.1], [width, depth, 0.0]),
        block([-0.05, -0.05, 0.0], [width + 0.05, 0.05, 2.5]),
        block(
            [-0.05, depth - 0.05, 0.0],
            [width + 0.05, depth + 0.05, 2.5],
        ),
        block([-0.05, -0.05, 0.0], [0.05, depth + 0.05, 2.5]),
        block(
            [width - 0.05, -0.05, 0.0],
            [width + 0.05, depth + 0.05, 2.5],
        ),
    ];
    SceneModel {
        shell,
        walls: Vec::new(),
        furniture: Vec::new(),
        bounds: [[0.0; 2], size],
    }
}

/// A room of 6 x 4 m, parted at x = 3 by a wall that leaves out y from 2.0 to 2.0 + `opening`.
fn two_rooms(opening: f32) -> SceneModel {
    let mut model = room([6.0, 4.0]);
    model.shell.push(block([2.95, 0.0, 0.0], [3.05, 2.0, 2.5]));
    model
        .shell
        .push(block([2.95, 2.0 + opening, 0.0], [3.05, 4.0, 2.5]));
    model
}

fn furniture(parts: Vec<Part>, surface: Surface, bounds: [[f32; 3]; 2]) -> Furniture {
    Furniture {
        id: "thing_0".into(),
        parts,
        surface,
        bounds,
        facing: [1.0, 0.0],
        door: None,
        part_of: None,
        present: true,
    }
}

/// A table: a top and four legs.
fn table(min: [f32; 2], max: [f32; 2], z: f32) -> Furniture {
    let mut parts = vec![block([min[0], min[1], z - 0.04], [max[0], max[1], z])];
    for x in [min[0], max[0] - 0.05] {
        for y in [min[1], max[1] - 0.05] {
            parts.push(block([x, y, 0.0], [x + 0.05, y + 0.05, z - 0.04]));
        }
    }
    furniture(
        parts,
        Surface {
            min,
            max,
            z,
            clearance: 1.0,
        },
        [[min[0], min[1], 0.0], [max[0], max[1], z]],
    )
}

/// A box of 0.6 x 0.6 x 0.8 m on the floor with the interior at 0.3 m; its front, with a
/// door, looks along +x.
fn fridge([x, y]: [f32; 2]) -> Furniture {
    let parts = vec![
        block([x, y, 0.0], [x + 0.58, y + 0.6, 0.3]),
        block([x, y, 0.3], [x + 0.02, y + 0.6, 0.8]),
        block([x, y, 0.3], [x + 0.58, y + 0.02, 0.8]),
        block([x, y + 0.58, 0.3], [x + 0.58, y + 0.6, 0.8]),
        block([x, y, 0.78], [x + 0.58, y + 0.6, 0.8]),
    ];
    let surface = Surface {
        min: [x + 0.04, y + 0.04],
        max: [x + 0.56, y + 0.56],
        z: 0.3,
        clearance: 0.48,
    };
    let leaf = block([0.0, -0.6, 0.0], [0.02, 0.0, 0.8]);
    Furniture {
        door: Some(DoorModel {
            closed: Pose::at([x + 0.58, y + 0.6, 0.0]),
            parts: vec![leaf],
            motion: DoorMotion::Hinge(FRAC_PI_2),
            guided: false,
            center: [x + 0.6, y + 0.3, 0.4],
        }),
        ..furniture(parts, surface, [[x, y, 0.0], [x + 0.6, y + 0.6, 0.8]])
    }
}

fn gap(base: [f32; 2], bounds: [[f32; 3]; 2]) -> f32 {
    let beyond = |axis: usize| {
        (bounds[0][axis] - base[axis])
            .max(base[axis] - bounds[1][axis])
            .max(0.0)
    };
    distance_2d([beyond(0), beyond(1)], [0.0; 2])
}

/// Whether a point lies inside a part grown by `margin`, by the inverse of its pose.
fn inside(part: &Part, point: [f32; 3], margin: f32) -> bool {
    let Pose {
        position,
        rotation: [x, y, z, w],
    } = part.pose;
    let back = Pose {
        position: [0.0; 3],
        rotation: [-x, -y, -z, w],
    };
    let local = back.rotate(std::array::from_fn(|axis| point[axis] - position[axis]));
    let level = libm::sqrtf(local[0] * local[0] + local[1] * local[1]);
    match part.shape {
        Shape::Cuboid { half } => (0..3).all(|axis| local[axis].abs() < half[axis] + margin),
        Shape::Cylinder {
            radius,
            half_height,
        } => level < radius + margin && local[2].abs() < half_height + margin,
        Shape::Ball { radius } => {
            libm::sqrtf(level * level + local[2] * local[2]) < radius + margin
        }
        Shape::Capsule { .. } | Shape::Cone { .. } => panic!("not in these tests"),
    }
}

/// Cheapest costs by relaxing every step until nothing changes, over plain coordinates.
fn brute_force(free: &[Vec<bool>], start: [usize; 2]) -> Vec<Vec<u32>> {
    let mut cost = vec![vec![UNREACHED; free[0].len()]; free.len()];
    cost[start[1]][start[0]] = 0;
    let mut changed = true;
    while changed {
        changed = false;
        for y in 1..free.len() - 1 {
            for x in 1..free[0].len() - 1 {
                for (dx, dy) in [
                    (-1, 0),
                    (1, 0),
                    (0, -1),
                    (0, 1),
                    (-1, -1),
                    (1, -1),
                    (-1, 1),
                    (1, 1),
                ] {
                    let (u, v) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
                    let passable = free[y][x] && free[v][u] && free[y][u] && free[v][x];
                    let step = if dx != 0 && dy != 0 { 1414 } else { 1000 };
                    if passable && cost[y][x] != UNREACHED && cost[y][x] + step < cost[v][u] {
                        cost[v][u] = cost[y][x] + step;
                        changed = true;
                    }
                }
            }
        }
    }
    cost
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn paths_are_shortest(cells in prop::collection::vec(prop::bool::weighted(0.3), 12 * 10), seed in any::<prop::sample::Index>()) {
        let (width, height) = (14, 12);
        let border = |x: usize, y: usize| x == 0 || y == 0 || x == width - 1 || y == height - 1;
        let free: Vec<Vec<bool>> = (0..height)
            .map(|y| (0..width).map(|x| !border(x, y) && !cells[(y - 1) * 12 + x - 1]).collect())
            .collect();
        let grid = Grid::from_occupied([0, 0], width, free.iter().flatten().map(|free| !free).collect());
        let open: Vec<usize> = (0..grid.len()).filter(|cell| grid.is_free(*cell)).collect();
        prop_assume!(!open.is_empty());
        let from = open[seed.index(open.len())];
        let expected = brute_force(&free, grid.place(from)).concat();
        prop_assert_eq!(&costs_from(&grid, from), &expected);
        for (to, expected) in expected.iter().enumerate() {
            let found = shortest(&grid, from, to);
            prop_assert_eq!(found.as_ref().map_or(UNREACHED, |(cost, _)| *cost), *expected);
            let Some((cost, cells)) = found else { continue };
            prop_assert_eq!(shortest(&grid, to, from).map(|(back, _)| back), Some(cost));
            prop_assert_eq!((cells[0], cells[cells.len() - 1]), (from, to));
            let mut sum = 0;
            for pair in cells.windows(2) {
                let ([x, y], [u, v]) = (grid.place(pair[0]), grid.place(pair[1]));
                prop_assert!(x.abs_diff(u) <= 1 && y.abs_diff(v) <= 1 && pair[0] != pair[1]);
                prop_assert!(free[v][u] && free[y][u] && free[v][x], "a corner is cut");
                sum += if x != u && y != v { 1414 } else { 1000 };
            }
            prop_assert_eq!(sum, cost);
        }
    }

    #[test]
    fn sight_agrees_with_samples(
        shapes in prop::collection::vec((0usize..3, prop::array::uniform3(0.05f32..0.6), prop::array::uniform3(-1.5f32..1.5),
            prop::array::uniform4(-1.0f32..1.0)), 1..5),
        from in prop::array::uniform3(-2.0f32..2.0),
        to in prop::array::uniform3(-2.0f32..2.0),
    ) {
        let parts: Vec<Part> = shapes.into_iter().filter_map(|(kind, size, position, rotation)| {
            let length = libm::sqrtf(rotation.iter().map(|value| value * value).sum());
            let shape = [
                Shape::Cuboid { half: size },
                Shape::Cylinder { radius: size[0], half_height: size[1] },
                Shape::Ball { radius: size[0] },
            ][kind];
            (length > 0.1).then(|| part(shape, Pose { position, rotation: rotation.map(|value| value / length) }))
        }).collect();
        let mut model = room([1.0, 1.0]);
        model.shell = parts.clone();
        let clear = NavMap::new(&model).line_of_sight(from, to, None);
        let sample = |step: usize| -> [f32; 3] { std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * step as f32 / 4000.0) };
        let hit = |margin: f32| (0..=4000).any(|step| parts.iter().any(|part| inside(part, sample(step), margin)));
        if clear {
            prop_assert!(!hit(-1e-4), "sees through a part");
        } else {
            prop_assert!(hit(2e-3), "blocked by nothing");
        }
    }

    #[test]
    fn bases_do_not_collide(
        yaw in 0.0f32..6.3, position in prop::array::uniform2(1.0f32..3.0), half in prop::array::uniform2(0.02f32..0.7),
        round in any::<bool>(), samples in prop::collection::vec(prop::array::uniform2(-1.0f32..1.0), 200),
    ) {
        let mut model = room([4.0, 4.0]);
        let shape = if round {
            Shape::Cylinder { radius: half[0], half_height: 0.5 }
        } else {
            Shape::Cuboid { half: [half[0], half[1], 0.5] }
        };
        let thing = part(shape, Pose::yawed([position[0], position[1], 0.5], yaw));
        model.shell.push(thing);
        let map = NavMap::new(&model);
        for [u, v] in samples {
            let point = [position[0] + u, position[1] + v];
            if inside(&thing, [point[0], point[1], 0.5], -2e-3) {
                prop_assert!(map.occupied(point), "{point:?} is inside");
            }
            if !inside(&thing, [point[0], point[1], 0.5], 0.072) {
                let [x, y] = point;
                let by_wall = x < 0.12 || y < 0.12 || x > 3.88 || y > 3.88;
                prop_assert!(by_wall || !map.occupied(point), "{point:?} is more than a cell away");
            }
            if let Some(cell) = map.grid.cell(point).filter(|cell| map.grid.is_free(*cell)) {
                let [x, y] = map.grid.center(cell);
                for degrees in (0..360).step_by(5) {
                    let (sin, cos) = (libm::sinf((degrees as f32).to_radians()), libm::cosf((degrees as f32).to_radians()));
                    let rim = [x + 0.198 * cos, y + 0.198 * sin, 0.5];
                    prop_assert!(!inside(&thing, rim, -2e-3) && !inside(&thing, [x, y, 0.5], 0.0), "the base at {x}, {y} collides");
                }
            }
        }
    }

    #[test]
    fn viewpoints_are_sound(
        tables in prop::collection::vec((0.2f32..5.0, 0.2f32..4.0, 0.4f32..1.6, 0.4f32..1.2, 0.3f32..1.0), 1..7),
        boxes in prop::collection::vec((0.2f32..5.0, 0.2f32..4.0), 0..3),
        robot in (0.3f32..5.7, 0.3f32..4.7),
    ) {
        let mut model = room([6.0, 5.0]);
        for (x, y, width, depth, z) in tables {
            model.furniture.push(table([x, y], [(x + width).min(5.9), (y + depth).min(4.9)], z));
        }
        model.furniture.extend(boxes.into_iter().map(|(x, y)| fridge([x, y])));
        let map = NavMap::new(&model);
        prop_assert_eq!(&map, &NavMap::new(&model.clone()));
        let Some(robot) = map.free_near([robot.0, robot.1]) else { return Ok(()) };
        for (index, furniture) in model.furniture.iter().enumerate() {
            let found = map.viewpoint(&model, robot, index);
            prop_assert_eq!(&found, &map.viewpoint(&model, robot, index));
            let Surface { min, max, z, .. } = furniture.surface;
            let over = [min[0] + (max[0] - min[0]) * 0.5, min[1] + (max[1] - min[1]) * 0.5, z + 0.02];
            let target = furniture.door.as_ref().map_or(over, |door| door.center);
            let Some(found) = found else { continue };
            prop_assert!(map.standable(found.base));
            prop_assert_eq!(map.path_length(robot, found.base), Some(found.path_length_m));
            prop_assert_eq!(found.camera.position, [found.base[0], found.base[1], CAMERA_HEIGHT_M]);
            prop_assert!(map.line_of_sight(found.camera.position, target, Some(index)));
            let away = gap(found.base, furniture.bounds);
            prop_assert!((0.3..=2.0).contains(&away), "{away} m away");
            if furniture.door.is_some() {
                let (dx, dy) = (found.base[0] - target[0], found.base[1] - target[1]);
                prop_assert!(dx > 0.0 && dy.abs() < 1.7321 * dx + 1e-4, "not in front");
            }
            // Nearer or farther only where no cell between 0.6 and 1.4 m would do.
            if !(STANDOFF_M..=1.4).contains(&away) {
                for cell in (0..map.grid.len()).filter(|cell| map.grid.is_free(*cell)) {
                    let base = map.grid.center(cell);
                    let away = gap(base, furniture.bounds);
                    let in_front = furniture.door.is_none() || {
                        let (dx, dy) = (base[0] - target[0], base[1] - target[1]);
                        dx > 0.0 && dy.abs() < 1.732 * dx - 1e-4
                    };
                    let better = (STANDOFF_M..=1.4).contains(&away)
                        && in_front
                        && map.line_of_sight([base[0], base[1], CAMERA_HEIGHT_M], target, Some(index))
                        && map.path_length(robot, base).is_some();
                    prop_assert!(!better, "{base:?} is at the standoff");
                }
            }
            // What stands in view there can be reached or at least approached soundly.
            if let Some(approach) = map.approach(found.base, over, Some(index)) {
                let level = distance_2d(approach.base, [over[0], over[1]]);
                prop_assert!(level <= 1.3 && map.standable(approach.base));
                prop_assert!(map.line_of_sight(approach.camera.position, over, Some(index)));
            }
        }
    }

    #[test]
    fn odd_points_are_answered(values in prop::array::uniform6(any::<f32>()), radius in any::<f32>()) {
        let mut model = two_rooms(1.0);
        model.furniture.push(table([1.0, 1.0], [2.0, 1.6], 0.7));
        let map = NavMap::new(&model);
        let [a, b, c, d, e, f] = values;
        for from in [[a, b], [f32::NAN, b], [f32::INFINITY, 1.0], [1.0, f32::NEG_INFINITY], [3e38, -3e38], [1.0, 3.0]] {
            let _ = (map.path(from, [c, d]), map.path_length([c, d], from), map.occupied(from), map.reachable_area_m2(from));
            let _ = (map.viewpoint(&model, from, 0), map.approach(from, [a, b, c], Some(7)), map.approach([1.0, 3.0], [a, b, c], None));
            prop_assert!(map.free_near(from).is_none_or(|free| map.standable(free)));
            prop_assert_eq!(map.free_near(from).is_some(), from.iter().all(|value| value.is_finite()));
            prop_assert!(!map.cells_free_in_disc(from, f32::NAN) && !map.cells_free_in_disc(from, 100.0));
            let _ = (map.cells_free_in_disc(from, radius), map.line_of_sight([a, b, c], [d, e, f], Some(3)));
        }
        // A scene of such numbers gives a map of some kind.
        model.bounds = [[a, b], [c, d]];
        model.shell.push(part(Shape::Cuboid { half: [a, b, c] }, Pose { position: [d, e, f], rotation: [a, b, c, d] }));
        let map = NavMap::new(&model);
        let _ = (map.path_length([a, b], [1.0, 1.0]), map.viewpoint(&model, [1.0, 1.0], 0), map.line_of_sight([a; 3], [b; 3], None));
    }
}

#[test]
fn walls_block_and_openings_do_not() {
    let (left, right) = ([1.0, 1.0], [5.0, 1.0]);
    let closed = NavMap::new(&two_rooms(0.0));
    assert_eq!(closed.path_length(left, right), None);
    assert_eq!(closed.path(left, right), None);
    assert!(!closed.line_of_sight([1.0, 1.0, 1.4], [5.0, 1.0, 1.4], None));
    let open = NavMap::new(&two_rooms(0.8));
    let length = open.path_length(left, right).unwrap();
    // Around the corner of the opening, at least as far as the crow flies and at most
    // as octile steps go.
    let (air, octile) = (
        2.0 * libm::hypotf(2.0, 1.2),
        2.0 * (2.0 + 0.414 * 1.5) + 0.2,
    );
    assert!((air..octile).contains(&length), "{length}");
    let path = open.path(left, right).unwrap();
    assert!(
        path.iter()
            .any(|[x, y]| (x - 3.0).abs() < 0.05 && (2.2..2.6).contains(y))
    );
    let walked: f32 = path
        .windows(2)
        .map(|pair| distance_2d(pair[0], pair[1]))
        .sum();
    assert!((walked - length).abs() < 1e-3);
    assert!(open.reachable_area_m2(left) > 1.8 * closed.reachable_area_m2(left));
    // The robot does not fit through 0.35 m.
    assert_eq!(NavMap::new(&two_rooms(0.35)).path_length(left, right), None);
    // Above the robot is nothing to bump into.
    let mut lintel = two_rooms(0.8);
    lintel.shell.push(block([2.95, 2.0, 1.5], [3.05, 2.8, 2.5]));
    assert_eq!(NavMap::new(&lintel).path_length(left, right), Some(length));
}

#[test]
fn floor_and_rugs_are_free_and_the_rest_is_not() {
    let mut model = room([4.0, 3.0]);
    let rug = block([1.0, 1.0, 0.0], [2.0, 2.0, 0.015]);
    model.furniture.push(furniture(
        vec![rug],
        Surface {
            min: [1.0; 2],
            max: [2.0; 2],
            z: 0.015,
            clearance: 2.0,
        },
        [[1.0, 1.0, 0.0], [2.0, 2.0, 0.015]],
    ));
    let mut ghost = table([2.5, 1.0], [3.5, 2.0], 0.7);
    ghost.present = false;
    model.furniture.push(ghost);
    let map = NavMap::new(&model);
    assert!(map.standable([1.5, 1.5]) && map.standable([3.0, 1.5]));
    assert_eq!(map.viewpoint(&model, [1.5, 1.5], 1), None);
    assert!(map.occupied([0.01, 1.0]) && map.occupied([-1.0, 1.0]) && !map.occupied([0.1, 1.0]));
    assert!(!map.standable([0.2, 1.0]) && map.standable([0.31, 1.0]));
    assert!(map.cells_free_in_disc([1.0, 1.0], 0.9) && !map.cells_free_in_disc([1.0, 1.0], 1.0));
    // A blocked end is moved, one far away is not.
    assert_eq!(map.path_length([0.1, 1.02], [0.26, 1.02]), Some(0.0));
    assert_eq!(map.path_length([-2.0, 1.0], [0.31, 1.0]), None);
    assert!(
        map.free_near([-2.0, 1.0])
            .is_some_and(|[x, y]| (x - 0.275).abs() < 0.03 && (y - 1.0).abs() < 0.03)
    );
    assert_eq!(map.free_near([1.51, 1.52]), Some([1.51, 1.52]));
}

#[test]
fn a_table_is_seen_from_its_nearer_side() {
    let mut model = room([6.0, 5.0]);
    model.furniture.push(table([2.4, 2.0], [3.6, 2.8], 0.7));
    let map = NavMap::new(&model);
    let from_left = map.viewpoint(&model, [0.6, 2.4], 0).unwrap();
    let from_right = map.viewpoint(&model, [5.4, 2.4], 0).unwrap();
    assert!(
        from_left.base[0] < 1.81 && from_right.base[0] > 4.19,
        "{from_left:?} {from_right:?}"
    );
    assert!(
        (STANDOFF_M..STANDOFF_M + 0.2).contains(&gap(from_left.base, model.furniture[0].bounds))
    );
    // All four corners are in the image, and the centre is in the middle of it.
    for corner in [[2.4, 2.0], [3.6, 2.0], [2.4, 2.8], [3.6, 2.8]] {
        let [u, v] = from_left
            .camera
            .project([corner[0], corner[1], 0.7])
            .unwrap();
        assert!((0.0..=640.0).contains(&u) && (0.0..=480.0).contains(&v));
    }
    let [u, v] = from_left.camera.project([3.0, 2.4, 0.72]).unwrap();
    assert!((u - 320.0).abs() < 0.1 && (v - 240.0).abs() < 0.1);
    assert_eq!(map.viewpoint(&model, [0.6, 2.4], 1), None);
}

#[test]
fn a_sofa_is_looked_at_past_its_back_only_if_need_be() {
    let mut model = room([6.0, 5.0]);
    let mut sofa = table([2.0, 2.0], [4.0, 2.8], 0.4);
    sofa.parts.push(block([2.0, 1.8, 0.0], [4.0, 2.0, 1.4]));
    sofa.bounds = [[2.0, 1.8, 0.0], [4.0, 2.8, 1.4]];
    model.furniture.push(sofa);
    let map = NavMap::new(&model);
    let behind = [3.0, 0.6];
    let viewpoint = map.viewpoint(&model, behind, 0).unwrap();
    assert!(viewpoint.base[1] > 1.8, "{viewpoint:?}");
    assert!(map.line_of_sight(viewpoint.camera.position, [3.0, 2.4, 0.42], None));
    // With a wall along the other sides it is better than nothing.
    model.shell.push(block([1.5, 2.85, 0.0], [4.5, 3.0, 2.5]));
    model.shell.push(block([1.5, 1.8, 0.0], [1.9, 3.0, 2.5]));
    model.shell.push(block([4.1, 1.8, 0.0], [4.5, 3.0, 2.5]));
    let viewpoint = NavMap::new(&model).viewpoint(&model, behind, 0).unwrap();
    assert!(viewpoint.base[1] < 1.8, "{viewpoint:?}");
}

#[test]
fn a_fridge_is_opened_from_the_front() {
    let mut model = two_rooms(0.8);
    model.furniture.push(fridge([0.1, 0.4]));
    let map = NavMap::new(&model);
    let viewpoint = map.viewpoint(&model, [5.0, 3.0], 0).unwrap();
    let [x, y] = viewpoint.base;
    assert!(x > 0.7 + STANDOFF_M - 1e-3 && (y - 0.7).abs() < 1.7321 * (x - 0.7));
    // Door centre and interior are both in the image.
    for point in [[0.7, 0.7, 0.4], [0.4, 0.7, 0.3]] {
        let [u, v] = viewpoint.camera.project(point).unwrap();
        assert!((0.0..=640.0).contains(&u) && (0.0..=480.0).contains(&v));
    }
    // What is inside is reached from the front, too, and its door stands in nobody's way.
    let approach = map
        .approach(viewpoint.base, [0.4, 0.7, 0.35], Some(0))
        .unwrap();
    assert!(approach.base[0] > 0.7 && distance_2d(approach.base, [0.4, 0.7]) <= REACH_M);
    assert!(map.line_of_sight([1.5, 0.7, 0.4], [0.4, 0.7, 0.4], None));
    // A table right before it leaves no room in front.
    model.furniture.push(table([0.75, 0.1], [2.9, 2.9], 0.7));
    model.furniture.push(table([0.1, 1.1], [0.75, 2.9], 0.7));
    let map = NavMap::new(&model);
    assert_eq!(map.viewpoint(&model, [5.0, 3.0], 0), None);
    assert_eq!(map.approach([5.0, 3.0], [0.4, 0.7, 0.35], Some(0)), None);
}

#[test]
fn tight_corners_are_looked_at_from_nearer() {
    let mut model = room([2.0, 1.5]);
    model.furniture.push(table([0.05, 0.05], [1.3, 1.45], 0.7));
    let map = NavMap::new(&model);
    let viewpoint = map.viewpoint(&model, [1.65, 0.7], 0).unwrap();
    assert!((0.3..STANDOFF_M).contains(&gap(viewpoint.base, model.furniture[0].bounds)));
}

#[test]
fn an_approach_is_no_farther_than_needed() {
    let mut model = room([6.0, 5.0]);
    model.furniture.push(table([2.4, 2.0], [3.6, 2.8], 0.7));
    let map = NavMap::new(&model);
    let target = [2.6, 2.4, 0.75];
    let robot = map.viewpoint(&model, [0.6, 2.4], 0).unwrap().base;
    let near = map.approach(robot, target, Some(0)).unwrap();
    let level = distance_2d(near.base, [2.6, 2.4]);
    assert!((0.35..=REACH_M).contains(&level));
    // Brute force: no free cell within reach and in sight has a shorter way.
    for cell in (0..map.grid.len()).filter(|cell| map.grid.is_free(*cell)) {
        let base = map.grid.center(cell);
        let good = (0.35..=REACH_M).contains(&distance_2d(base, [2.6, 2.4]))
            && map.line_of_sight([base[0], base[1], CAMERA_HEIGHT_M], target, None);
        assert!(!good || map.path_length(robot, base).unwrap() >= near.path_length_m);
    }
    // Already there: it stays.
    let stay = map.approach(near.base, target, Some(0)).unwrap();
    assert_eq!((stay.base, stay.path_length_m), (near.base, 0.0));
    // The middle of a table too wide for the arm.
    model.furniture[0] = table([1.5, 1.0], [4.5, 4.0], 0.7);
    let map = NavMap::new(&model);
    assert_eq!(map.approach([0.6, 2.4], [3.0, 2.5, 0.75], Some(0)), None);
    let stretched = map.approach([0.6, 2.4], [2.4, 2.5, 0.75], Some(0)).unwrap();
    assert!((REACH_M..=1.3).contains(&distance_2d(stretched.base, [2.4, 2.5])));
}

#[test]
fn other_furniture_hides_and_the_own_does_not() {
    let mut model = room([6.0, 5.0]);
    model.furniture.push(table([4.0, 2.0], [5.0, 3.0], 0.7));
    model.furniture.push(furniture(
        vec![block([3.0, 0.1, 0.0], [3.2, 4.9, 2.0])],
        Surface {
            min: [3.0, 0.1],
            max: [3.2, 4.9],
            z: 2.0,
            clearance: 0.5,
        },
        [[3.0, 0.1, 0.0], [3.2, 4.9, 2.0]],
    ));
    let map = NavMap::new(&model);
    let (eye, target) = ([2.0, 2.5, 1.4], [4.5, 2.5, 0.72]);
    assert!(!map.line_of_sight(eye, target, Some(0)) && !map.line_of_sight(eye, target, None));
    assert!(map.line_of_sight(eye, target, Some(1)));
    // Through the top from below.
    let below = [4.5, 2.5, 0.3];
    assert!(!map.line_of_sight(below, target, None) && map.line_of_sight(below, target, Some(0)));
    assert!(!map.line_of_sight([f32::NAN; 3], target, None));
    // The shelf parts the room: from the left the table cannot be reached.
    assert_eq!(map.viewpoint(&model, [1.0, 2.5], 0), None);
}
