//! REAL's published clients, written anew in Python from their contract (`tests/real-contract`),
//! against the binary of this build.

use std::{path::PathBuf, process::Command};

/// Four tasks of each family; `tests/real-contract/run.sh` without `--short` plays all of them.
#[test]
fn the_published_clients_run_on_reel() {
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/real-contract/run.sh");
    let mut command = Command::new("bash");
    command
        .arg(&script)
        .arg("--short")
        .env("REEL", env!("CARGO_BIN_EXE_reel"));
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => return println!("skipped: {}: {error}", script.display()),
    };
    let said = String::from_utf8_lossy(&output.stdout);
    println!("{said}");
    assert!(
        output.status.success(),
        "{}: {said}{}",
        script.display(),
        String::from_utf8_lossy(&output.stderr)
    );
}
