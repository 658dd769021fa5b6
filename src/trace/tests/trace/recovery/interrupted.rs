//! Processes that are killed while they record, or run out of disk: what they acknowledged stays.

use std::{
    collections::BTreeMap,
    env,
    io::{BufRead, BufReader, Read, Write},
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use reel_trace::{Durability, RecordOptions};
use reel_world::Frame;

use super::*;

/// A seed that changes from run to run, but can be given.
fn seed() -> u64 {
    let seed = env::var("REEL_SEED")
        .ok()
        .and_then(|seed| seed.parse().ok());
    seed.unwrap_or_else(|| {
        u64::from(std::process::id()) ^ env::temp_dir().metadata().map_or(0, |m| m.len())
    })
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
            "recovery::interrupted::child",
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
