//! Every parser of bytes from outside, as a function that takes any bytes and returns. The fuzz
//! targets call them with mutated inputs, `make test` with the corpus
//! (`src/cli/tests/cli/fuzz.rs`).

use std::{fs, path::Path};

use reel_tasks::assets::{MeshFormat, NoSiblings};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Tool, answer::AssistantTurn};

/// Frames that images of a trace may have, in pixels.
const PIXELS_MAX: u32 = (4 * FRAME_WIDTH * FRAME_HEIGHT) as u32;

/// A parser of any bytes.
pub type Parser = fn(&[u8]);

/// The parsers by name; the folder of the same name in `fuzz/corpus` has inputs.
pub const PARSERS: &[(&str, Parser)] = &[
    ("answer", |bytes| {
        text(bytes, |text| {
            AssistantTurn::parse(text);
            let _ = reel_prompt::python::objects(text).count();
        })
    }),
    ("calls", |bytes| {
        text(bytes, |text| {
            let calls = reel_counterfactual::branch::parse_calls(text);
            for call in calls.iter().flatten() {
                let _ = Tool::parse(call);
            }
        })
    }),
    ("dataset", |bytes| file(bytes, "rows.jsonl", dataset)),
    ("image", |bytes| {
        let _ = reel_dataset::lint::ImageHeader::of(bytes);
        let _ = reel_trace::decode_webp(bytes, PIXELS_MAX);
        let _ = reel_trace::decode_png(bytes, (FRAME_WIDTH, FRAME_HEIGHT));
    }),
    ("mapping", |bytes| {
        text(bytes, |text| {
            let _ = reel_proxy::Mapping::parse(text);
            let _ = reel_import::robot::Mapping::parse(text);
        })
    }),
    ("mesh_glb", |bytes| mesh(MeshFormat::Glb, bytes)),
    ("mesh_gltf", |bytes| mesh(MeshFormat::Gltf, bytes)),
    ("mesh_obj", |bytes| mesh(MeshFormat::Obj, bytes)),
    ("pattern", |bytes| {
        text(bytes, |text| {
            let _ = reel_query::pattern::Pattern::parse(text);
        })
    }),
    ("preset", |bytes| {
        text(bytes, |text| {
            let _ = reel_reward::Preset::from_toml(text);
        })
    }),
    ("scene", |bytes| {
        text(bytes, |text| {
            let _ = reel_tasks::scene::parse(text, "scene.json");
        })
    }),
    ("task", |bytes| {
        text(bytes, |text| {
            let _ = reel_tasks::parse(text, "task.yaml", &reel_tasks::home_scene());
        })
    }),
    ("template", |bytes| {
        text(bytes, |text| {
            let _ = reel_prompt::Template::parse(text);
        })
    }),
    ("trace", |bytes| {
        file(bytes, "trace.mcap", |path| {
            let _ = reel_trace::Trace::read(path);
            let _ = reel_trace::examine(path);
        })
    }),
];

/// Parses bytes with the parser of this name.
///
/// # Panics
/// Panics if there is no such parser; a parser that panics has an error.
#[allow(
    dead_code,
    reason = "the fuzz targets call it, the test of the corpus does not"
)]
pub fn parse(name: &str, bytes: &[u8]) {
    let parser = PARSERS.iter().find(|(known, _)| *known == name);
    let (_, parser) = parser.expect("a parser of this name");
    parser(bytes);
}

fn text(bytes: &[u8], parse: impl Fn(&str)) {
    if let Ok(text) = str::from_utf8(bytes) {
        parse(text);
    }
}

/// Parses a file that holds the bytes.
fn file(bytes: &[u8], name: &str, parse: impl Fn(&Path)) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a temporary file");
    parse(&path);
}

fn mesh(format: MeshFormat, bytes: &[u8]) {
    let _ = reel_tasks::assets::parse(format, bytes, &NoSiblings);
}

fn dataset(path: &Path) {
    if let Ok(dataset) = reel_dataset::lint::Dataset::open(&[path.to_owned()], None, None) {
        for row in dataset.rows() {
            let _ = row.map(|example| reel_dataset::lint::show(&example));
        }
    }
}
