//! The in-toto statement of a bundle (Statement v1, predicate "test result" v0.1): which files, by SHA-256, and which episodes passed as tests.
//! It follows from the other parts, so that it can be made again and compared.

use reel_world::{Digest, canonical_json};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use crate::{archive::Bundle, manifest::Manifest};

const STATEMENT_TYPE: &str = "https://in-toto.io/Statement/v1";
const PREDICATE_TYPE: &str = "https://in-toto.io/attestation/test-result/v0.1";

/// The statement about the parts of a bundle, as canonical JSON.
pub(crate) fn statement(bundle: &Bundle, manifest: &Manifest) -> Vec<u8> {
    let subjects: Vec<Value> = bundle
        .subjects()
        .map(|(name, content)| json!({"name": name, "digest": {"sha256": sha256(content)}}))
        .collect();
    let configuration: Vec<Value> = manifest
        .grid
        .tasks
        .iter()
        .map(|task| json!({"name": task.id, "digest": {"blake3": task.task}}))
        .collect();
    let tests = |success: bool| -> Vec<String> {
        let episodes = manifest.episodes.iter();
        episodes
            .filter(|episode| episode.success == success)
            .map(|episode| episode.cell().to_string())
            .collect()
    };
    let (passed, mut failed) = (tests(true), tests(false));
    let played: std::collections::BTreeSet<_> = manifest
        .episodes
        .iter()
        .map(|episode| episode.cell())
        .collect();
    let missing = manifest.grid.cells().filter(|cell| !played.contains(cell));
    failed.extend(missing.map(|cell| format!("{cell} (not played)")));
    let result = if failed.is_empty() {
        "PASSED"
    } else {
        "FAILED"
    };
    let statement = json!({
        "_type": STATEMENT_TYPE,
        "subject": subjects,
        "predicateType": PREDICATE_TYPE,
        "predicate": {"result": result, "configuration": configuration, "passedTests": passed, "failedTests": failed},
    });
    canonical_json(&statement).into_bytes()
}

fn sha256(content: &[u8]) -> String {
    let digest = Sha256::digest(content);
    Digest(digest.into()).to_string()
}
