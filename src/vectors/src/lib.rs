//! Fixtures of the tests of several crates: what they read of REAL from outside the repository,
//! with a report that compares ours with it; and, as features, episodes that are made up
//! ([`play`]), what other formats lose of them ([`round_trip`]), episodes that are played ([`episodes`]), an endpoint of a model ([`scripted`]) and a
//! Hugging Face Hub ([`hub`]).
//! Only tests depend on it. Vector files hold inputs and outputs of REAL's published code:
//! `REEL_REAL_CONTRACT` names their folder, `../shared/real-contract/vectors` beside the checkout
//! is the default. [`real_bench`] finds the benchmark, [`python`] what answers are compared with;
//! where one of them is absent, the test says what it leaves out with [`skip()`].
//!
//! ```no_run
//! use reel_vectors::{Report, load};
//! # fn ours(case: &serde_json::Value) -> serde_json::Value { case.clone() }
//! if let Some(document) = load("reward.json") {
//!     let mut report = Report::new("reward.json", "cases");
//!     for case in reel_vectors::items(&document["cases"]) {
//!         report.compare(reel_vectors::text(&case["id"]), &case["expect"], &ours(case));
//!     }
//!     report.finish(); // prints one line, fails if a case is different
//! }
//! ```

pub mod checkout;
#[cfg(feature = "episodes")]
pub mod episodes;
#[cfg(feature = "hub")]
pub mod hub;
#[cfg(feature = "play")]
pub mod play;
#[cfg(feature = "play")]
pub mod round_trip;
#[cfg(feature = "scripted")]
pub mod scripted;
mod skip;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;

pub use skip::{python, run, script, skip};

/// Differences that [`Report::finish`] prints in full.
const DIFFERENCES_SHOWN: usize = 12;

/// Vectors hold floats rounded to nine decimal places.
const TOLERANCE: f64 = 1e-9;

/// How one part of a vector file compares. [`Report::finish`] must be called.
#[derive(Debug)]
#[must_use = "a report that is not finished checks nothing"]
pub struct Report {
    file: String,
    part: String,
    equal: usize,
    differences: Vec<String>,
    deviations: BTreeMap<String, usize>,
}

/// Whether the keys of an object must come in the same order.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum KeyOrder {
    /// Objects are equal if they hold the same keys and values.
    Any,
    /// Objects are equal if they also hold them in the same order.
    Same,
}

/// Whether tests run in their long form: `make acceptance` sets `REEL_LONG`, `make test` does not.
pub fn is_long() -> bool {
    std::env::var_os("REEL_LONG").is_some()
}

/// The arguments of a script that has a short form: `--short`, or none where tests run in their long form.
pub fn form() -> &'static [&'static str] {
    match is_long() {
        true => &[],
        false => &["--short"],
    }
}

/// The traces in a folder, by name.
pub fn traces_in(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "mcap")
    });
    paths.sort();
    paths
}

