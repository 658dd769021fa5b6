//! An episode as a glTF 2.0 binary: the scene's surfaces once, and where bodies are at every moment
//! as an animation. Any viewer of glTF opens it; the web pages draw their 3D view from it.

use std::{borrow::Cow, collections::HashMap};

use gltf::binary::{Glb, Header};
use reel_sim::{
    geometry::{FOCAL_PX, Pose},
    render::TriangleSurface,
};
use reel_trace::Trace;
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, InstanceKind, record::RobotState};
use serde_json::{Value, json};

use crate::scene_bodies::{Moment, moments, scene_bodies};

/// Numbers of glTF: the types of components and what a buffer view is for.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;
/// Cameras see from here on, in metres, as far as a home reaches.
const NEAR_M: f32 = 0.05;
const FAR_M: f32 = 60.0;
/// Scene frames have z up, glTF has y up: a quarter turn around x.
const Y_UP: [f32; 4] = [
    -std::f32::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f32::consts::FRAC_1_SQRT_2,
];

/// The episode as a glTF 2.0 binary, in metres.
///
/// The root node turns the scene's frame (z up) into glTF's (y up); below it one node for each body,
/// named by its id: `shell`, receptacles, `door:RECEPTACLE`, objects and `robot`, with a child `head`
/// that carries a camera. `extras` of a node say `kind` and `category`, and `target` or `goal` where
/// the task names the body. Vertices have a colour and no normal: faces are flat. The animation
/// `episode` holds the poses of what moves: 0 s is the start, k + 1 s the end of step k; poses
/// change in steps. A held object hangs before the robot.
pub fn glb(trace: &Trace) -> Vec<u8> {
    let mut document = Document::default();
    let moments = moments(trace);
    let times: Vec<f32> = (0..moments.len()).map(|moment| moment as f32).collect();
    let times = document.accessor(&times, "SCALAR", true);
    let mut children = Vec::new();
    for body in scene_bodies(trace, &moments) {
        let mut extras = json!({"kind": body.kind(), "category": body.instance.category});
        for (fact, holds) in [("target", body.target), ("goal", body.goal)] {
            if holds {
                extras[fact] = json!(true);
            }
        }
        let mut node = json!({"name": body.name(), "extras": extras});
        if let Some(mesh) = document.mesh(&body.surfaces) {
            node["mesh"] = json!(mesh);
        }
        if body.instance.kind == InstanceKind::Robot {
            let head = document.head(&moments, times);
            node["children"] = json!([head]);
        }
        let index = document.node(node);
        if let Some(poses) = body.poses {
            document.animate(index, times, &poses);
        }
        children.push(index);
    }
    let root = document.node(json!({"name": "scene", "rotation": Y_UP, "children": children}));
    document.finish(root, trace)
}

/// A glTF document in the making.
#[derive(Default)]
struct Document {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    samplers: Vec<Value>,
    channels: Vec<Value>,
}

