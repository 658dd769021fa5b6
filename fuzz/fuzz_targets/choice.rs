//! Which parser a program feeds, and which panics are none of it.

use std::{env, panic, sync::LazyLock};

use crate::parsers::Parser;

/// Libraries that panic on what they should refuse, and whose callers catch that.
const CAUGHT: &[&str] = &["/prost-reflect-", "/openusd-"];

/// The name of the parser.
static NAME: LazyLock<String> =
    LazyLock::new(|| env::var("REEL_PARSER").expect("REEL_PARSER names a folder of fuzz/corpus"));

/// Lets panics pass that are caught.
pub fn init() {
    let abort = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        let file = panic.location().map_or("", |place| place.file());
        if !CAUGHT.iter().any(|library| file.contains(library)) {
            abort(panic);
        }
    }));
}

/// The parser that is fed.
pub fn parser(parsers: &[(&str, Parser)]) -> Parser {
    let found = parsers.iter().find(|(name, _)| *name == *NAME);
    found
        .unwrap_or_else(|| panic!("no parser is called {}", *NAME))
        .1
}
