//! The published conformance suite of the protocol passes, where npm
//! can install it (`tests/conformance.sh`).

use std::env;

#[test]
fn every_scenario_passes() {
    // `cargo test` builds the server beside this program.
    let program = env::current_exe().unwrap();
    let built = program.ancestors().nth(2).unwrap();
    let server = built
        .join("examples/conformance")
        .with_extension(env::consts::EXE_EXTENSION);
    if !server.is_file() {
        let why = "no example `conformance`; run the tests of the whole crate";
        return reel_vectors::skip("examples", why);
    }
    let mut command = reel_vectors::script("bash", "conformance.sh");
    let said = reel_vectors::run(
        command
            .arg("fixtures")
            .env("REEL_CONFORMANCE_SERVER", &server),
    );
    assert!(
        said.starts_with("conformance: ") || said.starts_with("skipped: "),
        "{said}"
    );
}
