//! Joint states, transforms, further cameras and a reference are kept as they came, beside the
//! records and outside of every digest; what is wrong with a message costs that message.

use reel_import::robot::camera_frames;
use reel_trace::{
    Images, recover,
    sensors::{SensorChannel, SensorKind},
};

use super::*;

/// The topics of [`MAPPING`] with those of the sensors.
fn mapping(more: &str) -> String {
    format!(
        "rpe_interval_m = 2.0\n{MAPPING}\n\"/joint_states\" = {{ is = \"joints\" }}\n\"/tf\" = {{ is = \"transforms\" }}\n\
         \"/tf_static\" = {{ is = \"transforms\" }}\n\"/mocap\" = {{ is = \"reference\" }}\n\
         \"/wrist\" = {{ is = \"camera\", name = \"wrist\", max_hz = 2 }}\n{more}"
    )
}

fn joints(ms: u64, positions: &[f64]) -> Said {
    let names = ["shoulder", "elbow"];
    said(
        ms,
        "/joint_states",
        json!({"name": names, "position": positions, "velocity": []}),
    )
}

fn transform(ms: u64, topic: &'static str, child: &str) -> Said {
    let turned = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
    let moved = json!({"x": 0.5, "y": 0.0, "z": 1.0});
    let transform = json!({"header": {"frame_id": "base_link"}, "child_frame_id": child,
        "transform": {"translation": moved, "rotation": turned}});
    said(ms, topic, json!({ "transforms": [transform] }))
}

fn wrist(ms: u64, colour: [u8; 3]) -> Said {
    Said {
        topic: "/wrist",
        ..jpeg(ms, (64, 48), colour)
    }
}

fn mocap(ms: u64, x: f64, y: f64) -> Said {
    said(
        ms,
        "/mocap",
        json!({"x": x, "y": y, "theta": std::f64::consts::FRAC_PI_2}),
    )
}

/// The episode with the sensors of a robot around it.
fn sensed() -> Vec<Said> {
    let mut messages = without_images();
    messages.extend([
        transform(10, "/tf_static", "camera_link"),
        joints(60, &[0.0, 0.0]),
        transform(1_200, "/tf", "base_footprint"),
        joints(1_400, &[0.1, -0.5]),
        joints(3_300, &[0.2, -0.75]),
        wrist(1_000, [250, 0, 0]),
        // 0.2 s after the one before: too soon for two images a second.
        wrist(1_200, [0, 250, 0]),
        wrist(1_600, [0, 0, 250]),
        // Five centimetres off over the whole way.
        mocap(1_500, 3.0, 0.0),
        mocap(1_800, 3.0, 2.0),
        mocap(2_000, 3.0, 3.95),
    ]);
    messages.sort_by_key(|message| message.ns);
    messages
}

fn channel<'a>(trace: &'a Trace, topic: &str) -> &'a SensorChannel {
    let found = trace.sensors.iter().find(|channel| channel.topic == topic);
    found.unwrap_or_else(|| panic!("no channel {topic}"))
}

