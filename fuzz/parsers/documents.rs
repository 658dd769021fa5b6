//! Files that people and tools write: tasks, scenes, meshes, images, presets, mappings, settings,
//! training sets.

use std::path::Path;

use reel_tasks::assets::{MeshFormat, NoSiblings};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};

use super::{HOME, file, text};

/// Pixels that images of a trace may have.
const PIXELS_MAX: u32 = (4 * FRAME_WIDTH * FRAME_HEIGHT) as u32;

/// Settings and tokens of a server.
pub fn config(bytes: &[u8]) {
    file(bytes, "server.toml", |path| {
        if let Ok(config) = reel_server::Config::read(path) {
            let _ = (config.check(), config.is_local(), config.to_toml());
        }
        let _ = reel_server::Tokens::open(path);
    });
}

/// A training set as lines of JSON.
pub fn dataset(bytes: &[u8]) {
    file(bytes, "rows.jsonl", rows);
}

/// A training set in Parquet.
pub fn dataset_parquet(bytes: &[u8]) {
    file(bytes, "rows.parquet", rows);
}

fn rows(path: &Path) {
    if let Ok(dataset) = reel_dataset::lint::Dataset::open(&[path.to_owned()], None, None) {
        for row in dataset.rows() {
            let _ = row.map(|example| reel_dataset::lint::show(&example));
        }
    }
}

/// Images of traces, training sets and robots.
pub fn image(bytes: &[u8]) {
    let _ = reel_dataset::lint::ImageHeader::of(bytes);
    let _ = reel_trace::decode_webp(bytes, PIXELS_MAX);
    let _ = reel_trace::decode_png(bytes, (FRAME_WIDTH, FRAME_HEIGHT));
    let _ = reel_import::robot::camera_image(bytes.to_vec());
}

/// Log-probabilities of another policy.
pub fn logprobs(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_trace::ScoredTokens::read_lines(text, Path::new("scores.jsonl"));
    });
}

/// Mappings of MCP servers and of robots.
pub fn mapping(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_proxy::Mapping::parse(text);
        let _ = reel_import::robot::Mapping::parse(text);
    });
}

pub fn mesh_glb(bytes: &[u8]) {
    mesh(MeshFormat::Glb, bytes);
}

pub fn mesh_gltf(bytes: &[u8]) {
    mesh(MeshFormat::Gltf, bytes);
}

pub fn mesh_obj(bytes: &[u8]) {
    mesh(MeshFormat::Obj, bytes);
}

/// Text, binary layers and packages, by how they start.
pub fn mesh_usd(bytes: &[u8]) {
    mesh(MeshFormat::Usd, bytes);
}

fn mesh(format: MeshFormat, bytes: &[u8]) {
    let _ = reel_tasks::assets::parse(format, bytes, &NoSiblings);
}

/// The file of a reward preset.
pub fn preset(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_reward::Preset::from_toml(text);
    });
}

/// The file of a scene.
pub fn scene(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_tasks::scene::parse(text, "scene.json");
    });
}

/// The file of a task.
pub fn task(bytes: &[u8]) {
    text(bytes, |text| {
        let _ = reel_tasks::parse(text, "task.yaml", &HOME);
    });
}
