//! The web pages in a browser (`tests/pages`): a real server over recorded episodes, and over
//! traces that are not as they should be.

use std::{fs, path::Path};

use reel_trace::{Images, Recorder, Trace};
use reel_world::record::Backend;

use crate::failed_episode;

#[test]
fn people_find_out_why_an_episode_failed() {
    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join("odd");
    fs::create_dir(&odd).unwrap();
    let recorded = failed_episode(folder.path());
    odd_ones(
        &Trace::read(&recorded).unwrap(),
        &fs::read(&recorded).unwrap(),
        &odd,
    );
    let mut command = reel_vectors::script("bash", "pages/run.sh");
    let command = command
        .args(reel_vectors::form())
        .env("REEL", env!("CARGO_BIN_EXE_reel"));
    reel_vectors::run(command.env("ODD", &odd));
}

/// One that its inputs do not give, one that a robot recorded, one that breaks off in the middle.
fn odd_ones(trace: &Trace, bytes: &[u8], into: &Path) {
    let mut diverged = trace.clone();
    diverged.steps[1].robot.yaw += 0.5;
    write(&into.join("diverged.mcap"), &diverged);
    let mut robot = trace.clone();
    robot.header.backend = Backend::Robot;
    write(&into.join("robot.mcap"), &robot);
    fs::write(into.join("torn.mcap"), &bytes[..bytes.len() / 2]).unwrap();
}

/// Checksums and chain are right: who only reads cannot tell.
fn write(path: &Path, trace: &Trace) {
    let mut recorder =
        Recorder::create(path, &trace.header, &trace.task, &trace.scene, Images::None).unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    recorder.end(trace.end.as_ref().unwrap()).unwrap();
}
