//! The published conformance suite of the protocol passes, where npm
//! can install it (`tests/conformance.sh`).

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
};

/// The example that `cargo test` built beside this program.
fn server() -> PathBuf {
    let program = env::current_exe().unwrap();
    let built = program
        .parent()
        .and_then(Path::parent)
        .expect("a test program lies in a folder of the build");
    built
        .join("examples/conformance")
        .with_extension(env::consts::EXE_EXTENSION)
}

#[test]
fn every_scenario_passes() {
    let server = server();
    if !server.is_file() {
        eprintln!(
            "skipped: MCP conformance, because its server is not built (`cargo test -p reel-mcp` builds it)"
        );
        return;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/conformance.sh");
    match Command::new("bash")
        .arg(&script)
        .env("REEL_CONFORMANCE_SERVER", &server)
        .output()
    {
        Err(error) => eprintln!("skipped: MCP conformance, because there is no bash ({error})"),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stdout);
            eprint!("{said}");
            assert!(
                output.status.success(),
                "{said}{}",
                String::from_utf8_lossy(&output.stderr)
            );
            assert!(
                said.starts_with("conformance: ") || said.starts_with("skipped: "),
                "{said}"
            );
        }
    }
}
