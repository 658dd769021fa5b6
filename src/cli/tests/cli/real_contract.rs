//! REAL's published clients, written anew in Python from their contract (`tests/real-contract`),
//! against the binary of this build.

/// Two tasks of each family; `tests/real-contract/run.sh` without `--short` plays all of them.
#[test]
fn the_published_clients_run_on_reel() {
    let mut command = reel_vectors::script("bash", "real-contract/run.sh");
    let command = command.arg("--short");
    reel_vectors::run(command.env("REEL", env!("CARGO_BIN_EXE_reel")));
}
