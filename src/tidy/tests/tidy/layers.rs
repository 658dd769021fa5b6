//! Which crate may use which, over `cargo metadata`. The table is the architecture: a line added
//! here is a decision.

use cargo_metadata::{DependencyKind, MetadataCommand, Package};
use reel_tidy::{crates, root};

/// What a crate of ours may use of ours, tests apart. `cli` may use all but `python`.
#[rustfmt::skip]
const LAYERS: &[(&str, &[&str])] = &[
    ("world", &[]),
    ("statistics", &[]),
    ("redact", &[]),
    ("http", &[]),
    ("reward", &["world"]),
    ("sim", &["world"]),
    ("trace", &["world"]),
    ("episode", &["world", "sim", "reward"]),
    // sim: the physics filter. episode: whether a question has to be asked, the
    // simulated user's answer decides.
    ("tasks", &["world", "sim", "episode"]),
    ("scene-import", &["world", "tasks"]),
    ("agents", &["world", "episode", "trace"]),
    // sim and reward: docs/decisions/007-replay-names-sim-and-reward.md
    ("replay", &["world", "sim", "reward", "episode", "trace"]),
    // packed episodes of a run, and what their execution gives
    ("bundle", &["world", "trace", "replay", "statistics"]),
    ("web", &["world", "sim", "episode", "trace", "replay", "bundle"]),
    ("counterfactual", &["world", "sim", "episode", "trace", "agents", "replay"]),
    ("history", &["world"]),
    ("tables", &["world", "reward", "trace"]),
    ("query", &["world", "reward", "trace", "tables", "replay", "counterfactual", "statistics"]),
    ("cluster", &["tables", "query", "trace"]),
    // reward: what the published trainer reads in a result's texts
    // has one owner, `reel_reward::trainer`.
    ("prompt", &["world", "reward"]),
    ("llm", &["world", "agents", "episode", "trace", "prompt", "redact", "http"]),
    ("dataset", &["world", "history", "prompt"]),
    // dataset: the files of a folder and the rows of JSON, with their lines
    ("data-profile", &["dataset"]),
    ("annotate", &["world", "trace", "history", "llm", "prompt", "dataset"]),
    (
        "export",
        &[
            "world", "reward", "trace", "tables", "replay", "history", "annotate", "prompt",
            "dataset",
        ],
    ),
    ("view", &["world", "trace", "replay", "sim"]),
    // view: the encoder of videos
    ("lerobot", &["world", "trace", "replay", "annotate", "dataset", "view"]),
    ("otlp", &["http"]),
    // dataset: names of files, and the rows of JSON with their lines
    ("publish", &["world", "dataset", "http", "redact"]),
    ("import", &["world", "reward", "trace", "otlp"]),
    ("proxy", &["world", "reward", "trace", "import", "redact"]),
    ("taxonomy", &["world", "tables", "query", "llm"]),
    ("live", &["world", "reward", "episode", "trace"]),
    ("mcp", &["world", "trace", "live"]),
    // reward: the preset of a branch
    ("tape", &["world", "reward", "episode", "trace", "replay", "live", "mcp", "redact"]),
    (
        "server",
        &[
            "world",
            "reward",
            "tasks",
            "agents",
            "trace",
            "replay",
            "counterfactual",
            "tables",
            "query",
            "dataset",
            "view",
            "live",
            "mcp",
            "tape",
            "llm",
            // spans of agents that come over HTTP become traces
            "otlp",
            "import",
        ],
    ),
    // the Python package: what it calls in the process, and the command line
    (
        "python",
        &[
            "world",
            "reward",
            "sim",
            "tasks",
            "episode",
            "agents",
            "trace",
            "replay",
            "counterfactual",
            "view",
            "query",
            "cli",
        ],
    ),
    ("tidy", &[]),
    // tests only
    ("vectors", &["world", "reward", "trace", "episode", "tasks", "agents", "llm"]),
];