/// The golden traces of the repository.
pub fn golden_traces() -> Vec<PathBuf> {
    let paths = traces_in(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden"));
    assert!(paths.len() > 20, "{} golden traces", paths.len());
    paths
}

/// The folder of the vector files, or `None` after a [`skip()`].
///
/// # Panics
/// Panics if `REEL_REAL_CONTRACT` names a folder that does not exist.
pub fn folder() -> Option<PathBuf> {
    outside(
        "REEL_REAL_CONTRACT",
        "real-contract/vectors",
        "real-contract",
    )
}

/// The folder of REAL-Bench's tasks, or `None` after a [`skip()`]. `REEL_REAL_BENCH` names the
/// folder, `../shared/real-bench` beside the checkout is the default.
///
/// # Panics
/// Panics if `REEL_REAL_BENCH` names a folder that does not exist.
pub fn real_bench() -> Option<PathBuf> {
    outside("REEL_REAL_BENCH", "real-bench", "real-bench")
}

fn outside(variable: &str, beside: &str, need: &str) -> Option<PathBuf> {
    let named = std::env::var_os(variable).map(PathBuf::from);
    let beside = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(beside);
    match named {
        // empty: as on a machine without the data
        Some(named) if named.as_os_str().is_empty() => {}
        Some(named) if named.is_dir() => return Some(named),
        Some(named) => panic!("{variable} names {}, which is no folder", named.display()),
        None if beside.is_dir() => return Some(beside),
        None => {}
    }
    skip(
        need,
        &format!("nothing at {} (set {variable})", beside.display()),
    );
    None
}

/// The document of a vector file, or `None` if the folder of vector files is absent.
///
/// # Panics
/// Panics if the folder is there and the file is not, or is no JSON.
pub fn load(file: &str) -> Option<Value> {
    let path = folder()?.join(file);
    let text =
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    Some(serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

/// The elements of an array of a vector file.
///
/// # Panics
/// Panics if the value is no array.
pub fn items(value: &Value) -> &[Value] {
    value
        .as_array()
        .unwrap_or_else(|| panic!("expected an array, found {value}"))
}

/// A text of a vector file.
///
/// # Panics
/// Panics if the value is no string.
pub fn text(value: &Value) -> &str {
    value
        .as_str()
        .unwrap_or_else(|| panic!("expected a string, found {value}"))
}

/// Where two values differ first, as a path and both values, or `None` if they are equal. Numbers
/// are equal within 1e-9 if both are integers or both are floats.
pub fn difference(expected: &Value, found: &Value, order: KeyOrder) -> Option<String> {
    differ("", expected, found, order)
}

impl Report {
    /// A report of one part of a file, e.g. `cases` of `reward.json`.
    pub fn new(file: &str, part: &str) -> Self {
        let (file, part) = (file.to_owned(), part.to_owned());
        Self {
            file,
            part,
            equal: 0,
            differences: Vec::new(),
            deviations: BTreeMap::new(),
        }
    }

    /// Counts a case whose keys may come in any order.
    pub fn compare(&mut self, case: &str, expected: &Value, found: &Value) {
        self.count(case, difference(expected, found, KeyOrder::Any));
    }

    /// Counts a case whose keys have to come in the published order.
    pub fn compare_ordered(&mut self, case: &str, expected: &Value, found: &Value) {
        self.count(case, difference(expected, found, KeyOrder::Same));
    }

    /// Counts a case that is equal if `difference` is `None`.
    pub fn count(&mut self, case: &str, difference: Option<String>) {
        match difference {
            None => self.equal += 1,
            Some(difference) => self.differences.push(format!("{case}: {difference}")),
        }
    }

    /// Counts a case that differs on purpose. Every cause is listed in `docs/real-agents.md`.
    pub fn deviation(&mut self, cause: &str) {
        *self.deviations.entry(cause.to_owned()).or_default() += 1;
    }

    /// Prints the line that `make real-contract` collects.
    ///
    /// # Panics
    /// Panics if a case is different, or if there was no case.
    pub fn finish(self) {
        let Self {
            file,
            part,
            equal,
            differences,
            deviations,
        } = self;
        let (different, deviating) = (differences.len(), deviations.values().sum::<usize>());
        let cases = equal + different + deviating;
        println!("real-contract\t{file}\t{part}\t{cases}\t{equal}\t{different}\t{deviating}");
        for (cause, count) in &deviations {
            println!("real-contract-cause\t{file}\t{part}\t{count}\t{cause}");
        }
        assert!(cases > 0, "{file}, {part}: no case was compared");
        let shown: Vec<_> = differences
            .iter()
            .take(DIFFERENCES_SHOWN)
            .map(String::as_str)
            .collect();
        assert!(
            different == 0,
            "{file}, {part}: {different} of {cases} cases differ:\n{}",
            shown.join("\n")
        );
    }
}

fn differ(path: &str, expected: &Value, found: &Value, order: KeyOrder) -> Option<String> {
    let unequal = || Some(format!("{path}: expected {expected}, found {found}"));
    match (expected, found) {
        (Value::Number(one), Value::Number(other)) => {
            let same_kind = one.is_f64() == other.is_f64();
            let near = one == other
                || one
                    .as_f64()
                    .zip(other.as_f64())
                    .is_some_and(|(one, other)| (one - other).abs() <= TOLERANCE);
            if same_kind && near { None } else { unequal() }
        }
        (Value::Array(one), Value::Array(other)) => {
            if one.len() != other.len() {
                return unequal();
            }
            one.iter()
                .zip(other)
                .enumerate()
                .find_map(|(at, (one, other))| differ(&format!("{path}[{at}]"), one, other, order))
        }
        (Value::Object(one), Value::Object(other)) => {
            let (keys, others): (Vec<_>, Vec<_>) = (one.keys().collect(), other.keys().collect());
            let same = if order == KeyOrder::Same {
                keys == others
            } else {
                keys.len() == others.len() && keys.iter().all(|key| other.contains_key(*key))
            };
            if !same {
                return Some(format!("{path}: expected keys {keys:?}, found {others:?}"));
            }
            one.iter().find_map(|(key, value)| {
                differ(&format!("{path}.{key}"), value, &other[key], order)
            })
        }
        _ if expected == found => None,
        _ => unequal(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn types_order_and_values_are_told_apart() {
        let equal = |one: Value, other: Value, order| difference(&one, &other, order).is_none();
        assert!(equal(
            json!({"a": 1, "b": 0.1}),
            json!({"b": 0.1, "a": 1}),
            KeyOrder::Any
        ));
        assert!(!equal(
            json!({"a": 1, "b": 2}),
            json!({"b": 2, "a": 1}),
            KeyOrder::Same
        ));
        assert!(!equal(
            json!({"a": 1}),
            json!({"a": 1, "b": null}),
            KeyOrder::Any
        ));
        assert!(!equal(json!(1), json!(1.0), KeyOrder::Any));
        assert!(!equal(json!("1"), json!(1), KeyOrder::Any));
        assert!(!equal(json!([1, 2]), json!([1]), KeyOrder::Any));
        assert!(equal(json!(0.3), json!(0.1 + 0.2), KeyOrder::Any));
        assert!(!equal(json!(0.3), json!(0.300_001), KeyOrder::Any));
    }

    #[test]
    #[should_panic(expected = "1 of 2 cases differ:\ntwo: .a: expected 1, found 2")]
    fn a_report_with_a_difference_fails_and_names_it() {
        let mut report = Report::new("file.json", "part");
        report.compare("one", &json!({"a": 1}), &json!({"a": 1}));
        report.compare("two", &json!({"a": 1}), &json!({"a": 2}));
        report.finish();
    }

    #[test]
    #[should_panic(expected = "no case was compared")]
    fn a_report_without_cases_fails() {
        Report::new("file.json", "part").finish();
    }
}
