//! The simulator in a browser (`tests/web`): the module beside the native build, and a shared page in Chromium without a network.

#[test]
fn a_browser_tab_gives_the_verdicts_of_the_native_build() {
    let mut command = reel_vectors::script("bash", "web/run.sh");
    let command = command
        .args(reel_vectors::form())
        .env("REEL", env!("CARGO_BIN_EXE_reel"));
    reel_vectors::run(command);
}
