//! Hand-made episodes as transcript, contact sheet and Rerun recording.

use play::{DISTRACTOR, Play, success};
use reel_replay::compare;
use reel_trace::{Images, Trace};
use reel_vectors::play;
use reel_view::{Video, VideoSegment, contact_sheet, side_by_side, transcript};
use reel_world::{
    Assets as _, ErrorCode, Family, Mesh,
    mesh::{Material, MeshData, Triangle},
    record::{EndReason, PolicyOutput},
};
use tempfile::TempDir;

fn size(png: &[u8]) -> (u32, u32) {
    let reader = png::Decoder::new(std::io::Cursor::new(png))
        .read_info()
        .unwrap();
    (reader.info().width, reader.info().height)
}

#[test]
fn a_transcript_tells_everything_once() {
    let dir = TempDir::new().unwrap();
    let play = Play::new("hasty", Family::SUL, 3)
        .nav("table_1")
        .fails("pick", ErrorCode::NoMarkerMap)
        .find("clock")
        .thinking(PolicyOutput {
            // Not a word of it moves the cursor.
            raw: "Which clock?\u{1b}[2J\u{9b}1A\rNone.".into(),
            ..PolicyOutput::default()
        })
        .pick(DISTRACTOR);
    let play = play.thinking(PolicyOutput {
        raw: r#"{"reasoning": "Any clock\ntells the time.", "tool_call": {"name": "pick"}}"#.into(),
        reasoning: "Any clock\ntells the time.".into(),
        ..PolicyOutput::default()
    });
    let text = transcript(&play.finish().record(dir.path(), Images::None));
    let expected = "\
episode      hasty-SUL-3
task         SUL/t (SUL), scene flat
instruction  Move a timekeeping device to the desk.
precisely    Move the white alarm clock from the small table to the desk.
goal         -clock_white_7_on_table_1_at_t@table_1  +clock_white_7_on_table_1_at_t@desk_1
policy       hasty, seed 3, profile paper
recorded by  reel 0.1.0, simulator 1

  0  nav_to(receptacle_name=\"table_1\")
     ok       You are at table_1.
     reward   -0.03 = time -0.03 (one more decision)

  1  pick(marker_id=1)
     ERROR    no_marker_map: It does not work: no_marker_map.
     reward   -0.03 = time -0.03 (one more decision)

  2  show_object_by_category(target_category=\"clock\")
     said     Which clock?\\u{1b}[2J\\u{9b}1A\\rNone.
     ok       Marked 2 objects.
     reward   -0.03 = time -0.03 (one more decision)

  3  pick(marker_id=1)
     thought  Any clock
              tells the time.
     ok       Done.
     holds    clock_blue_3_on_table_1_at_t
     change   -clock_blue_3_on_table_1_at_t@table_1
     reward   -0.03 = time -0.03 (one more decision)

  4  finish()
     ok       The episode is over.
     holds    clock_blue_3_on_table_1_at_t
     reward   -0.03 = time -0.03 (one more decision)

FAILURE: the policy finished after 5 decisions, 0 asks, SPL 0.00
0% of the goal done, reward -0.15 (discounted +0.50), 1.0 m driven
time -0.15
";
    assert_eq!(text, expected);
}

#[test]
fn a_sheet_has_a_card_for_every_moment() {
    let dir = TempDir::new().unwrap();
    let trace = success("oracle", Family::SUL, 1).record(dir.path(), Images::Full);
    let sheet = contact_sheet(&trace).unwrap();
    if let Some(folder) = std::env::var_os("REEL_TEST_OUTPUT") {
        std::fs::write(std::path::Path::new(&folder).join("sheet.png"), &sheet).unwrap();
    }
    let (width, height) = size(&sheet);
    assert_eq!(width, 16 + 4 * (320 + 16), "four cards a row");
    assert!(
        height > 2 * 290 && height < 3 * 390,
        "two rows for the start and seven steps: {height}"
    );
    assert_eq!(sheet, contact_sheet(&trace).unwrap());
    let lean = Play::new("lean", Family::FDP, 1)
        .ended(EndReason::Aborted)
        .record(dir.path(), Images::None);
    assert_eq!(
        size(&contact_sheet(&lean).unwrap()).0,
        16 + 2 * (320 + 16),
        "a lean trace without a step is still a sheet"
    );
}

#[test]
fn a_video_has_an_image_for_every_step_and_waits_for_the_longer_one() {
    let dir = TempDir::new().unwrap();
    let long = success("oracle", Family::SUL, 1).record(dir.path(), Images::None);
    let short = Play::new("lean", Family::SUL, 1)
        .nav("table_1")
        .ended(EndReason::Aborted)
        .record(dir.path(), Images::None);
    let grey = |trace: &Trace| vec![vec![90; 640 * 480 * 3]; trace.steps.len() + 1];
    let (a, b) = (grey(&long), grey(&short));
    let film = Video::new(&[
        VideoSegment {
            trace: &long,
            frames: &a,
        },
        VideoSegment {
            trace: &short,
            frames: &b,
        },
    ]);
    assert_eq!(
        (film.width, film.frames.len()),
        (2 * 640 + 8, long.steps.len() + 1)
    );
    assert!(
        film.height.is_multiple_of(2)
            && film
                .frames
                .iter()
                .all(|image| image.len() == film.width * film.height * 3)
    );
    let right = |moment: usize| -> Vec<u8> {
        film.frames[moment]
            .chunks(film.width * 3)
            .flat_map(|row| row[648 * 3..].to_vec())
            .collect()
    };
    assert!(
        right(0) != right(1) && right(1) == right(2),
        "the shorter one waits in its last image"
    );
    assert_eq!(film.stream().count(), film.frames.len() + 2);

    let mut gif = gif::DecodeOptions::new()
        .read_info(std::io::Cursor::new(film.gif(2.0).unwrap()))
        .unwrap();
    let mut delays = Vec::new();
    while let Some(frame) = gif.read_next_frame().unwrap() {
        assert_eq!(
            (usize::from(frame.width), usize::from(frame.height)),
            (film.width, film.height)
        );
        delays.push(frame.delay);
    }
    assert_eq!(
        (delays.len(), delays[0], *delays.last().unwrap()),
        (film.frames.len(), 50, 150)
    );
}

#[test]
fn two_episodes_side_by_side() {
    let dir = TempDir::new().unwrap();
    let a = Play::new("a", Family::SUL, 3)
        .nav("table_1")
        .find("clock")
        .pick(DISTRACTOR)
        .finish()
        .record(dir.path(), Images::None);
    let b = Play::new("b", Family::SUL, 3)
        .nav("table_1")
        .fails("pick", ErrorCode::NoMarkerMap)
        .find("clock")
        .pick(DISTRACTOR);
    let b = b.finish().record(dir.path(), Images::None);
    let text = side_by_side(&compare(&a, &b).unwrap());
    if std::env::var_os("REEL_TEST_OUTPUT").is_some() {
        eprintln!("{text}");
    }
    assert!(text.contains("call 0 is the same"), "{text}");
    let lines: Vec<&str> = text.lines().collect();
    let row = |what: &str| {
        *lines
            .iter()
            .find(|line| line.contains(what))
            .unwrap_or_else(|| panic!("no {what} in\n{text}"))
    };
    // Where a call is more on one side, the rest stands beside its like.
    assert!(
        row("no_marker_map").trim_start().starts_with("ERROR"),
        "{text}"
    );
    let find = row("show_object_by_category");
    assert_eq!(find.matches("show_object_by_category").count(), 2, "{text}");
    assert!(
        lines.iter().all(|line| line.chars().count() <= 58 * 2 + 3),
        "{text}"
    );
}

#[cfg(feature = "rerun")]
#[test]
fn a_recording_is_what_rerun_accepts() {
    let dir = TempDir::new().unwrap();
    let trace = success("oracle", Family::FDO, 1).record(dir.path(), Images::Full);
    let path = dir.path().join("episode.rrd");
    std::fs::write(
        &path,
        reel_view::rrd(&trace, reel_trace::FrameLayers::default()).unwrap(),
    )
    .unwrap();
    if let Some(folder) = std::env::var_os("REEL_TEST_OUTPUT") {
        std::fs::copy(&path, std::path::Path::new(&folder).join("episode.rrd")).unwrap();
    }
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(&bytes[..4], b"RRF2");
    assert!(
        bytes.len() > 50_000,
        "the images are in it: {}",
        bytes.len()
    );
    // rerun-sdk puts its command beside its Python.
    let Some(python) = reel_vectors::python("rerun_sdk") else {
        return;
    };
    let rerun = python.with_file_name("rerun");
    let command = || std::process::Command::new(&rerun);
    reel_vectors::run(command().args(["rrd", "verify"]).arg(&path));

    // What Rerun itself prints of each body is where the glTF of the same episode has it, at every moment.
    let scene = Scene::of(&trace);
    let bodies = [
        (
            "clock_white_7_on_table_1_at_t",
            "objects/clock_white_7_on_table_1_at_t",
        ),
        ("mug_1_on_table_1_at_t", "objects/mug_1_on_table_1_at_t"),
        ("door:cabinet_1", "doors/cabinet_1"),
        ("robot", "robot"),
    ];
    for (body, entity) in bodies {
        let printed = command()
            .args([
                "rrd",
                "print",
                "-vvv",
                "--entity",
                &format!("/world/{entity}"),
            ])
            .arg(&path)
            .output()
            .unwrap();
        let printed = String::from_utf8(printed.stdout).unwrap();
        assert!(printed.contains("Mesh3D:vertex_positions"), "{printed}");
        let told = told_poses(&printed);
        for (at, (position, rotation)) in scene.poses(body).into_iter().enumerate() {
            let (_, newest) = told.range(..at as i64).next_back().unwrap();
            assert_eq!(*newest, (position, rotation), "{body}, moment {at}");
        }
        let rests = scene
            .poses(body)
            .windows(2)
            .filter(|two| two[0] == two[1])
            .count();
        assert_eq!(told.len(), trace.steps.len() + 1 - rests, "{body}");
    }
}

/// The poses in Rerun's print of an entity, by the step from which on they hold.
#[cfg(feature = "rerun")]
fn told_poses(printed: &str) -> std::collections::BTreeMap<i64, Pose> {
    let rows = printed.lines().filter_map(|line| {
        let cells: Vec<&str> = line
            .split('┆')
            .map(|cell| cell.trim_matches(['│', ' ']))
            .collect();
        let [_, _, step, rotation, position] = cells[..] else {
            return None;
        };
        let numbers = |cell: &str| -> Vec<f32> {
            let inside = cell.trim_matches(['[', ']']).split(", ");
            inside.filter_map(|number| number.parse().ok()).collect()
        };
        let position = numbers(position).try_into().ok()?;
        Some((
            step.parse().ok()?,
            (position, numbers(rotation).try_into().ok()?),
        ))
    });
    rows.collect()
}

/// A glTF file, read by another library.
struct Scene {
    document: gltf::Gltf,
}

type Pose = ([f32; 3], [f32; 4]);
type Corners = [[f32; 3]; 3];

impl Scene {
    fn of(trace: &Trace) -> Self {
        Self {
            document: gltf::Gltf::from_slice(&reel_view::glb(trace)).unwrap(),
        }
    }

    fn blob(&self) -> &[u8] {
        self.document.blob.as_deref().unwrap()
    }

    /// Every pose of a node that is animated.
    fn poses(&self, name: &str) -> Vec<Pose> {
        let animation = self.document.animations().next().unwrap();
        let (mut positions, mut rotations) = (Vec::new(), Vec::new());
        let channels = animation.channels();
        for channel in channels.filter(|it| it.target().node().name() == Some(name)) {
            let reader = channel.reader(|_| Some(self.blob()));
            let times: Vec<f32> = reader.read_inputs().unwrap().collect();
            assert!(
                times
                    .iter()
                    .enumerate()
                    .all(|(at, time)| *time == at as f32)
            );
            match reader.read_outputs().unwrap() {
                gltf::animation::util::ReadOutputs::Translations(all) => positions.extend(all),
                gltf::animation::util::ReadOutputs::Rotations(all) => {
                    rotations.extend(all.into_f32());
                }
                _ => panic!("{name} changes its form"),
            }
        }
        positions.into_iter().zip(rotations).collect()
    }

    /// The triangles of bodies at the start, in the scene's frame, with the colour of each.
    fn triangles(&self, wanted: impl Fn(&str) -> bool) -> Vec<(Corners, [f32; 3])> {
        let root = self.document.nodes().find(|it| it.name() == Some("scene"));
        let mut all = Vec::new();
        for node in root.unwrap().children() {
            let (Some(mesh), true) = (node.mesh(), node.name().is_some_and(&wanted)) else {
                continue;
            };
            let (position, rotation, _) = node.transform().decomposed();
            let place = |point| placed(point, (position, rotation));
            for primitive in mesh.primitives() {
                let reader = primitive.reader(|_| Some(self.blob()));
                let corners: Vec<_> = reader.read_positions().unwrap().map(place).collect();
                let colors: Vec<_> = reader.read_colors(0).unwrap().into_rgb_f32().collect();
                let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
                all.extend(indices.as_chunks::<3>().0.iter().map(|triangle| {
                    let triangle = triangle.map(|corner| corner as usize);
                    assert!(triangle.iter().all(|it| colors[*it] == colors[triangle[0]]));
                    (triangle.map(|corner| corners[corner]), colors[triangle[0]])
                }));
            }
        }
        all
    }
}

/// A point of a body's frame in the frame that its pose is in.
fn placed([x, y, z]: [f32; 3], (position, [a, b, c, w]): Pose) -> [f32; 3] {
    // Twice the cross product of the rotation's axis and the point.
    let twice = [
        2.0 * (b * z - c * y),
        2.0 * (c * x - a * z),
        2.0 * (a * y - b * x),
    ];
    let [p, q, r] = twice;
    [
        x + w * p + b * r - c * q + position[0],
        y + w * q + c * p - a * r + position[1],
        z + w * r + a * q - b * p + position[2],
    ]
}

/// An episode of the oracle, which carries something.
fn carried(folder: &std::path::Path) -> Trace {
    let path = folder.join("oracle.mcap");
    let task = reel_vectors::episodes::tasks()[0].clone();
    let path = reel_vectors::episodes::record(&path, &task, "oracle", Images::None);
    Trace::read(&path).unwrap()
}

#[test]
fn gltf_has_every_body_where_the_record_says() {
    let dir = TempDir::new().unwrap();
    let trace = carried(dir.path());
    let scene = Scene::of(&trace);
    let start = (&trace.start.robot, &trace.start.bodies);
    let ends = trace.steps.iter().map(|step| (&step.robot, &step.bodies));
    let moments: Vec<_> = std::iter::once(start).chain(ends).collect();
    let robot = scene.poses("robot");
    assert_eq!(robot.len(), moments.len());
    let mut held = 0;
    for body in moments[0].1 {
        let poses = scene.poses(&body.body);
        assert_eq!(poses.len(), moments.len(), "{}", body.body);
        for ((pose, robot), (_, bodies)) in poses.iter().zip(&robot).zip(&moments) {
            match bodies.iter().find(|it| it.body == body.body) {
                Some(at) => assert_eq!(*pose, (at.position, at.rotation)),
                None => {
                    held += 1;
                    let away = [0, 1].map(|axis| pose.0[axis] - robot.0[axis]);
                    let away = away[0].hypot(away[1]);
                    assert!((0.1..0.6).contains(&away), "held {away} m before the robot");
                }
            }
        }
    }
    assert!(held > 0, "the oracle carried nothing");
    // The camera that images are taken with, through all nodes above it.
    let head = scene.poses("head");
    for ((head, robot), (state, _)) in head.iter().zip(&robot).zip(&moments) {
        let seen = placed(head.0, *robot);
        let away = (0..3).map(|axis| (seen[axis] - state.camera[axis]).abs());
        assert!(
            away.fold(0.0, f32::max) < 1e-3,
            "{seen:?} {:?}",
            state.camera
        );
        // One metre ahead of it: -z of the camera, turned to x of the head.
        let ahead = placed(placed([1.0, 0.0, 0.0], *head), *robot);
        let looks = [0, 1, 2].map(|axis| ahead[axis] - seen[axis]);
        let (sin, cos) = state.pitch.sin_cos();
        let wanted = [cos * state.yaw.cos(), cos * state.yaw.sin(), sin];
        let away = (0..3).map(|axis| (looks[axis] - wanted[axis]).abs());
        assert!(away.fold(0.0, f32::max) < 1e-3, "{looks:?} {wanted:?}");
    }
}

#[test]
fn gltf_has_the_surfaces_that_frames_show() {
    let dir = TempDir::new().unwrap();
    let trace = carried(dir.path());
    let stage = reel_sim::PreparedTask::new(trace.scene.clone(), trace.task.clone());
    let simulator = reel_sim::Simulator::new(stage, trace.header.profile, trace.header.seed);
    assert_eq!(simulator.bodies(), trace.start.bodies);
    let surfaces = simulator.surfaces();
    let shown: Vec<(Corners, [f32; 3])> = surfaces
        .iter()
        .flat_map(|surface| {
            let triangles = surface.triangles.iter().zip(&surface.colors);
            triangles.map(|(triangle, color)| {
                (
                    triangle.map(|corner| surface.corners[corner as usize]),
                    *color,
                )
            })
        })
        .collect();
    let drawn = Scene::of(&trace).triangles(|body| body != "robot");
    assert_eq!(drawn.len(), shown.len());
    for (drawn, shown) in drawn.iter().zip(&shown) {
        let corners = drawn.0.iter().flatten().zip(shown.0.iter().flatten());
        assert!(
            corners.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-3,
            "{drawn:?} {shown:?}"
        );
        let colors = drawn.1.iter().zip(&shown.1);
        assert!(
            colors.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-4,
            "{drawn:?} {shown:?}"
        );
    }
    let colors: std::collections::BTreeSet<_> =
        shown.iter().map(|it| it.1.map(f32::to_bits)).collect();
    assert!(colors.len() > 20, "{} colours", colors.len());
}

/// Corners that several colours share stand once for each.
#[test]
fn gltf_keeps_the_colours_of_a_mesh() {
    let dir = TempDir::new().unwrap();
    let material = |color| Material {
        color,
        texture: None,
    };
    let (red, blue) = ([0.5, 0.0, 0.0], [0.0, 0.0, 0.5]);
    let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let triangle = |(face, corners): (u16, [u32; 3])| Triangle {
        corners,
        material: face % 2,
    };
    let data = MeshData {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        triangles: (0..).zip(faces).map(triangle).collect(),
        materials: vec![material(red), material(blue)],
        ..MeshData::default()
    };
    let mut trace = carried(dir.path());
    let target = trace.task.target_object();
    let mesh = std::sync::Arc::new(Mesh::new(data).unwrap());
    let assets = std::collections::BTreeMap::from([(target.asset.clone(), mesh)]);
    let name = target.instance.to_string();
    trace.meshes = assets.meshes(&mut trace.task.assets());
    let drawn = Scene::of(&trace).triangles(|body| body == name);
    let colors: Vec<[f32; 3]> = drawn
        .iter()
        .map(|it| it.1.map(|it| (it * 10.0).round() / 10.0))
        .collect();
    assert_eq!(colors, [red, blue, red, blue]);
}
