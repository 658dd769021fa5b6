//! The hash chain as others check it, and traces of before.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use reel_trace::{Images, Trace, TraceError};
use reel_vectors::{golden_traces, python};

use crate::{damage::rewritten, sample::Source};

/// The program that `docs/spec.md` has for readers.
fn documented() -> String {
    let spec =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/spec.md")).unwrap();
    let from = spec.find("# chain.py TRACE").unwrap();
    let length = spec[from..].find("```").unwrap();
    spec[from..from + length].to_owned()
}

/// The file with a byte changed in the first message of a topic that is longer, and checksums that are right.
fn changed(trace: &[u8], topic: &str) -> Vec<u8> {
    let changed = rewritten(trace, |of, data| {
        let mut data = data.to_vec();
        if of == topic && data.len() > 2 {
            *data.last_mut().unwrap() ^= 1;
        }
        Some(data)
    });
    assert!(changed != rewritten(trace, |_, data| Some(data.to_vec())));
    changed
}

#[test]
fn twenty_lines_of_python_check_what_reel_checks() {
    let Some(python) = python("blake3, mcap") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (sample, frames) = Source::seeded(3).sample(4).with_frames();
    let path = folder.join("sound.mcap");
    let recorder = sample.record_open(&path, &frames, Images::Full).unwrap();
    recorder.end(&sample.end).unwrap();
    let (sound, program) = (fs::read(&path).unwrap(), documented());
    let check = |path: &Path| -> Output {
        Command::new(&python)
            .args(["-c", &program])
            .arg(path)
            .output()
            .unwrap()
    };
    let told = check(&path);
    assert!(told.status.success(), "{told:?}");
    let link = Trace::read(&path).unwrap().chain().to_string();
    assert_eq!(String::from_utf8(told.stdout).unwrap().trim(), link);

    for topic in [
        "/episode",
        "/tool/call",
        "/tool/result",
        "/world/diff",
        "/world/graph",
        "/reward",
        "/sim/digest",
        "/chain",
    ] {
        let path = folder.join("changed.mcap");
        fs::write(&path, changed(&sound, topic)).unwrap();
        assert!(!check(&path).status.success(), "{topic}");
        assert!(Trace::read(&path).is_err(), "{topic}");
    }
    let old = check(&golden_traces()[0]);
    assert_eq!(
        String::from_utf8(old.stdout).unwrap().trim(),
        "no links: an old trace"
    );
}

#[test]
fn what_is_left_out_or_stands_elsewhere_breaks_the_chain() {
    let sample = Source::seeded(3).sample(4);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sound.mcap");
    sample.record(&path);
    let sound = fs::read(&path).unwrap();
    let read = |bytes: &[u8]| Trace::from_bytes(&path, bytes, &reel_trace::Limits::default());
    let without = |topic: &str| rewritten(&sound, |of, data| (of != topic).then(|| data.to_vec()));
    for topic in ["/chain", "/reward", "/tool/call", "/sim/digest"] {
        assert!(read(&without(topic)).is_err(), "{topic}");
    }
    assert!(
        read(&without("/log")).is_ok(),
        "viewers' channels are not covered"
    );
    // metrics are covered, too
    let end = sample.end.metrics.total_reward.to_le_bytes();
    let more = rewritten(&sound, |topic, data| {
        let at = data.windows(end.len()).rposition(|window| window == end);
        let mut data = data.to_vec();
        if let (true, Some(at)) = (topic == "/episode", at) {
            data[at] ^= 1;
        }
        Some(data)
    });
    let error = read(&more).unwrap_err();
    assert!(
        matches!(error, TraceError::ChainBroken { step: Some(3), .. }),
        "{error}"
    );
}

/// The golden traces were recorded before links covered messages.
#[test]
fn old_traces_are_verified_and_keep_every_byte_when_they_are_written_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut changed_steps = 0;
    for path in golden_traces() {
        let (old, bytes) = (Trace::read(&path).unwrap(), fs::read(&path).unwrap());
        let again = folder.path().join("again.mcap");
        let summary = old.rewrite(&again, Images::None, |_| None).unwrap();
        assert!(fs::read(&again).unwrap() == bytes, "{}", path.display());
        assert_eq!(summary.chain, old.chain());
        assert_eq!(
            old.link((old.steps.len() as u32).checked_sub(1)),
            Some(old.chain())
        );
        let forged = changed(&bytes, "/reward");
        let error = Trace::from_bytes(&path, &forged, &reel_trace::Limits::default()).unwrap_err();
        changed_steps += u32::from(matches!(
            error,
            TraceError::ChainBroken { step: Some(_), .. }
        ));
    }
    assert!(changed_steps > 20, "{changed_steps}");
}
