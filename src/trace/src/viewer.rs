//! What viewers draw: Foxglove messages derived from the records. Nothing here is read back.
//!
//! Frames: `world` (metres, z up) -> `base` (x forward) -> `camera` (x right, y down, z forward);
//! one frame a body, with its box attached, so that the boxes move with `/tf`.

use prost_types::Timestamp;
use reel_world::{
    FRAME_HEIGHT, FRAME_WIDTH, Scene, Task,
    record::{BodyState, RobotState, StepRecord, VisibleObject},
};

use crate::image::LAYER_ENCODING;
use crate::schema::foxglove::{
    CameraCalibration, Color, CompressedImage, CubePrimitive, FrameTransform, FrameTransforms,
    ImageAnnotations, Log, Point2, PointsAnnotation, Pose, Quaternion, RawImage, SceneEntity,
    SceneUpdate, TextAnnotation, Vector3, log::Level, points_annotation,
};

/// Focal length of the head camera in pixels (docs/spec.md#episode: 640 x 480, horizontal field
/// of view 77 degrees).
const FOCAL_PX: f64 = 400.0;
const CAMERA: &str = "camera";

const RECEPTACLE: Color = Color {
    r: 0.6,
    g: 0.6,
    b: 0.6,
    a: 0.6,
};
const OBJECT: Color = Color {
    r: 0.2,
    g: 0.5,
    b: 0.9,
    a: 1.0,
};
const TARGET: Color = Color {
    r: 1.0,
    g: 0.5,
    b: 0.0,
    a: 1.0,
};
const BLACK: Color = Color {
    r: 0.0,
    g: 0.0,
    b: 0.0,
    a: 0.7,
};

/// Nanoseconds since 1970 as a protobuf timestamp.
pub(crate) fn timestamp(ns: u64) -> Option<Timestamp> {
    Some(Timestamp {
        seconds: (ns / 1_000_000_000) as i64,
        nanos: (ns % 1_000_000_000) as i32,
    })
}

/// The head camera's image in a format.
pub(crate) fn image_message(ns: u64, format: &str, data: Vec<u8>) -> CompressedImage {
    CompressedImage {
        timestamp: timestamp(ns),
        frame_id: CAMERA.into(),
        data,
        format: format.into(),
    }
}

/// Depth or instance ids of the head camera's frame, little-endian.
pub(crate) fn raw_image(ns: u64, data: Vec<u8>) -> RawImage {
    RawImage {
        timestamp: timestamp(ns),
        frame_id: CAMERA.into(),
        width: FRAME_WIDTH as u32,
        height: FRAME_HEIGHT as u32,
        encoding: LAYER_ENCODING.into(),
        step: FRAME_WIDTH as u32 * 2,
        data,
    }
}

/// The head camera as a pinhole without distortion.
pub(crate) fn calibration(ns: u64) -> CameraCalibration {
    let (cx, cy) = (FRAME_WIDTH as f64 / 2.0, FRAME_HEIGHT as f64 / 2.0);
    CameraCalibration {
        timestamp: timestamp(ns),
        frame_id: CAMERA.into(),
        width: FRAME_WIDTH as u32,
        height: FRAME_HEIGHT as u32,
        distortion_model: String::new(),
        d: vec![],
        k: vec![FOCAL_PX, 0.0, cx, 0.0, FOCAL_PX, cy, 0.0, 0.0, 1.0],
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: vec![
            FOCAL_PX, 0.0, cx, 0.0, 0.0, FOCAL_PX, cy, 0.0, 0.0, 0.0, 1.0, 0.0,
        ],
    }
}

/// Bounding boxes of the objects in the image, with their ids and sizes.
pub(crate) fn annotations(ns: u64, visible: &[VisibleObject]) -> ImageAnnotations {
    let mut message = ImageAnnotations {
        timestamp: timestamp(ns),
        ..Default::default()
    };
    for seen in visible {
        let [x_min, y_min, x_max, y_max] = seen.bbox.map(f64::from);
        let (right, bottom) = (x_max + 1.0, y_max + 1.0);
        let corners = [
            [x_min, y_min],
            [right, y_min],
            [right, bottom],
            [x_min, bottom],
        ];
        message.points.push(PointsAnnotation {
            timestamp: timestamp(ns),
            r#type: points_annotation::Type::LineLoop.into(),
            points: corners
                .iter()
                .map(|[x, y]| Point2 { x: *x, y: *y })
                .collect(),
            outline_color: Some(TARGET),
            thickness: 2.0,
            ..Default::default()
        });
        message.texts.push(TextAnnotation {
            timestamp: timestamp(ns),
            position: Some(Point2 { x: x_min, y: y_min }),
            text: format!("{} ({} px)", seen.object, seen.pixels),
            font_size: 12.0,
            text_color: Some(Color { a: 1.0, ..TARGET }),
            background_color: Some(BLACK),
            ..Default::default()
        });
    }
    message
}

/// A slab for every receptacle and a box for every object, each in the frame of its body.
pub(crate) fn scene(ns: u64, scene: &Scene, task: &Task) -> SceneUpdate {
    let slabs = scene.receptacles.iter().map(|receptacle| {
        let (min, max) = (receptacle.surface_min, receptacle.surface_max);
        let center = [0, 1, 2].map(|axis| (min[axis] + max[axis]) / 2.0);
        let size = [0, 1, 2].map(|axis| max[axis] - min[axis]);
        cube(
            ns,
            "world",
            receptacle.id.as_str(),
            center,
            size,
            RECEPTACLE,
        )
    });
    let boxes = task.objects.iter().map(|object| {
        let color = if object.instance == task.target {
            TARGET
        } else {
            OBJECT
        };
        cube(
            ns,
            object.instance.as_str(),
            object.instance.as_str(),
            [0.0; 3],
            object.size,
            color,
        )
    });
    SceneUpdate {
        deletions: vec![],
        entities: slabs.chain(boxes).collect(),
    }
}

