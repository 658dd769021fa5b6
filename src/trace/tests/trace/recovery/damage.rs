//! Damage in the middle of a recording, recovery of what was recovered, and rewriting.

use reel_trace::{Durability, RecordOptions};

use super::*;

/// A crash in `end` may leave a whole part beside the finished trace, or beside
/// half a temporary file.
#[test]
fn a_crash_while_finishing_leaves_everything() {
    let (sample, trace, _) = small();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let part = folder.path().join("x.mcap.part");
    // The part as it is when its end was written: the trace's own messages, without chunks.
    let recorder = sample.record_open(&path, &[], Images::None).unwrap();
    fs::create_dir(&path).unwrap();
    fs::write(
        path.join("keep"),
        "a folder in the way keeps the trace from its name",
    )
    .unwrap();
    assert!(matches!(
        recorder.end(&sample.end),
        Err(TraceError::Write { steps: Some(3), .. })
    ));
    fs::remove_dir_all(&path).unwrap();
    let ended = fs::read(&part).unwrap();

    // Before the rename: the part alone, and rubbish under the temporary name.
    fs::write(folder.path().join("x.mcap.tmp"), &trace[..trace.len() / 2]).unwrap();
    let recovery = restore(&part);
    assert_eq!(
        (
            recovery.restored,
            recovery.source_deleted,
            recovery.lost.len()
        ),
        (RecoveryStatus::Written, true, 0)
    );
    sample.assert_is(&Trace::read(&path).unwrap());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);

    // After it: both, and the finished one wins.
    fs::write(&path, &trace).unwrap();
    fs::write(&part, &ended).unwrap();
    let recovery = restore(&part);
    assert_eq!(
        (
            recovery.restored,
            recovery.source_deleted,
            recovery.lost.len()
        ),
        (RecoveryStatus::Before, true, 0)
    );
    assert_eq!(fs::read(&path).unwrap(), trace);

    // A finished file that is torn does not win, and is not replaced.
    fs::write(&path, &trace[..trace.len() / 2]).unwrap();
    fs::write(&part, &ended).unwrap();
    let recovery = restore(&part);
    assert_eq!(recovery.trace, folder.path().join("x.recovered.mcap"));
    sample.assert_is(&Trace::read(&recovery.trace).unwrap());
    assert_eq!(fs::read(&path).unwrap(), trace[..trace.len() / 2]);
    // Nor is a file of another episode, under either name.
    Source::seeded(8).sample(1).record(&path);
    fs::copy(&path, folder.path().join("x.recovered.mcap")).unwrap();
    fs::write(&part, &ended).unwrap();
    assert!(matches!(
        recover(&part, None, score),
        Err(TraceError::TargetExists { .. })
    ));
    assert!(part.exists());
}

#[test]
fn damage_in_the_middle_is_named_and_what_holds_is_restored() {
    let (sample, frames) = Source::seeded(4).sample(6).with_frames();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let recorder = sample.record_open(&path, &frames, Images::Full).unwrap();
    let part = fs::read(folder.path().join("x.mcap.part")).unwrap();
    recorder.end(&sample.end).unwrap();
    let trace = fs::read(&path).unwrap();
    let out = tempfile::tempdir().unwrap();
    let recovered = |name: &str, bytes: &[u8]| {
        let source = out.path().join(name);
        fs::write(&source, bytes).unwrap();
        let recovery = restore(&source);
        healthy(&recovery.trace);
        let found = examine(&source).unwrap();
        assert!(!found.findings.is_empty(), "{name} looks healthy");
        (recovery, found.findings)
    };

    // Behind the end of a finished file: nothing is lost, but it is said.
    let (recovery, _) = recovered("longer.mcap", &[&trace[..], b"rubbish"].concat());
    assert_eq!(
        (
            recovery.steps,
            recovery.end_recorded,
            recovery.lost.len(),
            recovery.problems.len()
        ),
        (6, true, 0, 1)
    );
    // Behind the last step of a part: it may have been the next call.
    let (recovery, _) = recovered("longer.mcap.part", &[&part[..], b"rubbish"].concat());
    assert_eq!((recovery.steps, recovery.lost.len()), (6, 1));

    // In an image: only that is lost.
    let webp = Trace::from_bytes(&path, &trace, &Default::default())
        .unwrap()
        .image(Some(3))
        .unwrap()
        .to_vec();
    let at = part
        .windows(webp.len())
        .position(|window| window == webp)
        .unwrap()
        + webp.len() / 2;
    let mut bytes = part.clone();
    bytes[at] ^= 1;
    let (recovery, found) = recovered("image.mcap.part", &bytes);
    assert_eq!((recovery.steps, recovery.lost.len()), (6, 1));
    assert!(
        recovery.lost[0].starts_with("the image of step 3 is dropped"),
        "{:?}",
        recovery.lost
    );
    assert_eq!(Trace::read(&recovery.trace).unwrap().image_count(), 6);
    assert!(
        found
            .iter()
            .any(|finding| finding.record == "image" && finding.step == Some(3)),
        "{found:?}"
    );

    // In a call: up to it.
    let call = sample.steps[4].input.call.name.clone();
    let trace_of_part = Trace::from_bytes(&path, &part, &Default::default()).unwrap();
    let mut bytes = part.clone();
    let offset = trace_of_part.offset(4) as usize;
    assert_eq!(bytes[offset], 5, "the message of the call {call}");
    bytes[offset + 9 + 22 + 1] ^= 0x40;
    let (recovery, found) = recovered("call.mcap.part", &bytes);
    assert_eq!(recovery.steps, 4);
    assert_eq!(recovery.lost.len(), 1);
    assert!(
        found
            .iter()
            .any(|finding| finding.step == Some(3) && finding.offset == Some(offset as u64)),
        "{found:?}"
    );

    // In a chunk: as far as the chain holds, and both checksums are named.
    let chunk = Trace::read(&path).unwrap().offset(0) as usize;
    let mut bytes = trace.clone();
    bytes[chunk + 200] ^= 1;
    let (recovery, found) = recovered("chunk.mcap", &bytes);
    assert!(recovery.trace.ends_with("chunk.recovered.mcap") && !recovery.problems.is_empty());
    assert!(
        found
            .iter()
            .any(|finding| finding.record == "chunk" && finding.offset == Some(chunk as u64)),
        "{found:?}"
    );
    assert!(
        found
            .iter()
            .any(|finding| finding.message.contains("data section")),
        "{found:?}"
    );

    // In the task: nothing can be believed, but a file says so.
    let mut bytes = part.clone();
    let at = bytes
        .windows(11)
        .position(|window| window == b"other table")
        .unwrap();
    bytes[at] ^= 1;
    let (recovery, found) = recovered("task.mcap.part", &bytes);
    assert_eq!(
        (recovery.restored, recovery.steps),
        (RecoveryStatus::Nothing, 0)
    );
    assert!(
        found.iter().any(|finding| finding.record == "attachment"),
        "{found:?}"
    );
}

