//! What a robot measured: it comes back as it was written, in turn, through rewriting and recovery;
//! and traces without it have none of its channels.

use std::{fs, path::Path};

use reel_trace::{
    Images, RecordOptions, Recorder, Trace, TraceError, content, examine, recover,
    robot::{Alignment, CameraImage, Odometry, PrimitiveOutcome, RobotLog, VlaLatency},
};
use reel_world::{
    Frame,
    record::{Backend, Graphs, Metrics},
};

use crate::sample::{Sample, Source};

const TOPICS: [&str; 5] = reel_world::words! {
    "/robot/odometry" "/robot/primitive" "/robot/vla" "/robot/alignment" "/camera/original"
};

fn sample() -> (Sample, Vec<Frame>) {
    let (mut sample, frames) = Source::seeded(5).sample(2).with_frames();
    sample.header.backend = Backend::Robot;
    (sample, frames)
}

/// Two of everything: before the first step, and in every step; with values at their edges.
fn log() -> RobotLog {
    let mut log = RobotLog::default();
    for (unix_ns, step) in [(0, None), (u64::MAX, Some(0)), (7, Some(1))] {
        log.odometry.push(Odometry {
            step,
            unix_ns,
            x: -0.0,
            y: 1e300,
            yaw: -std::f64::consts::PI,
        });
        log.odometry.push(Odometry {
            step,
            unix_ns,
            x: 0.1,
            y: f64::MIN_POSITIVE / 2.0,
            yaw: 0.0,
        });
        log.primitives.push(PrimitiveOutcome {
            step,
            unix_ns,
            skill: "place".into(),
            target: "desk".into(),
            success: step.is_some(),
            duration_ns: Some(60_000_000_000),
            control_steps: Some(1000),
            error: Some(String::new()),
        });
        log.primitives.push(PrimitiveOutcome {
            step,
            unix_ns,
            ..PrimitiveOutcome::default()
        });
        log.vla.push(VlaLatency {
            step,
            unix_ns,
            latency_ns: u64::MAX,
        });
        log.alignments.push(Alignment {
            step,
            unix_ns,
            target: "größer".into(),
            odometry_error_m: Some(0.0178),
            yaw_error_rad: Some(-0.0),
            image_shift_px: None,
            image_rmse_px: Some(1.96),
        });
    }
    log
}

fn original(step: Option<u32>) -> CameraImage {
    CameraImage {
        format: "jpeg".into(),
        data: vec![step.map_or(9, |step| step as u8); 100],
    }
}

/// Everything but the end.
fn record_open(path: &Path, options: impl Into<RecordOptions>) -> Recorder {
    let (sample, frames) = sample();
    let log = log();
    let mut recorder =
        Recorder::create(path, &sample.header, &sample.task, &sample.scene, options).unwrap();
    recorder.robot(None, &log).unwrap();
    recorder.original(None, &original(None)).unwrap();
    recorder.start(&sample.start, frames.first()).unwrap();
    for (index, step) in sample.steps.iter().enumerate() {
        recorder.input(step.step, &step.input).unwrap();
        recorder.robot(Some(step.step), &log).unwrap();
        recorder
            .original(Some(step.step), &original(Some(step.step)))
            .unwrap();
        recorder.step(step, frames.get(index + 1)).unwrap();
    }
    recorder
}

fn healthy(path: &Path) {
    let found = examine(path).unwrap();
    assert!(found.findings.is_empty(), "{found:?}");
}

