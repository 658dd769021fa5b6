//! Depth and instance masks in traces: kept by whoever writes a trace again, and never believed
//! against their digests.

use std::{fs, path::Path};

use reel_trace::{FrameLayers, Images, RecordOptions, Trace, examine, recover};
use reel_world::{Frame, little_endian};

use crate::{
    recovery::score,
    sample::{Sample, Source},
};

const BOTH: FrameLayers = FrameLayers {
    depth: true,
    masks: true,
};

fn options(images: Images) -> RecordOptions {
    RecordOptions {
        images,
        layers: BOTH,
        ..RecordOptions::default()
    }
}

fn sample() -> (Sample, Vec<Frame>) {
    Source::seeded(8).sample(3).with_frames()
}

/// Asserts that a trace holds the layers of these frames.
fn assert_layers(trace: &Trace, frames: &[Frame]) {
    trace.verify_images().unwrap();
    assert!(trace.has_layers(BOTH));
    let steps = std::iter::once(None).chain(trace.steps.iter().map(|step| Some(step.step)));
    for (step, frame) in steps.zip(frames) {
        assert!(trace.depth_mm(step).unwrap().as_ref() == Some(&frame.depth_mm));
        assert!(trace.instance_ids(step).unwrap().as_ref() == Some(&frame.ids));
    }
}

#[test]
fn layers_come_back_with_images_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let (sample, frames) = sample();
    for images in [Images::Full, Images::None] {
        let path = folder.path().join(format!("{images:?}.mcap"));
        let recorder = sample.record_open(&path, &frames, options(images)).unwrap();
        // Unfinished, too.
        assert_layers(
            &Trace::read(&path.with_added_extension("part")).unwrap(),
            &frames,
        );
        recorder.end(&sample.end).unwrap();
        let trace = Trace::read(&path).unwrap();
        sample.assert_is(&trace);
        assert_layers(&trace, &frames);
        assert!(examine(&path).unwrap().findings.is_empty());
        // Written again without images it has no layers either, and with them it has both.
        let again = folder.path().join("again.mcap");
        let rgb =
            |step: Option<u32>| Some(frames[step.map_or(0, |step| step as usize + 1)].rgb.clone());
        trace.rewrite(&again, Images::Full, rgb).unwrap();
        assert_layers(&Trace::read(&again).unwrap(), &frames);
        trace.rewrite(&again, Images::None, |_| None).unwrap();
        assert!(!Trace::read(&again).unwrap().layers().any());
    }
}

#[test]
fn a_recording_that_broke_off_keeps_its_layers_but_for_spoilt_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (sample, frames) = sample();
    let part = |name: &str| {
        let path = folder.path().join(name);
        drop(
            sample
                .record_open(&path, &frames, options(Images::Full))
                .unwrap(),
        );
        path.with_added_extension("part")
    };
    let whole = recover(&part("whole.mcap"), None, score).unwrap();
    assert_layers(&Trace::read(&whole.trace).unwrap(), &frames);

    let path = part("spoilt.mcap");
    let mut bytes = fs::read(&path).unwrap();
    let depth = little_endian(&frames[2].depth_mm);
    let at = bytes
        .windows(4_000)
        .position(|window| window == &depth[..4_000]);
    bytes[at.unwrap() + 2_001] ^= 1;
    fs::write(&path, bytes).unwrap();
    let spoilt = recover(&path, None, score).unwrap();
    assert!(
        spoilt
            .lost
            .iter()
            .any(|lost| lost.contains("has depth with the digest")),
        "{:?}",
        spoilt.lost
    );
    let trace = Trace::read(&spoilt.trace).unwrap();
    trace.verify_images().unwrap();
    assert_eq!(trace.steps, sample.steps);
    assert!(trace.layers().any() && !trace.has_layers(BOTH));
    let steps = [None, Some(0), Some(1), Some(2)];
    let missing = steps.map(|step| trace.depth_mm(step).unwrap().is_none());
    assert_eq!(missing.iter().filter(|missing| **missing).count(), 1);
    assert!(examine(&spoilt.trace).unwrap().findings.is_empty());
}

#[test]
fn layers_of_another_size_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (sample, mut frames) = sample();
    frames[1].depth_mm.pop();
    let path: &Path = &folder.path().join("x.mcap");
    let Err(error) = sample.record_open(path, &frames, options(Images::Full)) else {
        panic!("a frame without a pixel of depth is recorded");
    };
    assert!(
        error.to_string().contains("bytes of depth instead of"),
        "{error}"
    );
}
