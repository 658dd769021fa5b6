//! Images against a ray caster that knows the shapes analytically, and against themselves.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};

use super::{block::WITHOUT_VECTORS, *};
use crate::geometry::{FOCAL_PX, Pattern, Shape, add, sub};

const TAU: f32 = core::f32::consts::TAU;

fn part(shape: Shape, pose: Pose, color: [u8; 3]) -> Part {
    Part {
        shape,
        pose,
        color,
        accent: [240, 230, 200],
        pattern: Pattern::Plain,
        solid: true,
    }
}

/// Twenty-two single-part things of every shape and pattern on and around a table.
fn scene() -> (Camera, Vec<(Part, Pose)>) {
    let mut things = vec![
        (
            part(
                Shape::Cuboid {
                    half: [4.0, 4.0, 0.1],
                },
                Pose::IDENTITY,
                [170, 140, 110],
            ),
            Pose::at([0.0, 0.0, -0.1]),
        ),
        (
            part(
                Shape::Cuboid {
                    half: [0.1, 4.0, 1.4],
                },
                Pose::IDENTITY,
                [210, 214, 206],
            ),
            Pose::at([4.1, 0.0, 1.4]),
        ),
        (
            part(
                Shape::Cuboid {
                    half: [0.5, 0.9, 0.03],
                },
                Pose::IDENTITY,
                [140, 96, 60],
            ),
            Pose::at([1.6, 0.0, 0.72]),
        ),
    ];
    for i in 0..19u8 {
        let (row, column) = (f32::from(i / 7), f32::from(i % 7));
        let position = [1.25 + 0.3 * row, -0.75 + 0.25 * column, 0.85];
        let shape = match i % 5 {
            0 => Shape::Cuboid {
                half: [0.05, 0.08, 0.1],
            },
            1 => Shape::Cylinder {
                radius: 0.06,
                half_height: 0.1,
            },
            2 => Shape::Ball { radius: 0.08 },
            3 => Shape::Capsule {
                radius: 0.05,
                half_height: 0.05,
            },
            _ => Shape::Cone {
                radius: 0.08,
                half_height: 0.09,
            },
        };
        let angle = f32::from(i) * 0.7;
        let tilt = Pose {
            position: [0.0; 3],
            rotation: [libm::sinf(0.2), 0.0, 0.0, libm::cosf(0.2)],
        };
        let mut part = part(
            shape,
            tilt,
            [
                i.wrapping_mul(13) ^ 0xa0,
                i.wrapping_mul(41) ^ 0x70,
                i.wrapping_mul(67),
            ],
        );
        part.pattern = [
            Pattern::Plain,
            Pattern::Stripes,
            Pattern::Dots,
            Pattern::Grain,
            Pattern::Glossy,
        ][usize::from(i / 4)];
        things.push((part, Pose::yawed(position, angle)));
    }
    (
        Camera::looking_at([0.1, 0.1, 1.45], [1.5, 0.0, 0.75]),
        things,
    )
}

fn drawables(things: &[(Part, Pose)]) -> Vec<Drawable<'_>> {
    let ids = 1..;
    things
        .iter()
        .zip(ids)
        .map(|((part, pose), entity)| Drawable {
            parts: core::slice::from_ref(part),
            mesh: None,
            pose: *pose,
            entity,
        })
        .collect()
}

