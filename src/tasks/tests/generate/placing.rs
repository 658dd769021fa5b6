//! What holds of every placement, checked over the parts of the scene themselves and not over the
//! cells that placing looks at.

use std::{collections::BTreeSet, sync::Arc};

use reel_sim::{
    geometry::{Part, Shape},
    model::scene_model,
};
use reel_tasks::generate::task::{
    SceneSites, Side, Site,
    placement::{Placement, PlacementError, is_valid, nearest_side, static_filter},
};
use reel_tasks::{Stream, home_scene, library::objects};

/// Distances from edges and neighbours, in metres (docs/spec.md#placement).
const MARGIN_M: f64 = 0.05;
const BAND_M: f64 = 0.5;
const STAND_RADIUS_M: f64 = 0.05;
/// Number of placements after which the test stops.
const PLACEMENTS: usize = 10_000;
/// For sums of rounded numbers, in metres.
const TOLERANCE_M: f64 = 1e-6;

/// Lower and upper corner of a solid part.
fn bounds(part: &Part) -> [[f64; 3]; 2] {
    let half = match part.shape {
        Shape::Cuboid { half } => half,
        Shape::Ball { radius } => [radius; 3],
        Shape::Cylinder {
            radius,
            half_height,
        }
        | Shape::Cone {
            radius,
            half_height,
        } => [radius, radius, half_height],
        Shape::Capsule {
            radius,
            half_height,
        } => [radius, radius, radius + half_height],
    };
    let axes =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| part.pose.rotate(axis));
    let reach = [0, 1, 2].map(|out| {
        (0..3)
            .map(|own| half[own] * axes[own][out].abs())
            .sum::<f32>()
    });
    let at = part.pose.position;
    [
        [0, 1, 2].map(|axis| f64::from(at[axis] - reach[axis])),
        [0, 1, 2].map(|axis| f64::from(at[axis] + reach[axis])),
    ]
}

/// Whether a disc between two heights meets a part.
fn meets(part: &Part, centre: [f64; 2], radius: f64, [from, to]: [f64; 2]) -> bool {
    let [low, high] = bounds(part);
    let beyond = |axis: usize| {
        (low[axis] - centre[axis])
            .max(centre[axis] - high[axis])
            .max(0.0)
    };
    // Part of a millimetre does not count: furniture stands against walls.
    let radius = radius - 1e-3;
    high[2] > from && low[2] < to && beyond(0).powi(2) + beyond(1).powi(2) < radius.max(0.0).powi(2)
}

#[test]
fn ten_thousand_placements_keep_margin_band_stand_radius_and_free_footprint() {
    let ground = SceneSites::survey(Arc::new(home_scene()));
    let model = scene_model(&ground.scene, &BTreeSet::new());
    let solid = |part: &&Part| part.solid;
    let mut placed = 0;
    let mut misfits = BTreeSet::new();
    for round in 0.. {
        if placed >= PLACEMENTS {
            break;
        }
        let mut stream = Stream::new(1, "placements", round);
        let site: &Site = stream.pick(&ground.sites).unwrap();
        let own = ground
            .scene
            .receptacles
            .iter()
            .position(|one| one.id == site.receptacle.id)
            .unwrap();
        let surface = site.surface();
        let mut placement = Placement::default();
        let mut here: Vec<([f64; 3], [f64; 3])> = Vec::new();
        for _ in 0..1 + stream.below(6) {
            let size = stream.pick(objects()).unwrap().size;
            let at = match placement.place(site, size, &mut stream) {
                Ok(at) => at,
                Err(misfit) => {
                    misfits.insert(misfit);
                    continue;
                }
            };
            let place = format!(
                "round {round}: {size:?} at {at:?} on {}",
                site.receptacle.id
            );
            for axis in 0..2 {
                let rim = (at[axis] - size[axis] / 2.0 - surface.min[axis])
                    .min(surface.max[axis] - at[axis] - size[axis] / 2.0);
                assert!(rim >= MARGIN_M - TOLERANCE_M, "{place}: rim {rim}");
            }
            assert!(
                (at[2] - site.receptacle.surface_height() - size[2] / 2.0).abs() < TOLERANCE_M,
                "{place}"
            );
            for (other, other_size) in &here {
                let gap = |axis: usize| {
                    (at[axis] - other[axis]).abs() - (size[axis] + other_size[axis]) / 2.0
                };
                assert!(
                    gap(0).max(gap(1)) >= MARGIN_M - TOLERANCE_M,
                    "{place}: {other:?}"
                );
            }

            let centre = [at[0], at[1]];
            let sides = Side::ALL
                .into_iter()
                .filter(|side| site.front.is_none_or(|front| front == *side));
            let side = sides
                .min_by(|a, b| {
                    a.distance(&surface, centre)
                        .total_cmp(&b.distance(&surface, centre))
                })
                .unwrap();
            assert!(
                side.distance(&surface, centre) <= BAND_M + TOLERANCE_M,
                "{place}"
            );
            let stand = side.nearest(&surface, centre);
            let others = model
                .furniture
                .iter()
                .enumerate()
                .filter(|(index, _)| *index != own);
            let around = model
                .shell
                .iter()
                .chain(others.flat_map(|(_, furniture)| &furniture.parts))
                .filter(solid);
            for part in around {
                assert!(
                    !meets(part, stand, STAND_RADIUS_M, [0.02, 1.5]),
                    "{place}: {part:?} stands at its edge"
                );
            }
            let radius = 0.5 * (size[0].powi(2) + size[1].powi(2)).sqrt();
            let top = site.receptacle.surface_height();
            for part in model
                .shell
                .iter()
                .chain(
                    model
                        .furniture
                        .iter()
                        .flat_map(|furniture| &furniture.parts),
                )
                .filter(solid)
            {
                assert!(
                    !meets(part, centre, radius, [top + 0.01, top + size[2]]),
                    "{place}: {part:?} is in its way"
                );
            }
            here.push((at, size));
            placed += 1;
        }
    }
    assert!(misfits.contains(&PlacementError::OutOfReach), "{misfits:?}");
}

