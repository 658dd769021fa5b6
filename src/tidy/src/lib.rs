//! The repository's own checks, as predicates over texts: what a file has to hold and
//! what it may not.
//!
//! Reads files of the repository only; the rules themselves (which crate may use
//! which) are in `tests/tidy`.

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Longest source file, in lines.
pub const LINES_MAX: usize = 1000;

/// The root of the repository.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .components()
        .collect::<PathBuf>()
        .canonicalize()
        .expect("the root exists")
}

/// The text of a file of the repository.
///
/// # Panics
/// When it is absent or no text: every caller names a file that has to be there.
pub fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// All text files that people write, as (path from the root, text), sorted. Build output and
/// locks are left out.
pub fn files() -> Vec<(String, String)> {
    let mut found = Vec::new();
    walk(&root(), &mut found);
    found.sort();
    found
}

/// The Rust files among [`files`].
pub fn rust_files() -> Vec<(String, String)> {
    files()
        .into_iter()
        .filter(|(path, _)| path.ends_with(".rs"))
        .collect()
}

/// The folders of `src`: one crate each.
pub fn crates() -> Vec<String> {
    let entries = fs::read_dir(root().join("src")).expect("src is a folder");
    let mut names: Vec<String> = entries
        .map(|entry| {
            entry
                .expect("an entry")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    names.sort();
    names
}

/// Whether a file opens with what it owns.
pub fn opens_with_doc(text: &str) -> bool {
    text.lines().next().is_some_and(|line| {
        line.strip_prefix("//!")
            .is_some_and(|doc| !doc.trim().is_empty())
    })
}

/// Lines with what someone meant to come back to, as (line number from 1, what).
pub fn leftovers(text: &str) -> Vec<(usize, &'static str)> {
    // In two parts, so that this file does not find itself.
    const WORDS: &[&str] = &[
        concat!("dbg", "!("),
        concat!("todo", "!("),
        concat!("unimplemented", "!("),
        concat!("FIX", "ME"),
        concat!("#[", "ignore"),
    ];
    lines_with(text, WORDS)
}

/// Lines with the path of one machine, as (line number from 1, what).
pub fn machine_paths(text: &str) -> Vec<(usize, &'static str)> {
    const PATHS: &[&str] = &[
        concat!("/wo", "rk/"),
        concat!("/ro", "ot/"),
        concat!("/fa", "rm/"),
        concat!("/home", "/"),
    ];
    lines_with(text, PATHS)
}

/// Whether a Cargo.toml takes the lints of the workspace.
pub fn inherits_lints(manifest: &str) -> bool {
    manifest.split("\n[").any(|section| {
        section
            .strip_prefix("lints]")
            .is_some_and(|rest| rest.lines().any(|l| l.trim() == "workspace = true"))
    })
}

/// The paths that a `clippy.toml` bans.
pub fn banned(clippy: &str) -> Vec<&str> {
    let entries = clippy
        .lines()
        .filter_map(|line| line.trim().strip_prefix("{ path = \""));
    entries
        .filter_map(|rest| rest.split_once('"'))
        .map(|(path, _)| path)
        .collect()
}

fn lines_with(text: &str, words: &'static [&'static str]) -> Vec<(usize, &'static str)> {
    let numbered = text.lines().zip(1..);
    numbered
        .flat_map(|(line, number)| {
            words
                .iter()
                .filter(|word| line.contains(**word))
                .map(move |word| (number, *word))
        })
        .collect()
}

fn walk(folder: &Path, found: &mut Vec<(String, String)>) {
    for entry in
        fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
    {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let hidden = name.starts_with('.') && name != ".ci";
        if hidden
            || matches!(
                name.as_str(),
                "target" | "out" | "demo-out" | "node_modules" | "Cargo.lock"
            )
        {
            continue;
        }
        if path.is_dir() {
            walk(&path, found);
        } else if let Ok(text) = fs::read_to_string(&path) {
            let inside = path.strip_prefix(root()).expect("below the root");
            found.push((inside.to_string_lossy().replace('\\', "/"), text));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_its_purpose_is_seen() {
        assert!(opens_with_doc("//! What.\nuse x;"));
        assert!(!opens_with_doc("use x;\n//! What."));
        assert!(!opens_with_doc("//!\n"));
        assert!(!opens_with_doc(""));
    }

    #[test]
    fn leftovers_and_machine_paths_are_seen_by_line() {
        let text = format!("fine\n{}!(x)\n// {}ME later", "dbg", "FIX");
        assert_eq!(
            leftovers(&text)
                .iter()
                .map(|(line, _)| *line)
                .collect::<Vec<_>>(),
            [2, 3]
        );
        let text = format!("a\nlet path = \"{}rk/x\";", "/wo");
        assert_eq!(machine_paths(&text).len(), 1);
        assert!(machine_paths("src/world/data").is_empty());
    }

    #[test]
    fn lints_count_in_their_own_section_only() {
        assert!(inherits_lints(
            "[package]\nname = \"a\"\n\n[lints]\nworkspace = true\n"
        ));
        assert!(!inherits_lints(
            "[package]\nworkspace = true\n\n[lints]\n\n[dependencies]\nworkspace = true\n"
        ));
        assert!(!inherits_lints("[package]\nname = \"a\"\n"));
    }

    #[test]
    fn bans_are_read_line_by_line() {
        assert_eq!(
            banned("x = [\n  { path = \"f32::sin\", reason = \"r\" },\n  { path = \"a::B\" },\n]"),
            ["f32::sin", "a::B"]
        );
    }
}
