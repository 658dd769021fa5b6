//! The old-log gate from outside: a corpus that holds, one that does not, another build, and
//! minting with a reason.

use std::{fs, path::Path};

use reel_trace::{Images, Recorder, Trace};

use crate::{complaint, expect};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../traces/golden");
/// Golden traces; the first is the one that is forged.
pub const NAMES: [&str; 2] = [
    "SUL_workshop_ask--oracle--0--real-repo.mcap",
    "FODP_workshop_fall--oracle--0.mcap",
];

/// Two golden traces, the first of them with another recorded outcome of a call;
/// checksums and chain hold.
pub fn forged_corpus(folder: &Path, call: usize) {
    fs::create_dir(folder).unwrap();
    for name in NAMES {
        fs::copy(Path::new(GOLDEN).join(name), folder.join(name)).unwrap();
    }
    let path = folder.join(NAMES[0]);
    let mut trace = Trace::read(&path).unwrap();
    fs::remove_file(&path).unwrap();
    trace.steps[call].outcome.text = "The moon is full.".into();
    let mut recorder = Recorder::create(
        &path,
        &trace.header,
        &trace.task,
        &trace.scene,
        Images::None,
    )
    .unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    recorder.end(trace.end.as_ref().unwrap()).unwrap();
}

#[test]
fn the_gate_names_the_episode_and_the_call_that_change() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    forged_corpus(&folder.join("corpus"), 3);
    let this = env!("CARGO_BIN_EXE_reel");
    let told = expect(
        folder,
        1,
        &format!("dev gate --corpus corpus --against {this}"),
    );
    assert!(
        told.contains("1 of 2 traces are exact in this build") && told.contains("call 3"),
        "{told}"
    );
    assert!(told.contains("The moon is full."), "{told}");
    let outcomes = expect(folder, 1, "replay corpus --outcomes --json");
    assert!(outcomes.contains(r#""call":3"#), "{outcomes}");

    fs::remove_file(folder.join("corpus").join(NAMES[0])).unwrap();
    reel!(folder, "dev gate --corpus corpus --against {this} --json");
    let other = complaint(folder, 2, "dev gate --corpus corpus --against /bin/true");
    assert!(!other.is_empty());
}

#[test]
fn minting_demands_a_reason_and_writes_it_down() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let golden = Path::new(GOLDEN).join(NAMES[1]);
    complaint(
        folder,
        2,
        &[
            "dev",
            "mint",
            "--corpus",
            "corpus",
            "--reason",
            "why",
            "--add",
            golden.to_str().unwrap(),
        ],
    );
    assert!(!folder.join("corpus").join(NAMES[1]).exists());
    let reason = "The first trace of this corpus.";
    expect(
        folder,
        0,
        &[
            "dev",
            "mint",
            "--corpus",
            "corpus",
            "--reason",
            reason,
            "--add",
            golden.to_str().unwrap(),
        ],
    );
    assert!(
        fs::read_to_string(folder.join("corpus/NOTES.md"))
            .unwrap()
            .contains(reason)
    );
    // The same episode, whatever the version of the build that recorded it.
    let episode = |path: &Path| {
        let mut trace = Trace::read(path).unwrap();
        trace.header.build.clear();
        (trace.header, trace.start, trace.steps)
    };
    assert!(episode(&folder.join("corpus").join(NAMES[1])) == episode(&golden));
    // A corpus of this simulator that is not exact is no reason to mint: something broke.
    forged_corpus(&folder.join("forged"), 2);
    let broken = complaint(
        folder,
        2,
        "dev mint --corpus forged --reason | An honest try.",
    );
    assert!(broken.contains("raise SIM_VERSION"), "{broken}");
}
