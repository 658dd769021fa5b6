//! Every parser of bytes from outside, as a function that takes any bytes and returns. The fuzz
//! targets call them with mutated inputs, `make test` with the corpus
//! (`src/cli/tests/cli/fuzz.rs`). Those that need DataFusion are in `tables.rs` beside this.

mod documents;
mod recordings;
mod service;
mod texts;
mod traces;

use std::{fs, path::Path, sync::LazyLock};

use reel_world::Scene;

/// A parser of any bytes.
pub type Parser = fn(&[u8]);

/// The parsers by name; the folder of the same name in `fuzz/corpus` has inputs.
pub const PARSERS: &[(&str, Parser)] = &[
    ("answer", texts::answer),
    ("attachment", traces::attachment),
    ("bag", recordings::bag),
    ("bag_message", recordings::bag_message),
    ("bag_metadata", recordings::bag_metadata),
    ("calls", texts::calls),
    ("config", documents::config),
    ("dataset", documents::dataset),
    ("dataset_parquet", documents::dataset_parquet),
    ("eval_output", recordings::eval_output),
    ("history", texts::history),
    ("http", service::http),
    ("image", documents::image),
    ("logprobs", documents::logprobs),
    ("mapping", documents::mapping),
    ("mcp", service::mcp),
    ("mesh_glb", documents::mesh_glb),
    ("mesh_gltf", documents::mesh_gltf),
    ("mesh_obj", documents::mesh_obj),
    ("mesh_usd", documents::mesh_usd),
    ("model_body", texts::model_body),
    ("notes", texts::notes),
    ("preset", documents::preset),
    ("proposal", texts::proposal),
    ("proxy", service::proxy),
    ("question", texts::question),
    ("record", traces::record),
    ("recovery", traces::recovery),
    ("scene", documents::scene),
    ("shard", traces::shard),
    ("task", documents::task),
    ("template", texts::template),
    ("trace", traces::trace),
    ("trainer", texts::trainer),
];

/// The scene of the tasks in the corpus, as its file has it.
pub const SCENE: &str = include_str!("../corpus/scene/flat.json");
/// A task of the corpus that loads, as its file has it.
pub const TASK: &str = include_str!("../corpus/task/FDO_sample_1.yaml");

/// The scene of the tasks in the corpus.
pub static HOME: LazyLock<Scene> = LazyLock::new(|| {
    let loaded = reel_tasks::scene::parse(SCENE, "scene.json");
    loaded.expect("a scene of the corpus").scene
});

/// Hands on what is text.
pub fn text(bytes: &[u8], parse: impl Fn(&str)) {
    if let Ok(text) = str::from_utf8(bytes) {
        parse(text);
    }
}

/// Hands on a file that holds the bytes.
pub fn file(bytes: &[u8], name: &str, parse: impl Fn(&Path)) {
    let folder = folder();
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a temporary file");
    parse(&path);
}

/// A folder that is gone with its value.
pub fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}
