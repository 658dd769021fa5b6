//! Recordings that broke off: killed writers, cuts at every byte, flipped bytes, a full disk.
//! Whatever happened, what was acknowledged is there afterwards, in a file that reopens and
//! that other programs read.

mod damage;

use std::{
    collections::BTreeMap,
    env, fs,
    io::{BufRead, BufReader, Read, Write},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use reel_trace::{
    Durability, Images, RecordOptions, Recorder, Recovery, RecoveryStatus, RestoreScorer, Timing,
    Trace, TraceError, encode_png, examine, recover,
};
use reel_world::{
    ErrorCode, FRAME_HEIGHT, FRAME_WIDTH, Frame,
    record::{Backend, EndReason, Graphs, Metrics, RewardTerm, StepRecord},
};

use crate::sample::{Sample, Source};

/// Stands for `reel_reward::metrics`, of which this crate knows nothing.
pub fn score(trace: &Trace, _: &Graphs) -> Metrics {
    Metrics {
        success: false,
        completion: 0.25,
        total_reward: trace.steps.iter().map(|step| step.reward_total()).sum(),
        discounted_return: 0.0,
        length: trace.steps.len() as u32,
        asks: 0,
        spl: None,
    }
}

fn restore(source: &Path) -> Recovery {
    recover(source, None, score).unwrap_or_else(|error| panic!("{}: {error}", source.display()))
}

fn healthy(path: &Path) {
    let found = examine(path).unwrap().findings;
    assert!(found.is_empty(), "{}: {found:?}", path.display());
}

/// Asserts that a trace holds exactly the first steps of a sample, and an end that fits.
fn assert_first_steps(trace: &Trace, sample: &Sample, steps: usize) {
    assert_eq!(trace.header, sample.header);
    assert_eq!(
        (&*trace.task, &*trace.scene, &trace.start),
        (&sample.task, &sample.scene, &sample.start)
    );
    assert_eq!(trace.steps, sample.steps[..steps]);
    let end = trace.end.as_ref().expect("a recovered trace has an end");
    if *end != sample.end {
        let error = trace.steps.last().and_then(|step| step.outcome.error);
        let horizon = trace.header.profile.horizon() as usize;
        let reason = match trace.header.backend {
            Backend::Sim if error == Some(ErrorCode::PhysicsFault) => EndReason::Fault,
            Backend::Sim if steps >= horizon => EndReason::Horizon,
            _ => EndReason::Aborted,
        };
        assert_eq!((end.reason, end.steps), (reason, steps as u32));
        assert_eq!(end.metrics, score(trace, &end.graphs));
        let mut graphs = sample.start.graphs.clone();
        trace.steps.iter().for_each(|step| {
            graphs.physics.apply(&step.changes.physics);
            graphs.registry.apply(&step.changes.registry);
        });
        assert_eq!(end.graphs, graphs);
    }
}

/// A seed that changes from run to run, but can be given.
fn seed() -> u64 {
    let seed = env::var("REEL_SEED")
        .ok()
        .and_then(|seed| seed.parse().ok());
    seed.unwrap_or_else(|| {
        u64::from(std::process::id()) ^ env::temp_dir().metadata().map_or(0, |m| m.len())
    })
}

fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

const CHILD: &str = "REEL_RECORD_INTO";

/// The sample of an episode that the child records: short ones, so that kills hit the end, too.
fn episode(index: u64) -> (Sample, Vec<Frame>) {
    let sample = Source::seeded(index + 1).sample(4 + (index % 3) as u32 * 8);
    if index % 4 == 3 {
        sample.with_frames()
    } else {
        (sample, Vec::new())
    }
}

fn options(index: u64) -> RecordOptions {
    let durability = if index.is_multiple_of(2) {
        Durability::Write
    } else {
        Durability::Fsync
    };
    RecordOptions {
        images: Images::Full,
        durability,
        ..RecordOptions::default()
    }
}

/// Not a test of its own: the process that the others kill or starve. Says `ack` after
/// each call that returned.
#[test]
fn child() {
    let Some(folder) = env::var_os(CHILD) else {
        return;
    };
    let mut out = std::io::stdout();
    // The test harness leaves its own line open.
    let mut say = |text: String| {
        writeln!(out, "\n{text}")
            .and_then(|()| out.flush())
            .unwrap()
    };
    for index in 0.. {
        let (sample, frames) = episode(index);
        let path = Path::new(&folder).join(format!("{index:04}.mcap"));
        let failed = |error: TraceError| -> ! {
            println!("\nfailed {index} {error}");
            std::process::exit(7);
        };
        let mut recorder = Recorder::create(
            &path,
            &sample.header,
            &sample.task,
            &sample.scene,
            options(index),
        )
        .unwrap_or_else(|error| failed(error));
        recorder
            .start(&sample.start, frames.first())
            .unwrap_or_else(|error| failed(error));
        say(format!("ack {index} 0"));
        for (step, record) in sample.steps.iter().enumerate() {
            recorder
                .input(record.step, &record.input)
                .unwrap_or_else(|error| failed(error));
            recorder
                .step(record, frames.get(step + 1))
                .unwrap_or_else(|error| failed(error));
            say(format!("ack {index} {}", step + 1));
        }
        recorder
            .end(&sample.end)
            .unwrap_or_else(|error| failed(error));
        say(format!("done {index}"));
    }
}

/// What a child said last of each episode: acknowledged steps, and whether it was done.
#[derive(Default)]
struct Heard {
    acks: BTreeMap<u64, (usize, bool)>,
    failure: Option<String>,
}

impl Heard {
    fn line(&mut self, line: &str) -> bool {
        let mut words = line.split(' ');
        let (kind, index) = (
            words.next(),
            words.next().and_then(|word| word.parse().ok()),
        );
        match (kind, index) {
            (Some("ack"), Some(index)) => {
                let steps = words
                    .next()
                    .and_then(|word| word.parse().ok())
                    .expect("an ack names its steps");
                self.acks.entry(index).or_default().0 = steps;
            }
            (Some("done"), Some(index)) => self.acks.entry(index).or_default().1 = true,
            (Some("failed"), _) => self.failure = Some(line.to_owned()),
            _ => return false,
        }
        true
    }
}

fn child_command(folder: &Path) -> Command {
    let mut command = Command::new(env::current_exe().unwrap());
    command
        .args([
            "--exact",
            "recovery::child",
            "--nocapture",
            "--test-threads=1",
        ])
        .env(CHILD, folder);
    command.stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

/// Recovers a folder that a child left and compares it with what the child was told is safe.
fn check_folder(folder: &Path, heard: &Heard) -> (usize, usize) {
    let (mut parts, mut lost) = (0, 0);
    for part in files(folder, "part") {
        parts += 1;
        let recovery = restore(&part);
        lost += usize::from(!recovery.lost.is_empty());
        assert_eq!(part.exists(), !recovery.source_deleted);
    }
    for (index, (acknowledged, done)) in &heard.acks {
        let path = folder.join(format!("{index:04}.mcap"));
        let trace = Trace::read(&path).unwrap_or_else(|error| panic!("episode {index}: {error}"));
        let (sample, frames) = episode(*index);
        assert!(
            trace.steps.len() >= *acknowledged,
            "{} of {acknowledged} acknowledged calls",
            trace.steps.len()
        );
        assert_first_steps(&trace, &sample, trace.steps.len());
        assert_eq!(
            trace.image_count(),
            if frames.is_empty() {
                0
            } else {
                trace.steps.len() + 1
            }
        );
        assert!(
            !done || trace.end.as_ref() == Some(&sample.end),
            "episode {index} was done"
        );
        healthy(&path);
    }
    (parts, lost)
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .collect();
    paths.sort();
    paths
}

/// `REEL_KILLS=200` for the long form, `REEL_SEED` to repeat one.
#[cfg(unix)]
#[test]
fn a_killed_recorder_loses_nothing_acknowledged() {
    let kills: u64 = env::var("REEL_KILLS")
        .ok()
        .and_then(|kills| kills.parse().ok())
        .unwrap_or(20);
    let seed = seed();
    eprintln!("{kills} kills, REEL_SEED={seed}");
    let mut state = seed | 1;
    let (mut parts, mut lost, recovered) = (0, 0, quick_folder());
    for _ in 0..kills {
        let folder = tempfile::tempdir().unwrap();
        let mut child = child_command(folder.path()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap());
        let (mut heard, mut line) = (Heard::default(), String::new());
        let mut after = random(&mut state) % 60;
        while after > 0 && lines.read_line(&mut line).unwrap() > 0 {
            after -= u64::from(heard.line(line.trim_end()));
            line.clear();
        }
        thread::sleep(Duration::from_micros(random(&mut state) % 3000));
        child.kill().unwrap();
        child.wait().unwrap();
        let mut rest = String::new();
        lines.read_to_string(&mut rest).unwrap();
        // A last line that was cut says nothing.
        for line in rest
            .split_inclusive('\n')
            .filter_map(|line| line.strip_suffix('\n'))
        {
            heard.line(line);
        }
        assert_eq!(heard.failure, None);
        let (more, torn) = check_folder(folder.path(), &heard);
        for trace in files(folder.path(), "mcap") {
            if Trace::read(&trace).is_ok_and(|trace| !trace.recoveries.is_empty()) {
                fs::copy(
                    &trace,
                    recovered.path().join(format!(
                        "{parts:04}-{}",
                        trace.file_name().unwrap().display()
                    )),
                )
                .unwrap();
            }
        }
        parts += more;
        lost += torn;
    }
    eprintln!("{parts} parts were left, {lost} with something under way");
    assert!(parts > 0, "no kill hit a recording");
    python_reads(recovered.path(), 1);
}

/// A limit on the size of files stands for the full disk: the write fails in the middle of a record
/// in the same way.
#[cfg(unix)]
#[test]
fn a_full_disk_loses_nothing_acknowledged() {
    // A part begins with some 14 KiB of schemas, task and scene.
    let mut begun = 0;
    for kib in [8, 16, 20, 25, 30, 40, 60] {
        let folder = tempfile::tempdir().unwrap();
        let child = child_command(folder.path());
        let mut bash = Command::new("bash");
        // Files of the shell count in blocks of 1024 bytes; ignored, the signal
        // turns into an error.
        bash.args([
            "-c",
            &format!("trap '' XFSZ; ulimit -f {kib}; exec \"$@\""),
            "bash",
        ]);
        bash.arg(child.get_program())
            .args(child.get_args())
            .env(CHILD, folder.path())
            .stderr(Stdio::null());
        let output = bash.output().unwrap();
        let mut heard = Heard::default();
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            heard.line(line);
        }
        let failure = heard.failure.take().expect("the child ran into the limit");
        assert!(failure.contains("File too large"), "{failure}");
        if heard.acks.values().any(|(_, done)| !done) {
            begun += 1;
            assert!(
                failure.contains("what was acknowledged before (the start and"),
                "{failure}"
            );
            assert!(
                failure.contains("then `reel trace recover` it") && failure.ends_with(".mcap.part"),
                "{failure}"
            );
        }
        check_folder(folder.path(), &heard);
        assert!(files(folder.path(), "tmp").is_empty());
    }
    assert!(begun > 2, "{begun} limits were hit inside an episode");
}

/// A small episode, its finished bytes and those of its part, cut just before the end.
fn small() -> (Sample, Vec<u8>, Vec<u8>) {
    let sample = Source::seeded(3).sample(3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let recorder = sample.record_open(&path, &[], Images::None).unwrap();
    let part = fs::read(folder.path().join("x.mcap.part")).unwrap();
    recorder.end(&sample.end).unwrap();
    (sample, fs::read(&path).unwrap(), part)
}

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

/// In memory, where there is such a folder: syncing tens of thousands of files takes minutes on a
/// disk. Every so manieth byte is cut at; `REEL_CUT_STRIDE=1` for the long form.
fn stride() -> usize {
    env::var("REEL_CUT_STRIDE")
        .ok()
        .and_then(|stride| stride.parse().ok())
        .unwrap_or(11)
}

fn quick_folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

const PYTHON: &str = r"
import pathlib, sys
from mcap.reader import make_reader, NonSeekingReader
count = 0
for path in sorted(pathlib.Path(sys.argv[1]).glob('*.mcap'))[::int(sys.argv[2])]:
    with open(path, 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        messages = sum(1 for _ in reader.iter_messages())
        names = [metadata.name for metadata in reader.iter_metadata()]
        assert 'reel.recovery' in names, (path, names)
        assert reader.get_summary().statistics.message_count == messages, path
        attachments = sum(1 for _ in reader.iter_attachments())
        assert attachments == (2 if 'reel.episode' in names else 0), (path, attachments)
    with open(path, 'rb') as file:
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == messages, path
    count += 1
print(count)
";

/// Lets the Python library read every so manieth recovered file of a folder with every checksum.
fn python_reads(folder: &Path, stride: usize) {
    let Some(python) = reel_vectors::python("mcap") else {
        return;
    };
    let mut command = Command::new(&python);
    command.args(["-c", PYTHON]).arg(folder);
    let said = reel_vectors::run(command.arg(stride.to_string()));
    let count = files(folder, "mcap").len().div_ceil(stride);
    assert_eq!(said.trim(), count.to_string());
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
    sample.seal();
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
    let record = |path: &Path| {
        let mut recorder = Recorder::create(
            path,
            &sample.header,
            &sample.task,
            &sample.scene,
            Images::Full,
        )
        .unwrap();
        recorder.start_with_base64(&sample.start, &base64).unwrap();
        recorder.input(0, &sample.steps[0].input).unwrap();
        recorder.timing(0, &timing).unwrap();
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
    assert_eq!(Trace::read(&again).unwrap().timings, trace.timings);
}
