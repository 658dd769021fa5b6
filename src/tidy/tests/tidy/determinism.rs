//! What keeps equal inputs giving equal bits: the ban lists of the crates that compute, and the
//! features that replace the platform's mathematics.

use std::collections::BTreeSet;

use reel_tidy::{banned, read};

use super::layers::workspace;

/// The crates whose results are recorded and compared. Clippy reads one `clippy.toml` a crate and
/// does not merge files, so each has a copy.
const COMPUTING: &[&str] = &["world", "reward", "agents", "sim", "episode"];

const TYPES: &[&str] = &[
    "std::collections::HashMap",
    "std::collections::HashSet",
    "std::time::Instant",
    "std::time::SystemTime",
    "std::fs::File",
    "std::net::TcpStream",
    "std::net::UdpSocket",
];

const FUNCTIONS: &[&str] = &[
    "std::thread::spawn",
    "std::thread::scope",
    "std::env::var",
    "std::env::var_os",
    "std::fs::read",
    "std::fs::read_to_string",
    "std::fs::write",
];

/// What the standard library leaves to the platform, for `f32` and `f64`. Square
/// roots are exact everywhere.
const MATHEMATICS: &[&str] = &[
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sin_cos", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "exp", "exp2", "exp_m1", "ln", "ln_1p", "log", "log2", "log10",
    "powf", "powi", "cbrt", "hypot", "mul_add",
];

#[test]
fn the_ban_list_is_complete() {
    let text = read("src/sim/clippy.toml");
    let banned: BTreeSet<&str> = banned(&text).into_iter().collect();
    let methods = ["f32", "f64"].into_iter().flat_map(|float| {
        MATHEMATICS
            .iter()
            .map(move |name| format!("{float}::{name}"))
    });
    let wanted = TYPES
        .iter()
        .chain(FUNCTIONS)
        .map(ToString::to_string)
        .chain(methods);
    super::none(
        wanted
            .filter(|path| !banned.contains(path.as_str()))
            .map(|path| format!("src/sim/clippy.toml does not ban {path}")),
    );
}

#[test]
fn every_computing_crate_has_the_same_ban_list() {
    let list = read("src/sim/clippy.toml");
    for name in COMPUTING {
        let path = format!("src/{name}/clippy.toml");
        assert!(
            read(&path) == list,
            "{path} differs from src/sim/clippy.toml: copy it"
        );
    }
}

/// Cargo unifies features: a crate built alone must get what it gets inside `reel`, so who
/// computes names them itself.
#[test]
fn who_uses_physics_names_its_mathematics() {
    const FEATURES: &[(&str, &[&str])] = &[
        ("rapier3d", &["enhanced-determinism"]),
        ("simba", &["libm_force"]),
        ("glamx", &["libm", "scalar-math"]),
        ("libm", &[]),
    ];
    let packages = workspace();
    let users: Vec<_> = packages
        .iter()
        .filter(|package| package.dependencies.iter().any(|d| d.name == "rapier3d"))
        .collect();
    assert!(
        users
            .iter()
            .any(|package| package.name.as_str() == "reel-sim"),
        "reel-sim without rapier3d: does this test still look right?"
    );
    for package in users {
        for (name, features) in FEATURES {
            let dependency = package
                .dependencies
                .iter()
                .find(|dependency| dependency.name == *name);
            let dependency = dependency.unwrap_or_else(|| {
                panic!("{} uses rapier3d and does not name {name}", package.name)
            });
            for feature in *features {
                let named = dependency.features.iter().any(|have| have == feature);
                assert!(
                    named,
                    "{}: {name} without the feature {feature}",
                    package.name
                );
            }
        }
    }
}
