//! The corpus of the fuzz targets (`fuzz`): every parser of outside bytes takes every input, whole
//! and torn, and returns.

#[path = "../../../../fuzz/parsers.rs"]
mod parsers;

use std::{fs, path::Path};

use parsers::PARSERS;

#[test]
fn every_parser_survives_its_corpus() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    let manifest = fs::read_to_string(root.join("Cargo.toml")).unwrap();
    for (name, parser) in PARSERS {
        let target = format!("[[bin]]\nname = \"{name}\"\n");
        assert!(manifest.contains(&target), "no fuzz target {name}");
        let folder = root.join("corpus").join(name);
        let inputs: Vec<_> = fs::read_dir(&folder)
            .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
            .map(|entry| fs::read(entry.unwrap().path()).unwrap())
            .collect();
        assert!(inputs.len() >= 3, "{}: too few inputs", folder.display());
        for bytes in inputs {
            parser(&bytes);
            for part in 1..8 {
                parser(&bytes[..bytes.len() * part / 8]);
            }
        }
    }
    assert_eq!(manifest.matches("[[bin]]").count(), PARSERS.len());
}
