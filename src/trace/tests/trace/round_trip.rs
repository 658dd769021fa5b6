//! What is recorded is what is read; equal records give equal bytes.

use std::fs;

use proptest::prelude::*;
use reel_trace::{Images, Recorder, Trace, TraceError};
use reel_world::{DoorState, record::UserReply};
use serde_json::Value;

use crate::sample::{Sample, Source};

fn any_value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        any::<f64>().prop_map(Value::from),
        ".*".prop_map(Value::from),
    ];
    leaf.prop_recursive(3, 12, 4, |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
            proptest::collection::vec((".*", inner), 0..4)
                .prop_map(|map| Value::Object(map.into_iter().collect())),
        ]
    })
}

fn any_sample() -> impl Strategy<Value = Sample> {
    let texts = proptest::collection::vec(".{0,12}", 1..12);
    let floats = proptest::collection::vec(prop_oneof![any::<f32>(), Just(-0.0)], 1..12);
    let values = proptest::collection::vec(any_value(), 1..6);
    (texts, floats, values, any::<u64>(), 0..5u32).prop_map(
        |(texts, floats, values, state, steps)| {
            Source {
                texts,
                floats,
                values,
                state,
            }
            .sample(steps)
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]
    #[test]
    fn any_records_come_back(sample in any_sample()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let summary = sample.record(&path);
        let trace = Trace::read(&path).unwrap();
        sample.assert_is(&trace);
        prop_assert_eq!(summary.chain, trace.chain());
        prop_assert_eq!(summary.bytes, fs::metadata(&path).unwrap().len());
    }
}

#[test]
fn every_option_occurs_set_and_unset() {
    let samples: Vec<Sample> = (0..20).map(|seed| Source::seeded(seed).sample(3)).collect();
    let both = |has: &dyn Fn(&Sample) -> bool| {
        assert!(
            samples.iter().any(has) && !samples.iter().all(has),
            "an option is always or never set"
        );
    };
    both(&|s| s.header.group_id.is_some());
    both(&|s| s.header.parent.is_some());
    both(&|s| s.start.shortest_path_m.is_some());
    both(&|s| s.end.metrics.spl.is_some());
    both(&|s| s.steps[0].input.policy.is_some());
    both(&|s| s.steps[0].input.user_reply.is_some());
    both(&|s| s.steps[0].outcome.error.is_some());
    both(&|s| s.steps[0].tool.is_some());
    both(&|s| s.steps[0].held.is_some());
    both(&|s| s.steps[0].digests.frame.is_some());
    both(&|s| {
        s.start
            .graphs
            .physics
            .receptacles
            .values()
            .any(|state| state.door == Some(DoorState::Open))
    });
}

#[test]
fn equal_records_give_equal_bytes_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let (sample, frames) = Source::seeded(4).sample(3).with_frames();
    let (a, b) = (
        folder.path().join("a.mcap"),
        folder.path().join("another name.mcap"),
    );
    for path in [&a, &b] {
        sample
            .record_open(path, &frames, Images::Full)
            .unwrap()
            .end(&sample.end)
            .unwrap();
    }
    assert_eq!(fs::read(a).unwrap(), fs::read(b).unwrap());
}

#[test]
fn images_come_back_and_must_be_the_recorded_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (mut sample, mut frames) = Source::seeded(4).sample(2).with_frames();
    let path = folder.path().join("a.mcap");
    sample
        .record_open(&path, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let trace = Trace::read(&path).unwrap();
    sample.assert_is(&trace);
    assert_eq!(trace.image_count(), 3);
    trace.verify_images().unwrap();
    assert_eq!(trace.frame_rgb(None).unwrap().unwrap(), frames[0].rgb);
    assert_eq!(trace.frame_rgb(Some(1)).unwrap().unwrap(), frames[2].rgb);
    assert_eq!(trace.frame_rgb(Some(2)).unwrap(), None);

    frames.swap(0, 1);
    let other = folder.path().join("b.mcap");
    sample
        .record_open(&other, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let swapped = Trace::read(&other).unwrap();
    assert!(matches!(
        swapped.verify_images(),
        Err(TraceError::Image { step: None, .. })
    ));
    assert!(matches!(
        swapped.frame_rgb(Some(0)),
        Err(TraceError::Image { step: Some(0), .. })
    ));

    sample.start.digests.frame = None;
    let lean = folder.path().join("c.mcap");
    sample
        .record_open(&lean, &frames, Images::None)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    assert_eq!(Trace::read(&lean).unwrap().image_count(), 0);
}

#[test]
fn the_recorder_refuses_what_is_out_of_turn() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let sample = Source::seeded(1).sample(2);
    let create = || {
        Recorder::create(
            &path,
            &sample.header,
            &sample.task,
            &sample.scene,
            Images::None,
        )
    };
    let mut recorder = create().unwrap();
    assert!(matches!(create(), Err(TraceError::PartExists { .. })));
    let step = &sample.steps[0];
    let refused = recorder.input(0, &step.input).unwrap_err().to_string();
    assert!(
        refused.starts_with("cannot record the input of step 0: the start comes next: "),
        "{refused}"
    );
    recorder.start(&sample.start, None).unwrap();
    assert!(matches!(
        recorder.step(step, None),
        Err(TraceError::UnexpectedCall { .. })
    ));
    assert!(matches!(
        recorder.input(1, &step.input),
        Err(TraceError::UnexpectedCall { .. })
    ));
    recorder.input(0, &step.input).unwrap();
    let mut other = step.clone();
    other.input.user_reply = Some(UserReply {
        text: "no".into(),
        source: reel_world::record::UserSource::Human,
    });
    assert!(matches!(
        recorder.step(&other, None),
        Err(TraceError::UnexpectedCall { .. })
    ));
    recorder.step(step, None).unwrap();
    assert!(matches!(
        recorder.end(&sample.end),
        Err(TraceError::UnexpectedCall { .. })
    ));

    let mut header = sample.header.clone();
    header.task_digest = header.scene_digest;
    let other = Recorder::create(
        &folder.path().join("b.mcap"),
        &header,
        &sample.task,
        &sample.scene,
        Images::None,
    );
    assert!(matches!(
        other,
        Err(TraceError::Attachment {
            attachment: "task.json",
            ..
        })
    ));
}

#[test]
fn offsets_lead_to_records() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let sample = Source::seeded(2).sample(4);
    drop(sample.record_open(&path, &[], Images::None).unwrap());
    let part = folder.path().join("a.mcap.part");
    let trace = Trace::read(&part).unwrap();
    let bytes = fs::read(&part).unwrap();
    let offsets: Vec<u64> = (0..4).map(|step| trace.offset(step)).collect();
    assert!(
        offsets.is_sorted() && offsets.iter().all(|offset| bytes[*offset as usize] == 5),
        "message records: {offsets:?}"
    );
    assert!(trace.end.is_none());
    assert!(matches!(
        Trace::read(&path),
        Err(TraceError::Unfinished { .. })
    ));

    let path = folder.path().join("b.mcap");
    sample.record(&path);
    let (trace, bytes) = (Trace::read(&path).unwrap(), fs::read(&path).unwrap());
    assert_eq!(bytes[trace.offset(3) as usize], 6, "a chunk record");
}
