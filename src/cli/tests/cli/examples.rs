//! The examples that people copy run as they say (`src/*/examples`).

use std::{env, path::Path, process::Command};

use crate::expect;

/// Standard output of an example over golden traces or a store; `None` if `cargo test` built this
/// program alone.
fn example(name: &str, arguments: &[&Path]) -> Option<String> {
    let program = env::current_exe().unwrap();
    let built = program.ancestors().nth(2).unwrap().join("examples");
    let example = built.join(name).with_extension(env::consts::EXE_EXTENSION);
    if !example.is_file() {
        let why = "cargo builds it for the tests of the whole workspace";
        reel_vectors::skip("examples", why);
        return None;
    }
    Some(reel_vectors::run(Command::new(example).args(arguments)))
}

#[test]
fn examples_run() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden");
    let trace = golden.join("FDO_home_0002--planner--4.mcap");
    let store = folder.path().join("store");
    let into = ["--store", store.to_str().unwrap()];
    let ingest = ["ingest", trace.to_str().unwrap()];
    expect(folder.path(), 0, &[&ingest[..], &into[..]].concat());
    for (name, argument, end) in [
        ("read_trace", &trace, "success: true\n"),
        ("replay_trace", &trace, "images\n"),
        ("custom_reward", &trace, "\n"),
        ("sql", &store, "1 policies, the last at 1\n"),
    ] {
        let Some(said) = example(name, &[argument]) else {
            return;
        };
        assert!(said.ends_with(end), "{name}: {said}");
    }
}
