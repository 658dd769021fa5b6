//! The corpus of the fuzz targets (`fuzz`): every parser of outside bytes takes every input, whole
//! and torn, and returns.

#[path = "../../../../fuzz/parsers/mod.rs"]
mod parsers;
#[path = "../../../../fuzz/parsers/tables.rs"]
mod tables;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use parsers::Parser;

/// Largest input of a corpus in bytes; of traces, a larger one.
const BYTES_MAX: usize = 32 << 10;

#[test]
fn every_parser_survives_its_corpus() {
    for (name, parser) in parsers() {
        let inputs: Vec<_> = fs::read_dir(corpus().join(name))
            .unwrap_or_else(|error| panic!("fuzz/corpus/{name}: {error}"))
            .map(|entry| fs::read(entry.unwrap().path()).unwrap())
            .collect();
        assert!(inputs.len() >= 3, "fuzz/corpus/{name}: too few inputs");
        for bytes in inputs {
            assert!(bytes.len() <= BYTES_MAX, "fuzz/corpus/{name}: too large");
            parser(&bytes);
            for part in 1..8 {
                parser(&bytes[..bytes.len() * part / 8]);
            }
        }
    }
}

#[test]
fn every_corpus_has_a_parser() {
    let known: BTreeSet<&str> = parsers().map(|(name, _)| name).collect();
    for entry in fs::read_dir(corpus()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(known.contains(name.as_str()), "no parser {name}");
    }
}

fn parsers() -> impl Iterator<Item = (&'static str, Parser)> {
    parsers::PARSERS.iter().chain(tables::PARSERS).copied()
}

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus")
}