#[test]
fn what_was_measured_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let (sample, frames) = sample();
    record_open(&path, Images::Full).end(&sample.end).unwrap();
    healthy(&path);
    let trace = Trace::read(&path).unwrap();
    sample.assert_is(&trace);
    // Debug tells zero from minus zero.
    assert_eq!(format!("{:?}", trace.robot), format!("{:?}", log()));
    for step in [None, Some(0), Some(1)] {
        assert_eq!(trace.camera_image(step), Some(&original(step)));
        assert!(trace.frame_rgb(step).unwrap().is_some());
    }
    assert_eq!(trace.camera_image(Some(2)), None);
    let shares = content(&reel_trace::TraceFiles::default(), &path).unwrap();
    assert!(
        TOPICS.iter().all(|topic| shares.contains_key(*topic)),
        "{shares:?}"
    );

    let read = reel_trace::RecordsReader::default().read(&path).unwrap();
    assert_eq!(
        (&read.robot, read.camera_image(None), read.image_count()),
        (&trace.robot, None, 0)
    );

    // Written again it is the same file; without images it keeps what was measured.
    let again = folder.path().join("again.mcap");
    trace
        .rewrite(&again, Images::Full, |step| {
            Some(frames[step.map_or(0, |step| step as usize + 1)].rgb.clone())
        })
        .unwrap();
    assert_eq!(fs::read(&again).unwrap(), fs::read(&path).unwrap());
    let lean = folder.path().join("lean.mcap");
    trace.rewrite(&lean, Images::None, |_| None).unwrap();
    let lean_trace = Trace::read(&lean).unwrap();
    assert_eq!(
        (&lean_trace.robot, lean_trace.camera_image(None)),
        (&trace.robot, None)
    );
    let bare = folder.path().join("bare.mcap");
    record_open(&bare, Images::None).end(&sample.end).unwrap();
    assert_eq!(fs::read(&lean).unwrap(), fs::read(&bare).unwrap());
}

#[test]
fn traces_without_a_robot_have_none_of_its_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let (sample, frames) = sample();
    sample
        .record_open(&path, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let shares = content(&reel_trace::TraceFiles::default(), &path).unwrap();
    assert!(
        TOPICS.iter().all(|topic| !shares.contains_key(*topic)),
        "{shares:?}"
    );
    assert!(Trace::read(&path).unwrap().robot.is_empty());
}

#[test]
fn a_recording_that_broke_off_keeps_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let (path, part) = (
        folder.path().join("x.mcap"),
        folder.path().join("x.mcap.part"),
    );
    let mut recorder = record_open(&path, Images::Full);
    // A third call is under way, with a measurement.
    recorder.input(2, &sample().0.steps[0].input).unwrap();
    recorder
        .odometry(&Odometry {
            step: Some(2),
            unix_ns: 1,
            x: 1.0,
            y: 2.0,
            yaw: 3.0,
        })
        .unwrap();
    // Acknowledged with what follows; so the operating system has it, as in a recorder
    // that is dropped whole.
    drop(recorder);
    let score = |_: &Trace, _: &Graphs| Metrics::default();
    let recovery = recover(&part, None, score).unwrap();
    assert_eq!((recovery.steps, recovery.lost.len()), (2, 1));
    healthy(&path);
    let trace = Trace::read(&path).unwrap();
    assert_eq!(trace.robot, log());
    assert_eq!(
        (trace.camera_image(None), trace.camera_image(Some(1))),
        (Some(&original(None)), Some(&original(Some(1))))
    );
    assert_eq!(trace.image_count(), 3);
    // A second time there is nothing left to do.
    let again = recover(&part, None, score).unwrap();
    assert_eq!(
        (again.restored, again.trace),
        (reel_trace::RecoveryStatus::Before, path)
    );
}

#[test]
fn what_is_out_of_turn_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (sample, _) = sample();
    let path = folder.path().join("x.mcap");
    let mut recorder = Recorder::create(
        &path,
        &sample.header,
        &sample.task,
        &sample.scene,
        Images::None,
    )
    .unwrap();
    let at = |step| Odometry {
        step,
        ..Odometry::default()
    };
    let refused = |written: Result<(), TraceError>| {
        assert!(
            matches!(written, Err(TraceError::UnexpectedCall { .. })),
            "{written:?}"
        )
    };
    refused(recorder.odometry(&at(Some(0))));
    recorder.start(&sample.start, None).unwrap();
    refused(recorder.odometry(&at(None)));
    refused(recorder.odometry(&at(Some(0))));
    recorder.input(0, &sample.steps[0].input).unwrap();
    refused(recorder.vla(&VlaLatency {
        step: Some(1),
        ..VlaLatency::default()
    }));
    refused(recorder.primitive(&PrimitiveOutcome::default()));
    refused(recorder.alignment(&Alignment::default()));
    refused(recorder.original(
        None,
        &CameraImage {
            format: "png".into(),
            data: vec![],
        },
    ));
    recorder.odometry(&at(Some(0))).unwrap();
    recorder.step(&sample.steps[0], None).unwrap();
}