/// The robot's frames, and those of the bodies that moved since `before`.
pub(crate) fn transforms(
    ns: u64,
    robot: &RobotState,
    bodies: &[BodyState],
    before: &[BodyState],
) -> FrameTransforms {
    let [x, y] = robot.base.map(f64::from);
    let yaw = f64::from(robot.yaw);
    let base = transform(ns, "world", "base", [x, y, 0.0], turn([0.0, 0.0, 1.0], yaw));
    let [cx, cy, cz] = robot.camera.map(f64::from);
    let (sin, cos) = (libm::sin(yaw), libm::cos(yaw));
    let [dx, dy] = [cx - x, cy - y];
    // Takes camera axes (right, down, forward) to base axes (forward, left, up).
    let optical = [-0.5, 0.5, -0.5, 0.5];
    let pitched = product(turn([0.0, 1.0, 0.0], -f64::from(robot.pitch)), optical);
    let camera = transform(
        ns,
        "base",
        CAMERA,
        [cos * dx + sin * dy, cos * dy - sin * dx, cz],
        pitched,
    );
    let pose = |body: &BodyState| {
        (
            body.position.map(f32::to_bits),
            body.rotation.map(f32::to_bits),
        )
    };
    let moved = bodies.iter().filter(|body| {
        !before
            .iter()
            .any(|old| old.body == body.body && pose(old) == pose(body))
    });
    let moved = moved.map(|body| {
        transform(
            ns,
            "world",
            &body.body,
            body.position.map(f64::from),
            body.rotation.map(f64::from),
        )
    });
    FrameTransforms {
        transforms: [base, camera].into_iter().chain(moved).collect(),
    }
}

/// One line about a step, a warning when its call failed.
pub(crate) fn step_line(ns: u64, record: &StepRecord) -> Log {
    let result = record.outcome.text.lines().next().unwrap_or_default();
    let (level, verdict) = match record.outcome.error {
        None => (Level::Info, "ok".to_owned()),
        Some(code) => (
            Level::Warning,
            format!("{code} ({})", crate::codec::word(&code.class())),
        ),
    };
    line(
        ns,
        level,
        format!(
            "{} {} -> {verdict}: {result}",
            record.step, record.input.call
        ),
    )
}

/// A line for people.
pub(crate) fn line(ns: u64, level: Level, message: String) -> Log {
    Log {
        timestamp: timestamp(ns),
        level: level.into(),
        message,
        name: "reel".into(),
        file: String::new(),
        line: 0,
    }
}

fn cube(
    ns: u64,
    frame: &str,
    id: &str,
    center: [f64; 3],
    size: [f64; 3],
    color: Color,
) -> SceneEntity {
    let pose = Pose {
        position: Some(vector(center)),
        orientation: Some(quaternion([0.0, 0.0, 0.0, 1.0])),
    };
    SceneEntity {
        timestamp: timestamp(ns),
        frame_id: frame.to_owned(),
        id: id.to_owned(),
        frame_locked: true,
        cubes: vec![CubePrimitive {
            pose: Some(pose),
            size: Some(vector(size)),
            color: Some(color),
        }],
        ..Default::default()
    }
}

fn transform(
    ns: u64,
    parent: &str,
    child: &str,
    translation: [f64; 3],
    rotation: [f64; 4],
) -> FrameTransform {
    FrameTransform {
        timestamp: timestamp(ns),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(vector(translation)),
        rotation: Some(quaternion(rotation)),
    }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

/// Rotation around an axis, in radians.
fn turn(axis: [f64; 3], angle: f64) -> [f64; 4] {
    let sin = libm::sin(angle / 2.0);
    [
        axis[0] * sin,
        axis[1] * sin,
        axis[2] * sin,
        libm::cos(angle / 2.0),
    ]
}

fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotate([x, y, z, w]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
        let p = product(
            product([x, y, z, w], [v[0], v[1], v[2], 0.0]),
            [-x, -y, -z, w],
        );
        [p[0], p[1], p[2]]
    }

    #[test]
    fn the_camera_frame_looks_where_the_camera_looks() {
        let (yaw, pitch) = (0.7f32, -0.4f32);
        let robot = RobotState {
            base: [1.0, 2.0],
            yaw,
            camera: [1.3, 2.4, 1.4],
            pitch,
            path_length_m: 0.0,
        };
        let message = transforms(0, &robot, &[], &[]);
        let rotation = |index: usize| {
            let q: &Quaternion = message.transforms[index].rotation.as_ref().unwrap();
            [q.x, q.y, q.z, q.w]
        };
        let world_from_camera = |v: [f64; 3]| rotate(rotation(0), rotate(rotation(1), v));
        let close = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let (sy, cy, sp, cp) = (
            libm::sin(0.7),
            libm::cos(0.7),
            libm::sin(-0.4),
            libm::cos(-0.4),
        );
        assert!(
            close(world_from_camera([0.0, 0.0, 1.0]), [cy * cp, sy * cp, sp]),
            "forward"
        );
        assert!(
            close(world_from_camera([1.0, 0.0, 0.0]), [sy, -cy, 0.0]),
            "right"
        );
        let offset = message.transforms[1].translation.as_ref().unwrap();
        let [x, y, z] = rotate(rotation(0), [offset.x, offset.y, offset.z]);
        assert!(
            close(
                [x + 1.0, y + 2.0, z],
                [1.3f32 as f64, 2.4f32 as f64, 1.4f32 as f64]
            ),
            "position"
        );
    }
}
