//! Where episodes and steps begin and end: several in a recording, and recordings that name none.

use reel_trace::Timing;
use serde_json::Value;

use super::*;
use crate::bags::TRIALS;

#[test]
fn bare_primitives_are_steps() {
    let place = Place::new();
    let skills = ["pick", "place", "open", "close"];
    let messages: Vec<Said> = (0..600u64)
        .flat_map(|trial| {
            let at = trial * 60_000;
            let success = trial % 10 != 3;
            let value = json!({"skill": skills[trial as usize % 4], "target": "desk", "success": success, "duration_s": 40.0,
                "control_steps": 900, "error": if success { "" } else { "missed" }});
            [odometry(at + 30_000, trial as f64, 0.0), said(at + 50_000, "/primitive", value)]
        })
        .collect();
    let path = place.path("trials.mcap");
    bags::write(&path, &messages, Encoding::Cdr);
    let (recording, traces) = place.import_by(TRIALS, &path, &PLAIN);
    assert_eq!(recording.losses, []);
    let trace = &traces[0];
    assert_eq!(
        (
            trace.steps.len(),
            trace.robot.primitives.len(),
            trace.robot.odometry.len()
        ),
        (600, 600, 600)
    );
    for (number, step) in trace.steps.iter().enumerate() {
        assert_eq!(step.tool.as_deref(), Some(skills[number % 4]));
        assert_eq!(
            step.outcome.error,
            (number % 10 == 3).then_some(ErrorCode::SkillFailed)
        );
        assert_eq!(
            step.outcome.text,
            if number % 10 == 3 { "missed" } else { "" }
        );
        assert_eq!(
            (step.robot.base, step.robot.path_length_m),
            ([number as f32, 0.0], number as f32)
        );
        let called_unix_ns = BEGIN_NS + (number as u64 * 60_000 + 10_000) * 1_000_000;
        assert_eq!(
            trace.timings.get(&step.step),
            Some(&Timing {
                called_unix_ns,
                took_ns: 40_000_000_000
            })
        );
        // Driven while the skill was executed.
        assert_eq!(trace.robot.odometry[number].step, Some(step.step));
        assert_eq!(
            (
                trace.robot.primitives[number].step,
                trace.robot.primitives[number].target.as_str()
            ),
            (Some(step.step), "desk")
        );
    }
    // Equal trials at other times are other episodes.
    let later: Vec<Said> = messages
        .iter()
        .map(|message| Said {
            ns: message.ns + 1,
            ..message.clone()
        })
        .collect();
    bags::write(&path, &later, Encoding::Cdr);
    let (again, _) = place.import_by(TRIALS, &path, &PLAIN);
    assert_ne!(again.episodes[0].trace, recording.episodes[0].trace);
}

#[test]
fn alignment_alone() {
    let place = Place::new();
    let path = place.path("alignment.mcap");
    let value = |error: f64| json!({"target": "desk", "odometry_error_m": error, "yaw_error_rad": 0.01, "image_shift_px": 1.0});
    let messages: Vec<Said> = (1..=20)
        .map(|trial| said(trial * 1_000, "/alignment", value(0.001 * trial as f64)))
        .collect();
    bags::write(&path, &messages, Encoding::Protobuf);
    let (_, traces) = place.import_by(TRIALS, &path, &PLAIN);
    assert_eq!(
        (traces[0].steps.len(), traces[0].robot.alignments.len()),
        (0, 20)
    );
    assert!(
        traces[0]
            .robot
            .alignments
            .iter()
            .all(|alignment| alignment.step.is_none() && alignment.image_shift_px == Some(1.0))
    );
}

#[test]
fn several_episodes_in_a_recording() {
    let place = Place::new();
    let told = |ms: u64, value: Value| said(ms, "/episode", value);
    let messages = vec![
        said(500, "/graph", graph(None, true)),
        told(
            1_000,
            json!({"event": "start", "task_id": "FDO/one", "family": "FDO", "policy": "a", "operator": "Kim"}),
        ),
        call(2_000, "", "nav_to", json!({"receptacle_name": "table_1"})),
        call(3_000, "", "pick", json!({"marker_id": 1})),
        result(4_000, "", "", false),
        told(
            5_000,
            json!({"event": "end", "reason": "max_steps", "success": false}),
        ),
        // Put back between the episodes: no change of either.
        said(5_500, "/graph", graph(Some("table_1"), false)),
        told(6_000, json!({"task_id": "SUL/two", "success": true})),
        call(7_000, "", "finish", json!({})),
        result(7_100, "", "bye", true),
        // Nobody says that the third begins.
        call(8_000, "", "walk_around", json!({})),
        result(9_000, "", "1: a(an) apple.", true),
    ];
    let path = place.path("three.mcap");
    bags::write(&path, &messages, Encoding::Json);
    let (recording, traces) = place.import_by(MAPPING, &path, &PLAIN);
    assert_eq!(recording.losses, []);
    let ends: Vec<_> = recording
        .episodes
        .iter()
        .map(|it| (it.task_id.as_str(), it.steps, it.end, it.success))
        .collect();
    let expected = [
        ("FDO/one", 2, EndReason::Horizon, Some(false)),
        ("SUL/two", 1, EndReason::Finished, None),
        ("unknown", 1, EndReason::Aborted, None),
    ];
    assert_eq!(ends, expected);
    let codes: Vec<_> = traces[0]
        .steps
        .iter()
        .map(|step| step.outcome.error)
        .collect();
    assert_eq!(
        codes,
        [Some(ErrorCode::BackendError), Some(ErrorCode::SkillFailed)]
    );
    assert_eq!(
        (
            traces[0].header.policy.name.as_str(),
            traces[1].header.policy.name.as_str()
        ),
        ("a", "qwen-vl")
    );
    assert_eq!(
        traces[0].header.policy.parameters,
        [("operator".to_owned(), json!("Kim"))].into()
    );
    assert_eq!(
        traces[1]
            .start
            .graphs
            .registry
            .receptacle_of(&APPLE.into())
            .unwrap()
            .as_str(),
        "table_1"
    );
    assert!(
        traces
            .iter()
            .flat_map(|trace| &trace.steps)
            .all(|step| step.changes.registry.is_empty())
    );
}
