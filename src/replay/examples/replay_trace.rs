//! Executes traces again from their inputs and compares every digest, image and text.
//!
//! `cargo run -p reel-replay --example replay_trace -- traces/golden/*.mcap`

use std::{env, path::PathBuf, process::ExitCode};

fn main() -> ExitCode {
    let traces: Vec<PathBuf> = env::args().skip(1).map(PathBuf::from).collect();
    let mut exact = true;
    for trace in &traces {
        let verdict = reel_replay::verify(trace);
        println!("{}: {verdict}", trace.display());
        exact = exact && verdict.is_exact();
    }
    if exact {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