#[test]
fn what_was_recovered_can_be_recovered_again() {
    let (sample, _, part) = small();
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("x.mcap.part");
    fs::write(&source, &part[..part.len() - 1]).unwrap();
    let first = restore(&source);
    assert_eq!(restore(&first.trace).restored, RecoveryStatus::NotNeeded);
    let bytes = fs::read(&first.trace).unwrap();
    fs::write(&first.trace, &bytes[..bytes.len() - 1]).unwrap();
    let second = restore(&first.trace);
    assert_eq!(
        (second.restored, second.lost.len()),
        (RecoveryStatus::Written, 0)
    );
    let trace = Trace::read(&second.trace).unwrap();
    assert_first_steps(&trace, &sample, 2);
    let sources: Vec<&str> = trace
        .recoveries
        .iter()
        .map(|recovery| recovery["source"].as_str())
        .collect();
    assert_eq!(sources, ["x.mcap.part", "x.mcap"]);
}

#[test]
fn rewriting_gives_the_bytes_of_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (sample, frames) = Source::seeded(4).sample(5).with_frames();
    sample
        .record_open(&at("full.mcap"), &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    sample
        .record_open(&at("lean.mcap"), &frames, Images::None)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let bytes = |name: &str| fs::read(at(name)).unwrap();

    let full = Trace::read(&at("full.mcap")).unwrap();
    let summary = full
        .rewrite(&at("compact.mcap"), Images::None, |_| unreachable!())
        .unwrap();
    assert_eq!(
        (summary.bytes, summary.chain),
        (bytes("lean.mcap").len() as u64, full.chain())
    );
    assert!(bytes("compact.mcap") == bytes("lean.mcap"));

    let lean = Trace::read(&at("compact.mcap")).unwrap();
    let rgb =
        |step: Option<u32>| Some(frames[step.map_or(0, |step| step as usize + 1)].rgb.clone());
    lean.rewrite(&at("compact.mcap"), Images::Full, rgb)
        .unwrap();
    assert!(bytes("compact.mcap") == bytes("full.mcap"), "in place");
    full.rewrite(&at("again.mcap"), Images::Full, |step| {
        full.frame_rgb(step).unwrap()
    })
    .unwrap();
    assert!(bytes("again.mcap") == bytes("full.mcap"));

    let wrong = lean
        .rewrite(&at("wrong.mcap"), Images::Full, |_| {
            Some(frames[0].rgb.clone())
        })
        .unwrap_err();
    assert!(
        matches!(wrong, TraceError::Image { step: Some(0), .. }),
        "{wrong}"
    );
    assert!(!at("wrong.mcap").exists());

    // How a trace was recovered stays with it.
    drop(
        sample
            .record_open(&at("part.mcap"), &frames, Images::Full)
            .unwrap(),
    );
    restore(&at("part.mcap.part"));
    let recovered = Trace::read(&at("part.mcap")).unwrap();
    recovered
        .rewrite(&at("small.mcap"), Images::None, |_| None)
        .unwrap();
    Trace::read(&at("small.mcap"))
        .unwrap()
        .rewrite(&at("large.mcap"), Images::Full, rgb)
        .unwrap();
    assert!(bytes("large.mcap") == bytes("part.mcap"));
    assert_eq!(
        Trace::read(&at("large.mcap")).unwrap().recoveries,
        recovered.recoveries
    );
}

#[test]
fn both_durabilities_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let sample = Source::seeded(6).sample(4);
    let bytes = [Durability::Write, Durability::Fsync].map(|durability| {
        assert_eq!(Durability::parse(durability.name()), Some(durability));
        let path = folder.path().join(durability.name());
        let options = RecordOptions {
            images: Images::None,
            durability,
            ..RecordOptions::default()
        };
        sample
            .record_open(&path, &[], options)
            .unwrap()
            .end(&sample.end)
            .unwrap();
        fs::read(path).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
    assert_eq!(Durability::parse("always"), None);
}