/// Outside packages that only some crates of ours may use, tests included. A name ending in
/// `*` is a prefix.
#[rustfmt::skip]
const ONLY_IN: &[(&str, &[&str])] = &[
    ("axum*", &["mcp", "proxy", "server", "tape"]),
    // tidy: so that programs and tests build it with the same features (features.rs)
    ("rmcp", &["mcp", "server", "tape", "tidy"]),
    ("hyper*", &["server"]),
    ("httparse", &["proxy"]),
    ("tower*", &["server"]),
    ("utoipa*", &["server"]),
    ("clap*", &["cli"]),
    ("indicatif", &["cli"]),
    ("anyhow", &["cli"]),
    ("ballista*", &["cluster"]),
    ("datafusion*", &["cluster", "query", "tables"]),
    (
        "arrow*",
        &[
            "cluster", "dataset", "export", "lerobot", "publish", "python", "query", "server", "tables",
            "taxonomy",
        ],
    ),
    ("numpy", &["python"]),
    ("pyo3*", &["python"]),
    ("pythonize", &["python"]),
    ("tonic", &["cluster"]),
    ("rcgen", &["cluster"]),
    ("parquet", &["data-profile", "dataset", "export", "lerobot", "publish", "query", "tables"]),
    ("polars*", &["data-profile"]),
    ("rav1e", &["view"]),
    ("shiguredo_mp4", &["lerobot", "view"]),
    ("rapier3d*", &["sim"]),
    ("parry3d*", &["sim"]),
    // proxy: its tests read every record of a trace
    ("mcap", &["cli", "import", "proxy", "trace"]),
    // otlp: the messages of OpenTelemetry
    ("prost*", &["import", "otlp", "trace"]),
    ("re_cdr", &["import"]),
    ("re_ros_msg", &["import"]),
    ("re_sdk*", &["view"]),
    ("re_web_viewer_server", &["server"]),
    ("object_store", &["cluster", "tables"]),
    ("tokio*", &["cluster", "tables", "query", "live", "mcp", "proxy", "server", "tape"]),
    (
        "rayon",
        &[
            "agents",
            "counterfactual",
            "cluster",
            "tasks",
            "replay",
            "tables",
            "query",
            "export",
            "taxonomy",
            "cli",
            "python",
            "server",
        ],
    ),
    (
        "rand_chacha",
        &["sim", "tasks", "agents", "annotate", "cli", "statistics", "server"],
    ),
    ("rand_core", &["sim", "tasks", "agents", "annotate", "server"]),
    ("strsim", &["query", "reward"]),
    ("toml", &["cli", "import", "proxy", "redact", "reward", "server"]),
    ("rustls*", &["proxy"]),
    ("ureq", &["http"]),
    // vectors: the stub of a Hub
    ("sha1", &["publish", "vectors"]),
    ("sha2", &["bundle", "publish", "vectors"]),
    ("ssh-key", &["bundle"]),
    ("rustix", &["publish"]),
    ("gltf*", &["tasks", "view"]),
    ("openusd", &["tasks"]),
    ("roxmltree", &["scene-import", "taxonomy"]),
    ("zune*", &["import", "tasks"]),
    ("rand", &[]),
];

#[test]
fn every_crate_keeps_to_its_layer() {
    for package in workspace() {
        let name = short(&package);
        if name == "cli" {
            continue;
        }
        let (_, allowed) = LAYERS
            .iter()
            .find(|(layer, _)| *layer == name)
            .unwrap_or_else(|| panic!("src/{name} has no layer in this table"));
        let uses = package
            .dependencies
            .iter()
            .filter(|dependency| dependency.kind != DependencyKind::Development);
        for used in
            uses.filter_map(|dependency| dependency.name.strip_prefix("reel-").map(str::to_owned))
        {
            assert!(
                allowed.contains(&used.as_str()),
                "src/{name} may not use src/{used}"
            );
        }
    }
}

/// Every crate stands below those it uses.
#[test]
fn the_table_has_no_cycles() {
    for (index, (name, uses)) in LAYERS.iter().enumerate() {
        for used in *uses {
            let below = *used == "cli" || LAYERS[..index].iter().any(|(layer, _)| layer == used);
            assert!(below, "{used} has to stand above {name} in the table");
        }
    }
}

#[test]
fn outside_packages_stay_where_they_belong() {
    for package in workspace() {
        let name = short(&package);
        for dependency in &package.dependencies {
            for (pattern, allowed) in ONLY_IN {
                let matches = match pattern.strip_suffix('*') {
                    Some(prefix) => dependency.name.starts_with(prefix),
                    None => dependency.name == *pattern,
                };
                assert!(
                    !matches || allowed.contains(&name.as_str()),
                    "src/{name} may not use {}",
                    dependency.name
                );
            }
        }
    }
}

#[test]
fn every_folder_is_a_crate_of_its_name() {
    let mut names: Vec<String> = workspace().iter().map(short).collect();
    names.sort();
    assert_eq!(names, crates());
}

/// The packages of the workspace, as Cargo sees them.
pub fn workspace() -> Vec<Package> {
    let metadata = MetadataCommand::new()
        .manifest_path(root().join("Cargo.toml"))
        .no_deps()
        .exec();
    metadata
        .unwrap_or_else(|error| panic!("cargo metadata: {error}"))
        .packages
}

fn short(package: &Package) -> String {
    let name = package.name.as_str();
    name.strip_prefix("reel-").unwrap_or(name).to_owned()
}