impl Document {
    fn node(&mut self, node: Value) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    /// Where the next bytes go, on a boundary of four.
    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let offset = self.binary.len();
        self.binary.extend(bytes);
        let mut view =
            json!({"buffer": 0, "byteOffset": offset, "byteLength": self.binary.len() - offset});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.views.len() - 1
    }

    /// Floats for an animation; `bounded` writes their least and greatest.
    fn accessor(&mut self, values: &[f32], shape: &str, bounded: bool) -> usize {
        let width = match shape {
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 1,
        };
        let view = self.view(values.iter().flat_map(|it| it.to_le_bytes()), None);
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": values.len() / width, "type": shape,
        });
        if bounded {
            let bound =
                |fold: fn(f32, f32) -> f32, first| [values.iter().copied().fold(first, fold)];
            accessor["min"] = json!(bound(f32::min, f32::INFINITY));
            accessor["max"] = json!(bound(f32::max, f32::NEG_INFINITY));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The surfaces of a body as one mesh; none where nothing of it is drawn.
    fn mesh(&mut self, surfaces: &[TriangleSurface]) -> Option<usize> {
        let mut vertices: Vec<([f32; 3], [u16; 3])> = Vec::new();
        let mut indices: Vec<u32> = Vec::new();
        for surface in surfaces {
            let mut known: HashMap<(u32, [u16; 3]), u32> = HashMap::new();
            for (triangle, color) in surface.triangles.iter().zip(&surface.colors) {
                let color = color.map(|it| (it.clamp(0.0, 1.0) * 65_535.0).round() as u16);
                indices.extend(triangle.map(|corner| {
                    *known.entry((corner, color)).or_insert_with(|| {
                        vertices.push((surface.corners[corner as usize], color));
                        vertices.len() as u32 - 1
                    })
                }));
            }
        }
        if indices.is_empty() {
            return None;
        }
        let positions = vertices.iter().flat_map(|(position, _)| position.iter());
        let positions = self.view(positions.flat_map(|it| it.to_le_bytes()), Some(VERTICES));
        let bound = |fold: fn(f32, f32) -> f32, first: f32| {
            [0, 1, 2].map(|axis| vertices.iter().map(|it| it.0[axis]).fold(first, fold))
        };
        let least = bound(f32::min, f32::INFINITY);
        let greatest = bound(f32::max, f32::NEG_INFINITY);
        // A fourth component keeps every colour on a boundary of four bytes.
        let colors = vertices
            .iter()
            .flat_map(|(_, [r, g, b])| [*r, *g, *b, u16::MAX]);
        let colors = self.view(colors.flat_map(u16::to_le_bytes), Some(VERTICES));
        let corners = self.view(
            indices.iter().flat_map(|it| it.to_le_bytes()),
            Some(INDICES),
        );
        let first = self.accessors.len();
        self.accessors.extend([
            json!({
                "bufferView": positions, "componentType": FLOAT, "count": vertices.len(), "type": "VEC3",
                "min": least, "max": greatest,
            }),
            json!({
                "bufferView": colors, "componentType": UNSIGNED_SHORT, "normalized": true,
                "count": vertices.len(), "type": "VEC4",
            }),
            json!({"bufferView": corners, "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR"}),
        ]);
        self.meshes.push(json!({"primitives": [{
            "attributes": {"POSITION": first, "COLOR_0": first + 1}, "indices": first + 2, "material": 0,
        }]}));
        Some(self.meshes.len() - 1)
    }

    /// The robot's head in the robot's frame, with the camera that images are taken with.
    fn head(&mut self, moments: &[Moment<'_>], times: usize) -> usize {
        let camera = self.node(json!({"name": "camera", "camera": 0, "rotation": FORWARD}));
        let head = self.node(json!({"name": "head", "children": [camera]}));
        let poses: Vec<Pose> = moments.iter().map(|it| head_pose(it.robot)).collect();
        self.animate(head, times, &poses);
        head
    }

    fn animate(&mut self, node: usize, times: usize, poses: &[Pose]) {
        let positions: Vec<f32> = poses.iter().flat_map(|pose| pose.position).collect();
        let rotations: Vec<f32> = poses.iter().flat_map(|pose| pose.rotation).collect();
        let moved = [
            ("translation", self.accessor(&positions, "VEC3", false)),
            ("rotation", self.accessor(&rotations, "VEC4", false)),
        ];
        for (path, output) in moved {
            self.channels.push(
                json!({"sampler": self.samplers.len(), "target": {"node": node, "path": path}}),
            );
            self.samplers
                .push(json!({"input": times, "output": output, "interpolation": "STEP"}));
        }
        // Whoever plays no animation sees the start.
        self.nodes[node]["translation"] = json!(poses[0].position);
        self.nodes[node]["rotation"] = json!(poses[0].rotation);
    }

    fn finish(self, root: usize, trace: &Trace) -> Vec<u8> {
        let height = 2.0 * (FRAME_HEIGHT as f32 / 2.0 / FOCAL_PX).atan();
        let document = json!({
            "asset": {"version": "2.0", "generator": concat!("Reel ", env!("CARGO_PKG_VERSION")), "extras": {
                "episode_id": trace.header.episode_id, "trace_digest": trace.chain(), "steps": trace.steps.len(),
            }},
            "scene": 0,
            "scenes": [{"nodes": [root]}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": [{"name": "flat", "doubleSided": false, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
            "cameras": [{"type": "perspective", "perspective": {
                "yfov": height, "aspectRatio": FRAME_WIDTH as f32 / FRAME_HEIGHT as f32, "znear": NEAR_M, "zfar": FAR_M,
            }}],
            "animations": [{"name": "episode", "samplers": self.samplers, "channels": self.channels}],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.binary.len()}],
        });
        let file = Glb {
            // The length is counted when the file is written.
            header: Header {
                magic: *b"glTF",
                version: 2,
                length: 0,
            },
            json: Cow::Owned(document.to_string().into_bytes()),
            bin: Some(Cow::Owned(self.binary)),
        };
        file.to_vec().expect("a scene is smaller than 4 GiB")
    }
}

/// Turns the view of a glTF camera, along -z with y up, to the head's, along x with z up.
const FORWARD: [f32; 4] = [0.5, -0.5, -0.5, 0.5];

/// The head in the robot's frame: how high it is, and how far it looks down.
fn head_pose(state: &RobotState) -> Pose {
    let [x, y] = state.base;
    let (sin, cos) = state.yaw.sin_cos();
    let (ahead, aside) = (state.camera[0] - x, state.camera[1] - y);
    let half = -state.pitch * 0.5;
    Pose {
        position: [
            ahead * cos + aside * sin,
            aside * cos - ahead * sin,
            state.camera[2],
        ],
        rotation: [0.0, half.sin(), 0.0, half.cos()],
    }
}