#[test]
fn nobody_reaches_over_an_edge_that_something_stands_at() {
    let reached = |gap: f64| {
        let mut scene = home_scene();
        let at = |id: &str| {
            scene
                .receptacles
                .iter()
                .position(|one| one.id.as_str() == id)
                .unwrap()
        };
        let (table, other) = (at("table_1"), at("table_2"));
        // Beside the line between two cells of the map, so that the other piece lies
        // in the next one.
        let edge = 5.98;
        scene.receptacles[table].surface_max[0] = edge;
        let moved = &mut scene.receptacles[other];
        let width = moved.surface_max[0] - moved.surface_min[0];
        (moved.surface_min[0], moved.surface_max[0]) = (edge + gap, edge + gap + width);
        let ys = [
            scene.receptacles[table].surface_min[1],
            scene.receptacles[table].surface_max[1],
        ];
        (
            scene.receptacles[other].surface_min[1],
            scene.receptacles[other].surface_max[1],
        ) = (ys[0], ys[1]);
        let ground = SceneSites::survey(Arc::new(scene));
        let site = ground
            .sites
            .iter()
            .find(|site| site.receptacle.id.as_str() == "table_1")
            .unwrap();
        is_valid(site, [edge - 0.1, (ys[0] + ys[1]) / 2.0], [0.1, 0.1, 0.1])
    };
    assert_eq!([0.01, 0.03, 0.12].map(reached), [false, false, true]);
}

#[test]
fn what_stands_behind_a_door_is_reached_through_it() {
    let ground = SceneSites::survey(Arc::new(home_scene()));
    let (behind, free): (Vec<&Site>, Vec<&Site>) = ground
        .sites
        .iter()
        .partition(|site| site.receptacle.door.exists());
    assert!(behind.len() >= 3 && free.iter().all(|site| site.front.is_none()));
    for site in behind {
        let (front, surface) = (site.front.unwrap(), site.surface());
        let corners = [
            surface.min,
            [surface.min[0], surface.max[1]],
            [surface.max[0], surface.min[1]],
            surface.max,
        ];
        assert!(
            corners
                .iter()
                .all(|corner| nearest_side(site, *corner).0 == front),
            "{}",
            site.receptacle.id
        );
        let mut stream = Stream::new(1, "behind a door", 0);
        assert!(
            Placement::default()
                .place(site, [0.08, 0.08, 0.1], &mut stream)
                .is_ok(),
            "{}",
            site.receptacle.id
        );
    }
}

#[test]
fn later_objects_stand_as_far_from_the_others_as_they_can() {
    let ground = SceneSites::survey(Arc::new(home_scene()));
    let site = ground
        .sites
        .iter()
        .find(|site| site.receptacle.id.as_str() == "table_1")
        .unwrap();
    for seed in 0..20 {
        let mut stream = Stream::new(seed, "spread", 0);
        let mut placement = Placement::default();
        let [a, b] = [(); 2].map(|()| placement.place(site, [0.1, 0.1, 0.1], &mut stream).unwrap());
        // The table is 1.3 m wide: whoever stands first, there is a free end half of that away.
        assert!(
            (a[0] - b[0]).hypot(a[1] - b[1]) > 0.5,
            "seed {seed}: {a:?} {b:?}"
        );
    }
}

#[test]
fn the_static_filter_says_what_is_wrong() {
    let ground = SceneSites::survey(Arc::new(home_scene()));
    let site = |id: &str| {
        ground
            .sites
            .iter()
            .find(|site| site.receptacle.id.as_str() == id)
            .unwrap()
    };
    let filter = |id: &str, sizes: &[[f64; 3]]| {
        static_filter(site(id), sizes, &mut Stream::new(1, "static", 0))
    };
    assert_eq!(filter("table_2", &[[0.1, 0.1, 0.1]; 3]), Ok(()));
    assert_eq!(
        filter("table_2", &[[0.95, 0.2, 0.1]]),
        Err(PlacementError::TooLarge)
    );
    assert_eq!(
        filter("microwave_1", &[[0.1, 0.1, 0.3]]),
        Err(PlacementError::TooTall)
    );
    assert_eq!(
        filter("table_2", &[[0.2, 0.2, 0.1]; 30]),
        Err(PlacementError::TriesExceeded)
    );
}