/// Nearest hit of a ray with a shape around the origin; the parameter is in
/// lengths of the direction.
fn cast(shape: &Shape, origin: [f32; 3], direction: [f32; 3]) -> Option<f32> {
    let slab = |half: f32, axis: usize| {
        let (a, b) = (
            (-half - origin[axis]) / direction[axis],
            (half - origin[axis]) / direction[axis],
        );
        (a.min(b), a.max(b))
    };
    let quadratic = |a: f32, b: f32, c: f32| {
        let root = b * b - a * c;
        (root >= 0.0).then(|| [(-b - root.sqrt()) / a, (-b + root.sqrt()) / a])
    };
    let at = |t: f32| add(origin, direction.map(|d| d * t));
    let flat = |v: [f32; 3]| [v[0], v[1], 0.0];
    let ball = |centre: f32, radius: f32| {
        let o = sub(origin, [0.0, 0.0, centre]);
        quadratic(
            dot(direction, direction),
            dot(o, direction),
            dot(o, o) - radius * radius,
        )
    };
    let mut hits: Vec<f32> = Vec::new();
    match *shape {
        Shape::Cuboid { half } => {
            let spans = [0, 1, 2].map(|axis| slab(half[axis], axis));
            let near = spans.iter().map(|s| s.0).fold(f32::MIN, f32::max);
            let far = spans.iter().map(|s| s.1).fold(f32::MAX, f32::min);
            hits.extend((near <= far).then_some(near));
        }
        Shape::Ball { radius } => hits.extend(ball(0.0, radius).into_iter().flatten()),
        Shape::Cylinder {
            radius,
            half_height,
        }
        | Shape::Capsule {
            radius,
            half_height,
        } => {
            let (o, d) = (flat(origin), flat(direction));
            let wall = quadratic(dot(d, d), dot(o, d), dot(o, o) - radius * radius);
            hits.extend(
                wall.into_iter()
                    .flatten()
                    .filter(|&t| at(t)[2].abs() <= half_height),
            );
            if matches!(shape, Shape::Capsule { .. }) {
                hits.extend(
                    [-half_height, half_height]
                        .iter()
                        .filter_map(|&z| ball(z, radius))
                        .flatten(),
                );
            } else {
                let caps = slab(half_height, 2);
                hits.extend(
                    [caps.0, caps.1]
                        .iter()
                        .filter(|&&t| dot(flat(at(t)), flat(at(t))) <= radius * radius),
                );
            }
        }
        Shape::Cone {
            radius,
            half_height,
        } => {
            let slope = radius / (2.0 * half_height);
            let (o, d) = (flat(origin), flat(direction));
            let (oz, dz) = ((half_height - origin[2]) * slope, -direction[2] * slope);
            let wall = quadratic(
                dot(d, d) - dz * dz,
                dot(o, d) - oz * dz,
                dot(o, o) - oz * oz,
            );
            hits.extend(
                wall.into_iter()
                    .flatten()
                    .filter(|&t| at(t)[2].abs() <= half_height),
            );
            let base = (-half_height - origin[2]) / direction[2];
            hits.extend((dot(flat(at(base)), flat(at(base))) <= radius * radius).then_some(base));
        }
    }
    hits.into_iter()
        .filter(|&t| t >= raster::NEAR_M)
        .reduce(f32::min)
}

/// Entity and depth of the nearest thing in the middle of a pixel.
fn trace(camera: &Camera, things: &[(Part, Pose)], x: usize, y: usize) -> (u16, f32) {
    let axes = camera.axes();
    let (u, v) = (
        (x as f32 + 0.5 - 320.0) / FOCAL_PX,
        (y as f32 + 0.5 - 240.0) / FOCAL_PX,
    );
    let ray = [0, 1, 2].map(|k| axes[0][k] * u + axes[1][k] * v + axes[2][k]);
    let mut nearest = (0, f32::MAX);
    for (i, (part, pose)) in things.iter().enumerate() {
        let pose = pose.then(&part.pose);
        let back = Pose {
            position: [0.0; 3],
            rotation: [
                -pose.rotation[0],
                -pose.rotation[1],
                -pose.rotation[2],
                pose.rotation[3],
            ],
        };
        let hit = cast(
            &part.shape,
            back.rotate(sub(camera.position, pose.position)),
            back.rotate(ray),
        );
        if let Some(depth) = hit.filter(|&depth| depth < nearest.1) {
            nearest = (i as u16 + 1, depth);
        }
    }
    nearest
}

#[test]
fn images_agree_with_an_analytic_ray_caster() {
    let (camera, things) = scene();
    let frame = render(&camera, &drawables(&things), Detail::Full);
    let (mut agreeing, mut wrong_depths) = (0, 0);
    for y in 0..FRAME_HEIGHT {
        for x in 0..FRAME_WIDTH {
            let (entity, depth) = trace(&camera, &things, x, y);
            let at = y * FRAME_WIDTH + x;
            if frame.ids[at] == entity {
                agreeing += 1;
                if entity != 0 {
                    let difference = (f32::from(frame.depth_mm[at]) / 1000.0 - depth).abs();
                    wrong_depths += usize::from(difference > (depth * 0.01).max(0.005));
                }
            }
        }
    }
    let pixels = FRAME_WIDTH * FRAME_HEIGHT;
    eprintln!("{agreeing} of {pixels} pixels agree, {wrong_depths} of them with another depth");
    assert!(
        agreeing as f64 >= 0.995 * pixels as f64,
        "{agreeing} of {pixels} agree"
    );
    // On round silhouettes a facet's depth is steep; elsewhere all agree.
    assert!(
        wrong_depths as f64 <= 0.0005 * pixels as f64,
        "{wrong_depths} depths differ"
    );
    for entity in 1..=things.len() as u16 {
        assert!(
            frame.ids.contains(&entity),
            "thing {entity} is not seen, so the comparison says little"
        );
    }
}

