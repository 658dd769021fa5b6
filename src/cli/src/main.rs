//! The `reel` command: parses arguments, calls the crates, prints.

fn main() {}
