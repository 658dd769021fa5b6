//! Calls that were under way: in the simulator they are lost and named, on a robot they happened.

use std::collections::BTreeMap;

use reel_trace::{RestoreScorer, Timing, encode_png};
use reel_world::{
    FRAME_HEIGHT, FRAME_WIDTH,
    record::{RewardTerm, StepRecord},
};

use super::*;

#[test]
fn a_call_under_way_is_named_and_kept_as_evidence() {
    let sample = Source::seeded(3).sample(2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let mut recorder = sample.record_open(&path, &[], Images::None).unwrap();
    let mut input = sample.steps[0].input.clone();
    input.call = reel_world::ToolCall::new("pick", serde_json::json!({"marker_id": 2}));
    recorder.input(2, &input).unwrap();
    let part = folder.path().join("x.mcap.part");
    let busy = recover(&part, None, score).unwrap_err();
    assert!(matches!(busy, TraceError::InUse { .. }), "{busy}");
    drop(recorder);
    let recovery = restore(&part);
    assert_eq!(
        recovery.lost,
        ["call 2 `pick(marker_id=2)` was under way and is lost"]
    );
    assert!(!recovery.source_deleted && part.exists());
    let trace = Trace::read(&path).unwrap();
    assert_first_steps(&trace, &sample, 2);
    let said = &trace.recoveries[0];
    assert_eq!(
        (
            said["source"].as_str(),
            said["steps_restored"].as_str(),
            said["end"].as_str()
        ),
        ("x.mcap.part", "2", "aborted")
    );
    assert_eq!(said["lost"], recovery.lost[0]);
    // A second time it finds its work done, and tells the same.
    let again = restore(&part);
    assert_eq!(
        (again.restored, again.lost, again.trace),
        (RecoveryStatus::Before, recovery.lost, path)
    );
}

/// Stands for a preset, which gives terms too.
struct Scored;

impl RestoreScorer for Scored {
    fn metrics(&self, trace: &Trace, graphs: &Graphs) -> Metrics {
        score(trace, graphs)
    }

    fn terms(&self, _: &Trace, _: &StepRecord) -> Option<Vec<RewardTerm>> {
        Some(vec![RewardTerm {
            component: "safe".into(),
            value: -0.5,
            reason: String::new(),
        }])
    }
}

/// A call that was passed on to a robot happened, whether its result was written or not. Its
/// images came in Base64.
#[test]
fn a_call_under_way_in_another_world_is_restored() {
    let mut sample = Source::seeded(3).sample(2);
    sample.header.backend = Backend::Robot;
    sample.start.digests.frame = None;
    sample
        .steps
        .iter_mut()
        .for_each(|step| step.digests.frame = None);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let rgb: Vec<u8> = (0..FRAME_WIDTH * FRAME_HEIGHT * 3)
        .map(|index| (index * index / 7 % 251) as u8)
        .collect();
    let png = encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    let base64 = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, png);
    let timing = Timing {
        called_unix_ns: 7,
        took_ns: 9,
    };
    let redacted = BTreeMap::from([("token".to_owned(), 2)]);
    let record = |path: &Path| {
        let mut recorder = Recorder::create(
            path,
            &sample.header,
            &sample.task,
            &sample.scene,
            Images::Full,
        )
        .unwrap();
        recorder.redacted(None, &redacted).unwrap();
        recorder.start_with_base64(&sample.start, &base64).unwrap();
        recorder.input(0, &sample.steps[0].input).unwrap();
        recorder.timing(0, &timing).unwrap();
        recorder.redacted(Some(0), &redacted).unwrap();
        recorder
            .step_with_base64(&sample.steps[0], "bm8gcGljdHVyZQ==")
            .unwrap();
        recorder.input(1, &sample.steps[1].input).unwrap();
        recorder
    };
    drop(record(&path));
    let recovery = recover(&folder.path().join("x.mcap.part"), None, Scored).unwrap();
    assert_eq!(
        (recovery.steps, recovery.lost.len(), recovery.source_deleted),
        (2, 0, true)
    );
    let trace = Trace::read(&path).unwrap();
    healthy(&path);
    assert_eq!(trace.steps[0], sample.steps[0]);
    assert_eq!(
        (&trace.steps[1].input, trace.steps[1].reward_total()),
        (&sample.steps[1].input, -0.5)
    );
    assert_eq!(trace.steps[1].outcome.error, Some(ErrorCode::BackendError));
    assert_eq!(
        (
            trace.frame_rgb(None).unwrap(),
            trace.frame_rgb(Some(0)).unwrap()
        ),
        (Some(rgb.clone()), None)
    );
    assert_eq!(trace.timings.get(&0), Some(&timing));
    assert_eq!(trace.redacted(), BTreeMap::from([("token", 4)]));

    let whole = folder.path().join("whole.mcap");
    let mut recorder = record(&whole);
    recorder.step(&sample.steps[1], None).unwrap();
    recorder.end(&sample.end).unwrap();
    let trace = Trace::read(&whole).unwrap();
    sample.assert_is(&trace);
    assert_eq!(
        (
            trace.frame_rgb(None).unwrap(),
            trace.image_count(),
            trace.timings.len()
        ),
        (Some(rgb), 1, 1)
    );
    // Written again it keeps its clock.
    let again = folder.path().join("again.mcap");
    trace.rewrite(&again, Images::None, |_| None).unwrap();
    let again = Trace::read(&again).unwrap();
    assert_eq!(
        (again.timings, again.redactions),
        (trace.timings, trace.redactions)
    );
}