#[test]
fn wider_vectors_compute_the_same_bits() {
    let (camera, things) = scene();
    for turn in 0..24 {
        let camera = Camera {
            position: add(camera.position, [0.05 * turn as f32, 0.0, 0.0]),
            yaw: camera.yaw + TAU / 24.0 * turn as f32,
            ..camera
        };
        let wide = render(&camera, &drawables(&things), Detail::Full);
        WITHOUT_VECTORS.set(true);
        let narrow = render(&camera, &drawables(&things), Detail::Full);
        WITHOUT_VECTORS.set(false);
        assert!(wide == narrow, "turn {turn}");
    }
}

#[test]
fn drawing_order_does_not_matter() {
    let (camera, things) = scene();
    let mut drawn = drawables(&things);
    let forward = render(&camera, &drawn, Detail::Full);
    drawn.reverse();
    assert!(forward == render(&camera, &drawn, Detail::Full));
    drawn.rotate_left(7);
    assert!(forward == render(&camera, &drawn, Detail::Full));
}

#[test]
fn frame_digests_are_stable() {
    let (camera, things) = scene();
    let frame = render(&camera, &drawables(&things), Detail::Full);
    let digests = frame.digests();
    let mut marked = frame.clone();
    let marks = [
        OverlayMark {
            number: 1,
            region: Region::Entity(4),
        },
        OverlayMark {
            number: 2,
            region: Region::Entity(9),
        },
        OverlayMark {
            number: 17,
            region: Region::Rectangle([40, 60, 200, 160]),
        },
    ];
    overlay(&mut marked, &marks);
    let found = [
        digests.rgb,
        digests.ids,
        digests.depth,
        marked.digests().rgb,
    ]
    .map(|digest| digest.to_string());
    assert_eq!(found, GOLDEN, "images changed: raise SIM_VERSION");
}

/// RGB, ids, depth, RGB with overlay.
const GOLDEN: [&str; 4] = [
    "ff7341a0a0de107e52e5a38e3262987dcc29bade16b4d43ea6ed0f871770af4f",
    "13f7db7579d5e908dddec99b5e9c86b72503b0e576f90c4d38b6f3a0afaa3328",
    "4f226c26764ea0106d86e7481ef83edca449ec6846b76d716aae75fb5214c74e",
    "0e58286e03fc0e9a8d5aa20395d79c87f2e55d149d3828d5ad0c2a17782c329f",
];

#[test]
fn a_camera_amid_things_sees_without_panic() {
    let (_, things) = scene();
    for i in 0..24u8 {
        let yaw = f32::from(i) * TAU / 24.0;
        // Inside the table top, on its edge, on the floor, inside a ball.
        for position in [
            [1.6, 0.0, 0.72],
            [1.1, 0.0, 0.75],
            [0.0, 0.0, 0.0],
            [1.25, -0.25, 0.85],
        ] {
            let camera = Camera {
                position,
                yaw,
                pitch: f32::from(i % 7) * 0.5 - 1.5,
            };
            render(&camera, &drawables(&things), Detail::Full);
        }
    }
}

#[test]
fn the_near_plane_cuts_a_floor_without_a_gap() {
    let floor = part(
        Shape::Cuboid {
            half: [50.0, 50.0, 0.1],
        },
        Pose::IDENTITY,
        [90, 90, 90],
    );
    let camera = Camera {
        position: [0.3, 0.2, 0.06],
        yaw: 0.4,
        pitch: 0.0,
    };
    let frame = render(
        &camera,
        &[Drawable {
            parts: &[floor],
            mesh: None,
            pose: Pose::at([0.0, 0.0, -0.1]),
            entity: 3,
        }],
        Detail::Full,
    );
    // Below the horizon all is floor; the lowest row sees it at 0.06 * 400 / 239.5 = 0.1 m.
    assert!(frame.ids[250 * FRAME_WIDTH..].iter().all(|&id| id == 3));
    assert!(frame.ids[..239 * FRAME_WIDTH].iter().all(|&id| id == 0));
    assert_eq!(frame.depth_mm[479 * FRAME_WIDTH + 320], 100);
}

