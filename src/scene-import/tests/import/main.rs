//! Houses and furniture of each format: what becomes of them, what is said of the rest, and what
//! broken files say.

mod broken;
mod furniture;
mod houses;

use std::path::{Path, PathBuf};

use reel_scene_import::{ImportOptions, Imported, import};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name)
}

fn imported(name: &str) -> Imported {
    import(&data(name), &ImportOptions::default()).unwrap_or_else(|error| panic!("{name}: {error}"))
}
