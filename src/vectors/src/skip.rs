//! Skipped parts of tests, declared in `tests/skips.toml`, and the programs outside this repository
//! that tests compare Reel with.
//!
//! A test that cannot do a part of its work calls [`skip`]. The skip is written to `skips.txt` in
//! the build folder, which `tests/skips.sh` prints. It is a failure if it is not declared, and on
//! CI also if the machine could have installed what is missing.

use std::{
    env,
    ffi::OsStr,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process::Command,
    thread,
};

const DECLARED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/skips.toml");

/// Skips a part of the running test that needs what the section `need` of `tests/skips.toml`
/// describes.
///
/// # Panics
/// Panics if the section does not list the test, or if the environment has `CI` and the section
/// says `ci = true`.
pub fn skip(need: &str, why: &str) {
    let program = env::current_exe().expect("a test is a program");
    let name = program.file_stem().unwrap_or_default().to_string_lossy();
    let name = name.rsplit_once('-').map_or(&*name, |(name, _hash)| name);
    let thread = thread::current();
    let test = thread.name().unwrap_or_default();
    println!("skipped: {need}: {why}");
    let declared = fs::read_to_string(DECLARED).expect("tests/skips.toml can be read");
    let section = section(&declared, need);
    // With one thread the test runner calls tests on its own, which has no test's name.
    let listed = |line: &str| line.trim() == format!("\"{name}::{test}\",") || test == "main";
    assert!(
        section.lines().any(listed),
        "an undeclared skip: list \"{name}::{test}\" under [{need}] in tests/skips.toml"
    );
    assert!(
        env::var_os("CI").is_none() || section.lines().any(|line| line == "ci = false"),
        "CI has to have what this test needs: {need}: {why}"
    );
    if let Some(target) = program.ancestors().nth(3) {
        let list = fs::File::options()
            .create(true)
            .append(true)
            .open(target.join("skips.txt"));
        let line = format!("{need}\t{name}::{test}\t{}\n", why.replace('\n', " "));
        list.and_then(|mut list| list.write_all(line.as_bytes()))
            .expect("the build folder can be written");
    }
}

/// The lines of a section, empty if there is none.
fn section<'a>(declared: &'a str, need: &str) -> &'a str {
    let (_, section) = declared
        .split_once(&format!("\n[{need}]\n"))
        .unwrap_or_default();
    section.split("\n[").next().unwrap_or_default()
}

/// The Python that has these modules, or `None` after a skip: `REEL_PYTHON`, or the one that
/// `tests/setup.sh` made.
pub fn python(modules: &str) -> Option<PathBuf> {
    let cache = env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(env::var_os("HOME")?).join(".cache")));
    let made = cache.map(|cache| cache.join("reel-python/tests/bin/python"));
    let python = env::var_os("REEL_PYTHON")
        .map(PathBuf::from)
        .or_else(|| made.filter(|python| python.is_file()))
        .unwrap_or_else(|| PathBuf::from("python3"));
    let found = Command::new(&python)
        .args(["-c", &format!("import {modules}")])
        .output();
    if found.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let why = format!("{} has not all of {modules}", python.display());
    skip("python", &format!("{why} (tests/setup.sh)"));
    None
}

/// A script of the folder `tests` under the program that executes it, for [`run`].
pub fn script(program: impl AsRef<OsStr>, path: &str) -> Command {
    let mut command = Command::new(program);
    command
        .arg(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests")).join(path))
        .env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

/// What a command writes to its standard output. Each line `skipped: NEED: WHY` in it is a [`skip`]
/// of the running test.
///
/// # Panics
/// Panics if the command cannot be run or fails, with all that it wrote.
pub fn run(command: &mut Command) -> String {
    let output = command
        .output()
        .unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{said}");
    assert!(
        output.status.success(),
        "{command:?}: {said}{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let skipped = said
        .lines()
        .filter_map(|line| line.trim().strip_prefix("skipped: "));
    for line in skipped {
        let (need, why) = line.split_once(": ").unwrap_or((line, ""));
        skip(need, why);
    }
    said
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_ends_where_the_next_begins() {
        let declared = "#\n[one]\nci = true\n\n[two]\nci = false\ntests = [\n    \"a::b\",\n]\n";
        assert_eq!(section(declared, "one"), "ci = true\n");
        assert!(section(declared, "two").ends_with("\"a::b\",\n]\n"));
        assert_eq!(section(declared, "three"), "");
    }

    #[test]
    #[should_panic(expected = "an undeclared skip: list \"reel_vectors::skip::tests::")]
    fn an_undeclared_skip_fails() {
        skip("real-bench", "to see it fail");
    }
}
