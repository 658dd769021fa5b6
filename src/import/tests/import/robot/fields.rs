//! Every field of a recording comes into its trace: calls, graphs, odometry, times and images.

use reel_trace::Timing;
use reel_world::{
    FRAME_HEIGHT, FRAME_WIDTH,
    record::{Backend, UserSource},
};

use super::*;

#[test]
fn every_field_comes_through() {
    let place = Place::new();
    let (recording, trace) = place.said(&episode());
    assert_eq!(recording.losses, []);
    assert_eq!(recording.notes, ["no message on /raw"]);
    let imported = &recording.episodes[0];
    assert_eq!(
        (
            imported.steps,
            imported.images,
            imported.end,
            imported.success
        ),
        (7, 3, EndReason::Finished, Some(true))
    );
    assert_eq!(imported.losses, []);
    let notes = [
        "the task is not known; give its task file with --tasks",
        "success is what the recording says (true); no graph and goal tell it",
    ];
    assert_eq!(imported.notes, notes);

    let header = &trace.header;
    assert_eq!(
        (
            header.backend,
            header.sim_version,
            header.policy.name.as_str()
        ),
        (Backend::Robot, 0, "qwen-vl")
    );
    assert_eq!(
        (trace.task.task_id.as_str(), trace.task.instruction.as_str()),
        ("FDP/apple", "Put the apple into the fridge.")
    );
    let calls: Vec<(&str, Option<ErrorCode>)> = trace
        .steps
        .iter()
        .map(|step| (step.tool_name(), step.outcome.error))
        .collect();
    let expected = ["nav_to", "pick", "pick", "ask", "open", "place", "finish"]
        .map(|tool| (tool, None::<ErrorCode>))
        .into_iter()
        .enumerate();
    let expected: Vec<_> = expected
        .map(|(step, (tool, _))| (tool, (step == 1).then_some(ErrorCode::SkillFailed)))
        .collect();
    assert_eq!(calls, expected);
    assert_eq!(
        (
            trace.steps[1].outcome.text.as_str(),
            trace.steps[0].outcome.text.as_str()
        ),
        ("the gripper is empty", "arrived")
    );

    // A call by another name is one of the eleven; as it came it is kept.
    let pick = &trace.steps[2];
    assert_eq!(
        (pick.input.call.name.as_str(), &pick.input.call.arguments),
        ("pick", &json!({"marker_id": 1}))
    );
    assert_eq!(
        pick.input.policy.as_ref().unwrap().raw,
        r#"{"name":"grasp","arguments":{"number":1}}"#
    );
    let thought = trace.steps[0].input.policy.as_ref().unwrap();
    assert_eq!(
        (thought.reasoning.as_str(), thought.latency_ns),
        ("there", Some(1_500_000_000))
    );
    let changes = |step: usize| {
        trace.steps[step]
            .changes
            .registry
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(
        [1, 2, 4, 5].map(changes),
        [
            "",
            &format!("-{APPLE}@table_1"),
            "fridge_0.door: closed -> open",
            &format!("+{APPLE}@fridge_0")
        ]
    );
    assert_eq!(
        (
            pick.object.as_ref().unwrap().as_str(),
            pick.held.as_ref().unwrap().as_str()
        ),
        (APPLE, APPLE)
    );
    assert_eq!(trace.steps[5].held, None);
    let reply = trace.steps[3].reply.as_ref().unwrap();
    assert_eq!(
        (reply.text.as_str(), reply.source),
        ("The white one.", UserSource::Human)
    );

    // What was driven before the episode is not its path.
    let robot = &trace.steps[0].robot;
    assert_eq!(
        (robot.base, robot.path_length_m, trace.start.robot.base),
        ([3.0, 4.0], 7.0, [0.0, 0.0])
    );
    assert!((robot.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    assert_eq!(
        (
            trace.start.shortest_path_m,
            trace.end.as_ref().unwrap().metrics.spl
        ),
        (Some(4.0), None)
    );
    let timing = Timing {
        called_unix_ns: BEGIN_NS + 1_000_000_000,
        took_ns: 1_500_000_000,
    };
    assert_eq!(trace.timings.get(&0), Some(&timing));
    assert_eq!(trace.timings.get(&6), None);

    let steps: Vec<_> = trace
        .robot
        .odometry
        .iter()
        .map(|measured| measured.step)
        .collect();
    assert_eq!(steps, [None, Some(0), Some(0)]);
    let primitive = &trace.robot.primitives[0];
    assert_eq!(
        (
            primitive.step,
            primitive.skill.as_str(),
            primitive.target.as_str(),
            primitive.success
        ),
        (Some(1), "pick", "table", false)
    );
    assert_eq!(
        (
            primitive.duration_ns,
            primitive.control_steps,
            primitive.error.as_deref()
        ),
        (Some(800_000_000), Some(40), Some("slipped"))
    );
    assert_eq!(
        trace
            .robot
            .vla
            .iter()
            .map(|measured| (measured.step, measured.latency_ns))
            .collect::<Vec<_>>(),
        [(Some(1), 250_000_000), (Some(1), 500_000_000)]
    );
    let alignment = &trace.robot.alignments[0];
    assert_eq!(
        (
            alignment.step,
            alignment.target.as_str(),
            alignment.odometry_error_m,
            alignment.image_rmse_px
        ),
        (Some(0), "table", Some(0.0178), None)
    );

    // The image up to the result, else the first after it; a wide one between black bars; each
    // as it came, too.
    let at = |step: Option<u32>, row: usize| {
        let rgb = trace.frame_rgb(step).unwrap().unwrap();
        let at = (row * FRAME_WIDTH + FRAME_WIDTH / 2) * 3;
        [rgb[at], rgb[at + 1], rgb[at + 2]].map(|value| value / 100)
    };
    assert_eq!(
        (at(None, 240), at(Some(0), 240), at(Some(1), 240)),
        ([2, 0, 0], [0, 2, 0], [0, 0, 2])
    );
    assert_eq!(
        (at(Some(0), 20), at(Some(0), FRAME_HEIGHT - 20)),
        ([0, 0, 0], [0, 0, 0])
    );
    assert_eq!(trace.image(Some(2)), None);
    let sent = STANDARD
        .decode(episode()[11].value["data"].as_str().unwrap())
        .unwrap();
    let original = trace.camera_image(Some(0)).unwrap();
    assert_eq!((original.format.as_str(), &original.data), ("jpeg", &sent));
}

#[test]
fn raw_images_in_every_order_of_colours() {
    let place = Place::new();
    let mut messages = Vec::new();
    let orders: [(&str, &[u8], u32); 5] = [
        ("rgb8", &[250, 130, 10], 0),
        ("bgr8", &[10, 130, 250], 6),
        ("rgba8", &[250, 130, 10, 7], 0),
        ("bgra8", &[10, 130, 250, 7], 1),
        ("mono8", &[99], 3),
    ];
    for (number, (encoding, pixel, padding)) in (1..).zip(orders) {
        let row = [pixel.repeat(640), vec![0; padding as usize]].concat();
        let data = STANDARD.encode(row.repeat(480));
        let value = json!({"width": 640, "height": 480, "encoding": encoding, "step": row.len(), "data": data});
        messages.extend([
            call(number * 100, "", "walk_around", json!({})),
            said(number * 100 + 1, "/raw", value),
        ]);
    }
    let broken = json!({"width": 640, "height": 480, "encoding": "rgb8", "step": 1920, "data": ""});
    messages.extend([
        call(900, "", "walk_around", json!({})),
        said(901, "/raw", broken),
    ]);
    let path = place.path("raw.mcap");
    bags::write(&path, &messages, Encoding::Cdr);
    let (recording, trace) = place.import(&path);
    assert!(
        recording.losses[0]
            .message
            .contains("(0 bytes for 640 x 480 pixels in rgb8)"),
        "{:?}",
        recording.losses
    );
    for (step, expected) in [
        (0, [250, 130, 10]),
        (1, [250, 130, 10]),
        (2, [250, 130, 10]),
        (3, [250, 130, 10]),
        (4, [99, 99, 99]),
    ] {
        let rgb = trace.frame_rgb(Some(step)).unwrap().unwrap();
        assert!(
            rgb.chunks_exact(3).all(|pixel| pixel == expected),
            "step {step}"
        );
        // The image of the step is all there is to it.
        assert_eq!(trace.camera_image(Some(step)), None);
    }
    assert_eq!(trace.image(Some(5)), None);
}