#[test]
fn sensors_are_kept_in_every_encoding_and_outside_of_every_digest() {
    let place = Place::new();
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Cdr] {
        let path = place.path(&format!("{encoding:?}.mcap"));
        bags::write(&path, &sensed(), encoding);
        let (recording, mut traces) = place.import_by(&mapping(""), &path, &PLAIN);
        assert_eq!(recording.losses, []);
        let trace = traces.remove(0);
        let kept: Vec<(&str, SensorKind, usize)> = trace
            .sensors
            .iter()
            .map(|channel| (channel.topic.as_str(), channel.kind, channel.messages.len()))
            .collect();
        // What was said before the episode is not of it, but for what holds until it is said anew.
        assert_eq!(
            kept,
            [
                ("/joint_states", SensorKind::Joints, 2),
                ("/mocap", SensorKind::Reference, 3),
                ("/tf", SensorKind::Transforms, 1),
                ("/tf_static", SensorKind::Transforms, 1),
                ("/wrist", SensorKind::Camera, 2),
            ],
            "{encoding:?}"
        );
        let joints = channel(&trace, "/joint_states");
        let word = ["json", "protobuf", "cdr"][encoding as usize];
        assert_eq!(joints.encoding, word);
        assert_eq!(joints.messages[0].unix_ns, BEGIN_NS + 1_400_000_000);
        // On the clock of viewers an episode begins with its first call, here after 1 s.
        let began = joints.messages[0].log_time_ns - 400_000_000;
        assert_eq!(began, 1_577_836_800_000_000_000);
        let read = mcap_messages(&recording.episodes[0].trace, "/recorded/joint_states");
        let names = [
            "none",
            "sensor_msgs.JointState",
            "sensor_msgs/msg/JointState",
        ];
        assert_eq!(read, [names[encoding as usize]; 2]);
        let frames = camera_frames(&trace, "wrist").unwrap();
        assert_eq!(frames, camera_frames(&trace, "/wrist").unwrap());
        assert_eq!(camera_frames(&trace, "/camera"), None);
        let seconds: Vec<u64> = frames.iter().map(|(ns, _)| ns - BEGIN_NS).collect();
        assert_eq!(seconds, [1_000_000_000, 1_600_000_000]);
        assert!(
            frames
                .iter()
                .all(|(_, image)| image.as_ref().unwrap().format == "jpeg")
        );
    }
}

#[test]
fn a_trace_has_the_records_and_the_name_that_it_has_without_sensors() {
    let place = Place::new();
    let path = place.path("bag.mcap");
    bags::write(&path, &sensed(), Encoding::Cdr);
    let (_, plain) = place.import(&path);
    let without = mapping("").replace("\"/mocap\" = { is = \"reference\" }\n", "");
    let (recording, traces) = place.import_by(&without, &path, &PLAIN);
    let trace = &traces[0];
    assert_eq!(trace.header, plain.header);
    assert_eq!((trace.chain(), &trace.steps), (plain.chain(), &plain.steps));
    assert!(plain.sensors.is_empty() && !trace.sensors.is_empty());

    // Written anew it is the same, and without images it has no cameras.
    let written = place.path("again.mcap");
    trace.rewrite(&written, Images::Full, |_| None).unwrap();
    let original = fs::read(&recording.episodes[0].trace).unwrap();
    assert!(fs::read(&written).unwrap() == original);
    trace.rewrite(&written, Images::None, |_| None).unwrap();
    let bare = healthy(&written);
    assert!(bare.sensors.iter().all(|it| it.kind != SensorKind::Camera));
    assert_eq!(bare.sensors.len(), trace.sensors.len() - 1);

    // A torn file gives the messages that it still has.
    fs::write(&written, &original[..original.len() - 40]).unwrap();
    let recovery = recover(
        &written,
        None,
        |_: &Trace, _: &reel_world::record::Graphs| Default::default(),
    )
    .unwrap();
    let restored = Trace::read(&recovery.trace).unwrap();
    assert_eq!(restored.sensors, trace.sensors);
}

#[test]
fn odometry_is_compared_with_a_reference() {
    let place = Place::new();
    let path = place.path("bag.mcap");
    bags::write(&path, &sensed(), Encoding::Protobuf);
    let (recording, traces) = place.import_by(&mapping(""), &path, &PLAIN);
    let error = &traces[0].header.policy.parameters["trajectory_error"];
    assert_eq!(
        (&error["poses"], &error["rpe_pairs"]),
        (&json!(2), &json!(1))
    );
    let told = |key: &str| error[key].as_f64().unwrap();
    assert!(
        (told("rpe_translation_rmse_m") - 0.05).abs() < 1e-9,
        "{error}"
    );
    assert!((told("ate_rmse_m") - 0.025).abs() < 1e-9, "{error}");
    assert!(told("rpe_rotation_rmse_rad").abs() < 1e-6, "{error}");
    assert_eq!(told("rpe_interval_m"), 2.0);
    let notes = recording.episodes[0].notes.join("\n");
    assert!(
        notes.contains("relative pose error 0.050 m and 0.00 degrees over 2 m (1 pairs)"),
        "{notes}"
    );
}