#[test]
fn what_is_not_finite_or_not_in_view_draws_nothing() {
    let empty = render(
        &Camera {
            position: [0.0; 3],
            yaw: 0.0,
            pitch: 0.0,
        },
        &[],
        Detail::Full,
    );
    assert!(empty.ids.iter().all(|&id| id == 0));
    let ball = part(Shape::Ball { radius: 0.3 }, Pose::IDENTITY, [200, 20, 20]);
    let camera = Camera {
        position: [0.0; 3],
        yaw: 0.0,
        pitch: 0.0,
    };
    let mut poses = vec![
        Pose::at([-2.0, 0.0, 0.0]),
        Pose::at([2.0, 9.0, 0.0]),
        Pose::at([2.0, 0.0, -9.0]),
        Pose::at([1e30, 0.0, 0.0]),
    ];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for k in 0..3 {
            let mut pose = Pose::at([2.0, 0.0, 0.0]);
            pose.position[k] = bad;
            poses.push(pose);
        }
        poses.push(Pose {
            position: [2.0, 0.0, 0.0],
            rotation: [bad, 0.0, 0.0, 1.0],
        });
        let lost = Camera {
            position: [bad, 0.0, 0.0],
            yaw: bad,
            pitch: 0.0,
        };
        let frame = render(
            &lost,
            &[Drawable {
                parts: &[ball],
                mesh: None,
                pose: Pose::at([2.0, 0.0, 0.0]),
                entity: 1,
            }],
            Detail::Full,
        );
        assert!(frame.ids.iter().all(|&id| id == 0));
        let shapes = [
            Shape::Ball { radius: bad },
            Shape::Cuboid {
                half: [0.1, bad, 0.1],
            },
            Shape::Capsule {
                radius: 0.1,
                half_height: bad,
            },
        ];
        let broken = shapes.map(|shape| part(shape, Pose::IDENTITY, [1; 3]));
        assert!(
            render(
                &camera,
                &[Drawable {
                    parts: &broken,
                    mesh: None,
                    pose: Pose::at([2.0, 0.0, 0.0]),
                    entity: 1
                }],
                Detail::Full
            ) == empty
        );
    }
    for pose in poses {
        assert!(
            render(
                &camera,
                &[Drawable {
                    parts: &[ball],
                    mesh: None,
                    pose,
                    entity: 1
                }],
                Detail::Full
            ) == empty,
            "{pose:?} was drawn"
        );
    }
    let seen = render(
        &camera,
        &[Drawable {
            parts: &[ball],
            mesh: None,
            pose: Pose::at([2.0, 0.0, 0.0]),
            entity: 1,
        }],
        Detail::Full,
    );
    assert_eq!(seen.ids[240 * FRAME_WIDTH + 320], 1);
}

#[test]
fn patterns_show_their_second_colour() {
    let camera = Camera {
        position: [0.0; 3],
        yaw: 0.0,
        pitch: 0.0,
    };
    let image = |pattern| -> Frame {
        let mut block = part(
            Shape::Cuboid {
                half: [0.2, 0.4, 0.3],
            },
            Pose::IDENTITY,
            [200, 30, 30],
        );
        (block.pattern, block.accent) = (pattern, [20, 40, 220]);
        render(
            &camera,
            &[Drawable {
                parts: &[block],
                mesh: None,
                pose: Pose::at([1.5, 0.0, 0.0]),
                entity: 1,
            }],
            Detail::Full,
        )
    };
    let plain = image(Pattern::Plain);
    let blue = |frame: &Frame| {
        frame
            .rgb
            .as_chunks::<3>()
            .0
            .iter()
            .zip(&frame.ids)
            .filter(|(p, id)| **id == 1 && p[2] > p[0])
            .count()
    };
    assert_eq!(blue(&plain), 0);
    for pattern in [Pattern::Stripes, Pattern::Dots, Pattern::Grain] {
        let frame = image(pattern);
        assert_eq!((&frame.ids, &frame.depth_mm), (&plain.ids, &plain.depth_mm));
        assert!(blue(&frame) > 1000, "{pattern:?}: {}", blue(&frame));
    }
    assert!(image(Pattern::Glossy).rgb != plain.rgb);
}
