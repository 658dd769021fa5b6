//! Parts and traces that are cut at any byte give exactly what is whole before the cut.

use std::env;

use super::*;

/// Whole steps in the first bytes of a part, by the reader.
fn whole_steps(sample: &Sample, part: &[u8]) -> Vec<(usize, usize)> {
    let folder = tempfile::tempdir().unwrap();
    let mut marks = Vec::new();
    let mut recorder = Recorder::create(
        &folder.path().join("x.mcap"),
        &sample.header,
        &sample.task,
        &sample.scene,
        Images::None,
    )
    .unwrap();
    let size = || {
        fs::metadata(folder.path().join("x.mcap.part"))
            .unwrap()
            .len() as usize
    };
    recorder.start(&sample.start, None).unwrap();
    marks.push((size(), 0));
    for (index, step) in sample.steps.iter().enumerate() {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
        marks.push((size(), index + 1));
    }
    assert_eq!(size(), part.len());
    marks
}

/// Whether there are only whole schemas and channels, which announce a message that did not come.
fn only_announcements(mut tail: &[u8]) -> bool {
    while let [3 | 4, ..] = tail {
        let Some(size) = tail.get(1..9).and_then(|size| size.first_chunk()) else {
            return false;
        };
        let Some(rest) = tail.get(9 + u64::from_le_bytes(*size) as usize..) else {
            return false;
        };
        tail = rest;
    }
    tail.is_empty()
}

/// Every so manieth byte is cut at; `REEL_CUT_STRIDE=1` for the long form.
fn stride() -> usize {
    env::var("REEL_CUT_STRIDE")
        .ok()
        .and_then(|stride| stride.parse().ok())
        .unwrap_or(11)
}

#[test]
fn a_part_cut_anywhere_gives_exactly_its_whole_steps() {
    let (sample, _, part) = small();
    let marks = whole_steps(&sample, &part);
    let folder = quick_folder();
    for length in (0..=part.len()).step_by(stride()) {
        let source = folder.path().join(format!("{length:06}.mcap.part"));
        fs::write(&source, &part[..length]).unwrap();
        let recovery = restore(&source);
        let before = marks.iter().rfind(|(size, _)| *size <= length);
        match (before, Trace::read(&recovery.trace)) {
            (Some((size, steps)), Ok(trace)) => {
                assert_eq!(recovery.restored, RecoveryStatus::Written);
                assert_first_steps(&trace, &sample, *steps);
                let nothing_lost = only_announcements(&part[*size..length]);
                assert_eq!(
                    recovery.lost.is_empty(),
                    nothing_lost,
                    "cut at {length}: {:?}",
                    recovery.lost
                );
                assert_eq!(trace.recoveries.len(), 1);
            }
            (None, Err(TraceError::NothingRestored { .. })) => {
                assert_eq!(recovery.restored, RecoveryStatus::Nothing);
                assert!(!recovery.lost.is_empty());
            }
            (_, result) => panic!(
                "cut at {length}: {:?}",
                result.map(|trace| trace.steps.len())
            ),
        }
        // What is lost stays to be looked at; what is in the trace need not be kept twice.
        assert_eq!(source.exists(), !recovery.lost.is_empty());
        healthy(&recovery.trace);
    }
    python_reads(folder.path(), if stride() == 1 { 1 } else { 7 });
}

#[test]
fn a_trace_cut_anywhere_gives_the_steps_of_its_whole_chunks() {
    let (sample, trace, _) = small();
    let chunk = Trace::from_bytes(Path::new("x"), &trace, &Default::default())
        .unwrap()
        .offset(0) as usize;
    let chunk_end =
        chunk + 9 + u64::from_le_bytes(*trace[chunk + 1..].first_chunk().unwrap()) as usize;
    let (folder, out) = (quick_folder(), quick_folder());
    for length in (0..trace.len()).step_by(stride()) {
        let source = folder.path().join(format!("{length:06}.mcap"));
        fs::write(&source, &trace[..length]).unwrap();
        let recovery = recover(&source, Some(out.path()), score).unwrap();
        assert_eq!(recovery.trace, out.path().join(source.file_name().unwrap()));
        if length >= chunk_end {
            let read = Trace::read(&recovery.trace).unwrap();
            assert_first_steps(&read, &sample, sample.steps.len());
            assert_eq!(read.end.as_ref(), Some(&sample.end));
            assert_eq!(recovery.lost, Vec::<String>::new());
        } else {
            assert!(!recovery.lost.is_empty());
        }
        assert_eq!(
            fs::read(&source).unwrap(),
            trace[..length],
            "the torn file stays as it is"
        );
        healthy(&recovery.trace);
    }
    python_reads(out.path(), if stride() == 1 { 1 } else { 7 });
}

#[test]
fn a_torn_chunk_gives_what_decompresses() {
    // Compression works in blocks of 128 KiB: a torn chunk gives its whole blocks.
    let mut state = 7;
    let mut text = || {
        (0..100)
            .map(|_| format!("{:016x}", random(&mut state)))
            .collect()
    };
    let sample = Source {
        texts: (0..40).map(|_| text()).collect(),
        ..Source::seeded(5)
    }
    .sample(16);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    sample.record(&path);
    let bytes = fs::read(&path).unwrap();
    let chunk = Trace::read(&path).unwrap().offset(0) as usize;
    let length = u64::from_le_bytes(*bytes[chunk + 1..].first_chunk().unwrap()) as usize;
    let mut restored = Vec::new();
    for tenth in 1..10 {
        fs::write(&path, &bytes[..chunk + 9 + length * tenth / 10]).unwrap();
        let out = tempfile::tempdir().unwrap();
        let recovery = recover(&path, Some(out.path()), score).unwrap();
        match Trace::read(&recovery.trace) {
            Ok(trace) => assert_first_steps(&trace, &sample, trace.steps.len()),
            Err(TraceError::NothingRestored { .. }) => {}
            Err(other) => panic!("{other}"),
        }
        restored.push(recovery.steps);
        assert!(
            recovery
                .lost
                .iter()
                .any(|lost| lost.contains("how many calls came after that is not known"))
        );
        healthy(&recovery.trace);
    }
    assert!(
        restored.is_sorted() && restored[8] > 3,
        "steps from so many tenths of a chunk: {restored:?}"
    );
}
