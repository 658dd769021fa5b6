//! Compiles the schemas of the trace channels, without a system `protoc`, to Rust types and to the
//! descriptors that go into every trace.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;

/// The roots; what they import comes along.
const SCHEMAS: &[&str] = &[
    "reel/v1/episode.proto",
    "reel/v1/policy_output.proto",
    "reel/v1/policy_latency.proto",
    "reel/v1/logprobs.proto",
    "reel/v1/tool_call.proto",
    "reel/v1/tool_result.proto",
    "reel/v1/user_dialogue.proto",
    "reel/v1/world_diff.proto",
    "reel/v1/world_graph.proto",
    "reel/v1/reward.proto",
    "reel/v1/sim_digest.proto",
    "reel/v1/packed.proto",
    "reel/v1/chain.proto",
    "reel/v1/timing.proto",
    "reel/v1/mcp_answer.proto",
    "reel/v1/reported.proto",
    "reel/v1/redacted.proto",
    "reel/v1/odometry.proto",
    "reel/v1/primitive.proto",
    "reel/v1/vla.proto",
    "reel/v1/alignment.proto",
    "foxglove/CompressedImage.proto",
    "foxglove/RawImage.proto",
    "foxglove/CameraCalibration.proto",
    "foxglove/FrameTransforms.proto",
    "foxglove/ImageAnnotations.proto",
    "foxglove/Log.proto",
    "foxglove/SceneUpdate.proto",
];

fn main() -> Result<(), Box<dyn Error>> {
    let root = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("../../schemas");
    println!("cargo:rerun-if-changed={}", root.join("reel").display());
    println!("cargo:rerun-if-changed={}", root.join("foxglove").display());
    let descriptors = protox::Compiler::new([&root])?
        .include_imports(true)
        .open_files(SCHEMAS)?
        .file_descriptor_set();
    fs::write(
        PathBuf::from(env::var("OUT_DIR")?).join("schemas.bin"),
        descriptors.encode_to_vec(),
    )?;
    prost_build::Config::new()
        .btree_map(["."])
        .compile_fds(descriptors)?;
    Ok(())
}
