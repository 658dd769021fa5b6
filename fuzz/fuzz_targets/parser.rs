//! One fuzz target for each parser: the name of the program is the name of the parser.

#![no_main]

#[path = "../parsers.rs"]
mod parsers;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| parsers::parse(env!("CARGO_BIN_NAME"), bytes));
