//! The fuzz target of every parser but those of `tables.rs`: `REEL_PARSER` names the one it feeds.
//! One program, because each would link all of Reel.

#![no_main]

mod choice;
#[path = "../parsers/mod.rs"]
mod parsers;

use libfuzzer_sys::fuzz_target;

fuzz_target!(
    init: choice::init(),
    |bytes: &[u8]| choice::parser(parsers::PARSERS)(bytes)
);