#[test]
fn a_bad_message_costs_itself_alone() {
    let place = Place::new();
    let mut messages = sensed();
    let (mut short, mut bare) = (joints(3_000, &[0.5]), joints(3_100, &[]));
    bare.value["position"] = json!([]);
    short.value["position"] = json!([0.5]);
    let mut nameless = transform(3_150, "/tf", "");
    nameless.value["transforms"][0]["child_frame_id"] = json!("");
    let mut torn = joints(3_200, &[0.0, 0.0]);
    torn.instead = Some(vec![0, 1, 0]);
    let mut no_image = wrist(4_000, [1, 1, 1]);
    no_image.value["data"] = json!(STANDARD.encode(b"no image"));
    messages.extend([short, bare, nameless, torn, no_image]);
    messages.sort_by_key(|message| message.ns);
    let path = place.path("bag.mcap");
    bags::write(&path, &messages, Encoding::Cdr);
    let (recording, traces) = place.import_by(&mapping(""), &path, &PLAIN);
    let losses: Vec<&str> = recording
        .losses
        .iter()
        .map(|loss| loss.message.as_str())
        .collect();
    assert_eq!(
        losses,
        [
            "3 of the messages on /joint_states cannot be read and are left out, the first at 1790000003.000000000 s (1 values of position for 2 joints)",
            "1 of the messages on /tf cannot be read and are left out, the first at 1790000003.150000000 s (transform 0 has no child frame)",
            "1 of the messages on /wrist cannot be read and are left out, the first at 1790000004.000000000 s (neither a JPEG nor a PNG file, and no raw image either)",
        ]
    );
    let count = |topic| channel(&traces[0], topic).messages.len();
    assert_eq!(
        (count("/joint_states"), count("/tf"), count("/wrist")),
        (2, 1, 2)
    );
}

#[test]
fn foxgloves_own_messages_are_read() {
    let place = Place::new();
    let path = place.path("bag.mcap");
    let mut messages = sensed();
    let value = json!({"timestamp": "2026-01-01T00:00:00Z", "joints": [{"name": "wrist", "position": 0.5}]});
    messages.push(said(5_000, "/joint_states", value));
    let pose = json!({"parent_frame_id": "map", "child_frame_id": "base", "translation": {"x": 1.0, "y": 0.0, "z": 0.0},
        "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}});
    messages.push(said(5_100, "/tf", pose));
    let no_name = json!({"joints": [{"position": 0.5}]});
    messages.push(said(5_200, "/joint_states", no_name));
    bags::write(&path, &messages, Encoding::Json);
    let (recording, traces) = place.import_by(&mapping(""), &path, &PLAIN);
    assert_eq!(recording.losses.len(), 1, "{:?}", recording.losses);
    assert!(recording.losses[0].message.contains("joint 0 has no name"));
    let count = |topic| channel(&traces[0], topic).messages.len();
    assert_eq!((count("/joint_states"), count("/tf")), (3, 2));
}

/// The schemas of the messages of a topic as any reader of MCAP finds them.
fn mcap_messages(path: &Path, topic: &str) -> Vec<String> {
    let bytes = fs::read(path).unwrap();
    let all = mcap::MessageStream::new(&bytes).unwrap();
    all.map(Result::unwrap)
        .filter(|message| message.channel.topic == topic)
        .map(|message| {
            let schema = message.channel.schema.as_ref();
            schema.map_or("none".to_owned(), |schema| schema.name.clone())
        })
        .collect()
}
