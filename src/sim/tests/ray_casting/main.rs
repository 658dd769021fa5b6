//! Instance ids and depth of frames against ray casting by parry, which shares nothing with the
//! rasterizer but the triangles: 1,000 random pixels of each of 50 frames.

use std::sync::Arc;

use rapier3d::parry::{
    math::Vector,
    query::{Ray, RayCast as _},
    shape::TriMesh,
};
use reel_sim::{
    CallContext, PreparedTask, Simulator,
    geometry::{Camera, FOCAL_PX},
    render::TriangleSurface,
};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, Profile, Tool};

const FRAMES: usize = 50;
const PIXELS: usize = 1_000;
/// Of the pixels so many in a thousand may show another instance.
const OTHER_MAX: usize = 1;
/// How far depth may be off, in metres: a millimetre, and half of one for rounding.
const DEPTH_M: f32 = 0.0015;
/// Neighbours whose depth differs more, in millimetres, are on two sides of an edge.
const EDGE_MM: i32 = 30;

#[test]
fn ids_and_depth_are_those_of_ray_casting() {
    let (mut random, mut frames) = (0x5eed_u64, 0);
    let (mut other, mut inner, mut far, mut worst) = (0, 0, 0, 0.0_f32);
    'tasks: for task in reel_vectors::episodes::tasks() {
        let scene = Arc::new(reel_tasks::home_scene());
        let stage = PreparedTask::new(scene.clone(), task.clone());
        let mut simulator = Simulator::new(stage, Profile::Paper, 1);
        for receptacle in &scene.receptacles {
            let receptacle = receptacle.id.clone();
            let gone = simulator.call(&Tool::NavTo { receptacle }, CallContext::default());
            if !gone.outcome.is_ok() {
                continue;
            }
            let camera = simulator.camera();
            let frame = simulator.render_from(&camera);
            let rays = Rays::of(&simulator);
            for _ in 0..PIXELS {
                let pixel = draw(&mut random) as usize % (FRAME_WIDTH * FRAME_HEIGHT);
                let (instance, depth) = rays.cast(&camera, pixel);
                other += usize::from(frame.ids[pixel] != instance);
                if frame.ids[pixel] == instance && is_inner(&frame, pixel) {
                    let error = (f32::from(frame.depth_mm[pixel]) / 1000.0 - depth).abs();
                    inner += 1;
                    far += usize::from(error > DEPTH_M);
                    worst = worst.max(error);
                }
            }
            frames += 1;
            if frames == FRAMES {
                break 'tasks;
            }
        }
    }
    println!(
        "{frames} frames: {other} of {} pixels of another instance; of {inner} away from edges {far} off by more than 1 mm, at most {worst} m",
        frames * PIXELS
    );
    assert_eq!(frames, FRAMES);
    assert!(
        1000 * other <= OTHER_MAX * frames * PIXELS,
        "{other} pixels show something else"
    );
    assert!(
        inner > frames * PIXELS / 2,
        "{inner} pixels are away from edges"
    );
    assert_eq!(far, 0, "at most {worst} m");
}

/// The surfaces of each instance as one mesh.
struct Rays(Vec<(u16, TriMesh)>);

impl Rays {
    fn of(simulator: &Simulator) -> Self {
        let surfaces = simulator.surfaces();
        let instances = surfaces.chunk_by(|a, b| a.instance == b.instance);
        let mesh = |surfaces: &[TriangleSurface]| {
            let (mut corners, mut triangles) = (Vec::new(), Vec::new());
            for surface in surfaces {
                let first = corners.len() as u32;
                corners.extend(surface.corners.iter().map(|corner| Vector::from(*corner)));
                let moved = surface.triangles.iter();
                triangles.extend(moved.map(|it| it.map(|corner| first + corner)));
            }
            (
                surfaces[0].instance,
                TriMesh::new(corners, triangles).unwrap(),
            )
        };
        Self(instances.map(mesh).collect())
    }

    /// Instance and depth along the optical axis, in metres, of what the middle of a pixel shows.
    fn cast(&self, camera: &Camera, pixel: usize) -> (u16, f32) {
        let [x, y] = [pixel % FRAME_WIDTH, pixel / FRAME_WIDTH].map(|at| at as f32 + 0.5);
        let [right, down, forward] = camera.axes();
        let (u, v) = (
            (x - FRAME_WIDTH as f32 / 2.0) / FOCAL_PX,
            (y - FRAME_HEIGHT as f32 / 2.0) / FOCAL_PX,
        );
        let toward = [0, 1, 2].map(|axis| right[axis] * u + down[axis] * v + forward[axis]);
        // Its length is one along the optical axis, so that the time of impact is depth.
        let ray = Ray::new(Vector::from(camera.position), Vector::from(toward));
        let mut nearest = (0, f32::MAX);
        for (instance, mesh) in &self.0 {
            match mesh.cast_local_ray(&ray, nearest.1, true) {
                Some(depth) if depth < nearest.1 => nearest = (*instance, depth),
                _ => {}
            }
        }
        nearest
    }
}

/// Whether all pixels around show the same instance in about the same depth.
fn is_inner(frame: &Frame, pixel: usize) -> bool {
    let (x, y) = (pixel % FRAME_WIDTH, pixel / FRAME_WIDTH);
    let inside = (1..FRAME_WIDTH - 1).contains(&x) && (1..FRAME_HEIGHT - 1).contains(&y);
    let like = |other: usize| {
        let step = i32::from(frame.depth_mm[pixel]) - i32::from(frame.depth_mm[other]);
        frame.ids[other] == frame.ids[pixel] && step.abs() < EDGE_MM
    };
    inside
        && (y - 1..=y + 1).all(|row| (x - 1..=x + 1).all(|column| like(row * FRAME_WIDTH + column)))
}

/// The next number of a small generator (xorshift).
fn draw(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}
