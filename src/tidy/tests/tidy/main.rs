//! The repository checks itself: what every file holds, which crate may use which, and what keeps
//! the simulator deterministic. Never builds anything.

mod determinism;
mod features;
mod language;
mod layers;
mod links;

use reel_tidy::{
    LINES_MAX, crates, files, inherits_lints, leftovers, machine_paths, opens_with_doc, read, root,
    rust_files,
};

#[test]
fn every_file_says_what_it_owns() {
    let rust = rust_files();
    assert!(
        rust.len() > 50,
        "only {} Rust files found: is the root right?",
        rust.len()
    );
    none(
        rust.iter()
            .filter(|(_, text)| !opens_with_doc(text))
            .map(|(path, _)| format!("{path}: the first line is no `//!`")),
    );
}

#[test]
fn no_file_is_too_long() {
    let long = rust_files()
        .into_iter()
        .map(|(path, text)| (path, text.lines().count()))
        .filter(|(_, lines)| *lines > LINES_MAX);
    none(long.map(|(path, lines)| {
        format!("{path}: {lines} lines, {LINES_MAX} at most; split it by noun")
    }));
}

#[test]
fn nothing_is_left_over() {
    none(rust_files().iter().flat_map(|(path, text)| {
        leftovers(text)
            .into_iter()
            .map(move |(line, word)| format!("{path}:{line}: `{word}`"))
    }));
}

#[test]
fn no_path_of_one_machine() {
    none(files().iter().flat_map(|(path, text)| {
        machine_paths(text)
            .into_iter()
            .map(move |(line, word)| format!("{path}:{line}: `{word}`"))
    }));
}

/// `make` runs scripts by their names.
#[cfg(unix)]
#[test]
fn scripts_may_be_executed() {
    use std::os::unix::fs::PermissionsExt;

    let may_not = |path: &String| {
        let file = std::fs::metadata(root().join(path)).expect("a file that was just read");
        file.permissions().mode() & 0o111 == 0
    };
    let scripts = files()
        .into_iter()
        .filter(|(_, text)| text.starts_with("#!/"));
    none(
        scripts
            .map(|(path, _)| path)
            .filter(may_not)
            .map(|path| format!("{path} begins with `#!` and is not executable: chmod +x {path}")),
    );
}

#[test]
fn every_crate_is_in_the_architecture() {
    let page = read("ARCHITECTURE.md");
    none(
        crates()
            .iter()
            .filter(|name| !page.contains(&format!("`src/{name}`")))
            .map(|name| format!("ARCHITECTURE.md: no `src/{name}`")),
    );
}

#[test]
fn every_crate_inherits_the_lints() {
    let manifests = crates()
        .into_iter()
        .map(|name| format!("src/{name}/Cargo.toml"));
    none(
        manifests
            .filter(|path| !inherits_lints(&read(path)))
            .map(|path| format!("{path}: no `[lints] workspace = true`")),
    );
}

#[test]
fn the_pages_a_reader_expects_exist() {
    for page in [
        "README.md",
        "ARCHITECTURE.md",
        "CHANGELOG.md",
        "LICENSE",
        "Makefile",
        ".ci/run",
    ] {
        assert!(root().join(page).is_file(), "{page} is missing");
    }
    let readme = read("README.md");
    let makefile = read("Makefile");
    for verb in ["demo", "test"] {
        assert!(
            readme.contains(&format!("make {verb}")),
            "README.md does not name `make {verb}`"
        );
        assert!(
            makefile.contains(&format!("\n{verb}:")),
            "Makefile has no `{verb}`"
        );
    }
}

/// `reel_vectors::skip` fails what `tests/skips.toml` does not declare; this fails what it declares
/// in vain.
#[test]
fn every_declared_skip_names_a_test() {
    let sources: String = rust_files().into_iter().map(|(_, text)| text).collect();
    let declared = read("tests/skips.toml");
    let tests = declared
        .lines()
        .filter_map(|line| line.trim().strip_prefix('"')?.strip_suffix("\","));
    none(
        tests
            .filter(|test| {
                let name = test.rsplit("::").next().unwrap_or_default();
                !sources.contains(&format!("fn {name}("))
            })
            .map(|test| format!("tests/skips.toml: no test {test}")),
    );
}

/// Fails with all findings at once.
fn none(findings: impl Iterator<Item = String>) {
    let findings: Vec<String> = findings.collect();
    assert!(findings.is_empty(), "\n{}", findings.join("\n"));
}
