//! The binary `reel`.

use std::process::ExitCode;

/// Analytics and the service allocate much and from several threads. The second version of mimalloc
/// gives memory back soon.
#[cfg(feature = "service")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(reel_cli::main(std::env::args_os().collect()))
}
