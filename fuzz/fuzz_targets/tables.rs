//! The fuzz target of the parsers of `parsers/tables.rs`: `REEL_PARSER` names the one it feeds.

#![no_main]

mod choice;
#[path = "../parsers/mod.rs"]
mod parsers;
#[path = "../parsers/tables.rs"]
mod tables;

use libfuzzer_sys::fuzz_target;

fuzz_target!(
    init: choice::init(),
    |bytes: &[u8]| choice::parser(tables::PARSERS)(bytes)
);
