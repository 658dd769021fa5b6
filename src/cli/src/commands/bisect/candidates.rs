//! The row of candidates, from the good end to the bad one.

use std::{fmt, path::Path, process::Command};

use anyhow::{Context, bail};

use super::Arguments;

/// One of the things that are compared.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Candidate {
    /// Its name: a file, a preset, a commit.
    pub(super) name: String,
    /// Subject of a commit; empty for others.
    pub(super) about: String,
}

impl fmt::Display for Candidate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)?;
        if !self.about.is_empty() {
            write!(f, " ({})", self.about)?;
        }
        Ok(())
    }
}

/// The candidates in their order.
pub(super) fn row(arguments: &Arguments) -> anyhow::Result<Vec<Candidate>> {
    let Arguments { good, bad, .. } = arguments;
    if let Some(repository) = &arguments.git {
        return commits(repository, good, bad);
    }
    let names = between(good, bad, ordered(good, bad, &arguments.candidates))?;
    let named = |name| Candidate {
        name,
        about: String::new(),
    };
    Ok(names.into_iter().map(named).collect())
}

/// The candidates from the good to the bad end. Ends that are not among them come before and behind.
fn between(good: &str, bad: &str, mut names: Vec<String>) -> anyhow::Result<Vec<String>> {
    if good == bad {
        bail!("--good and --bad are both '{good}': there is nothing between them");
    }
    if let Some(repeated) = names
        .iter()
        .enumerate()
        .find_map(|(at, name)| names[..at].contains(name).then_some(name))
    {
        bail!("candidate '{repeated}' is named twice");
    }
    let place = |names: &[String], end: &str| names.iter().position(|name| name == end);
    if let (Some(from), Some(to)) = (place(&names, good), place(&names, bad))
        && to < from
    {
        names.reverse();
    }
    if let Some(from) = place(&names, good) {
        names.drain(..from);
    } else {
        names.insert(0, good.to_owned());
    }
    match place(&names, bad) {
        Some(to) => names.truncate(to + 1),
        None => names.push(bad.to_owned()),
    }
    Ok(names)
}

/// The candidates in the order of their numbers, with the ends in their places, where these have such numbers; else as given.
fn ordered(good: &str, bad: &str, candidates: &[String]) -> Vec<String> {
    let ends = [good, bad].into_iter().map(str::to_owned);
    let ends = ends.filter(|end| !candidates.contains(end));
    let all: Vec<String> = candidates.iter().cloned().chain(ends).collect();
    by_number(all)
        .or_else(|| by_number(candidates.to_vec()))
        .unwrap_or_else(|| candidates.to_vec())
}

/// Names that differ in one number only (`step-200`, `step-1000`) in its order, as no shell lists them; nothing where they do not.
fn by_number(mut names: Vec<String>) -> Option<Vec<String>> {
    let split: Vec<Vec<&str>> = names.iter().map(|name| parts(name)).collect();
    let first = split.first()?;
    if split.iter().any(|parts| parts.len() != first.len()) {
        return None;
    }
    let differ = |part: &usize| split.iter().any(|parts| parts[*part] != first[*part]);
    let differing: Vec<usize> = (0..first.len()).filter(differ).collect();
    let [part] = differing[..] else {
        return None;
    };
    // `0.5` is more than `0.125`, and `v1.5` less than `v1.12`: which is meant nobody says.
    if part >= 2 && first[part - 1] == "." && first[part - 2].parse::<u64>().is_ok() {
        return None;
    }
    let number = |name: &String| parts(name)[part].parse::<u64>();
    if names.iter().any(|name| number(name).is_err()) {
        return None;
    }
    names.sort_by_cached_key(|name| number(name).unwrap_or_default());
    Some(names)
}

/// A name cut where digits begin and end.
fn parts(name: &str) -> Vec<&str> {
    let bytes = name.as_bytes();
    let is_digit = |at: usize| bytes[at].is_ascii_digit();
    let cuts = (1..bytes.len()).filter(|at| is_digit(*at) != is_digit(at - 1));
    let mut parts = Vec::new();
    let mut from = 0;
    for cut in cuts.chain([bytes.len()]) {
        parts.extend(name.get(from..cut));
        from = cut;
    }
    parts
}

fn commits(repository: &Path, good: &str, bad: &str) -> anyhow::Result<Vec<Candidate>> {
    let commit = |revision: &str| {
        git(
            repository,
            &[
                "rev-parse",
                "--verify",
                "--end-of-options",
                &format!("{revision}^{{commit}}"),
            ],
        )
    };
    let (good, bad) = (commit(good)?, commit(bad)?);
    let (good, bad) = (good.trim(), bad.trim());
    if git(repository, &["merge-base", "--is-ancestor", good, bad]).is_err() {
        bail!(
            "the good commit {good} is not an ancestor of the bad one {bad}: there is no row of commits from it"
        );
    }
    let form = [
        "-c",
        "log.showSignature=false",
        "log",
        "--first-parent",
        "--reverse",
        "--format=%h %s",
    ];
    let line = |range: &str, more: &[&str]| git(repository, &[&form[..], more, &[range]].concat());
    let listed = line(good, &["--max-count=1"])? + &line(&format!("{good}..{bad}"), &[])?;
    let candidates = listed.lines().map(|line| {
        let (name, about) = line.split_once(' ').unwrap_or((line, ""));
        Candidate {
            name: name.to_owned(),
            about: about.replace(char::is_control, " "),
        }
    });
    let candidates: Vec<Candidate> = candidates.collect();
    match candidates.len() {
        0 | 1 => bail!("there is no commit from {good} to {bad}"),
        _ => Ok(candidates),
    }
}

/// What git prints in a repository.
pub(super) fn git(repository: &Path, arguments: &[&str]) -> anyhow::Result<String> {
    let output = Command::new("git")
        .arg("-C")
        .arg(repository)
        .args(arguments)
        .output()
        .context("cannot start git; --git needs it")?;
    if !output.status.success() {
        bail!(
            "git {} in {}: {}",
            arguments.join(" "),
            repository.display(),
            String::from_utf8_lossy(&output.stderr).trim()
        );
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn owned(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn numbers_are_ordered_where_names_differ_in_nothing_else() {
        for (given, ordered) in [
            (
                &["step-1000", "step-200", "step-30"][..],
                &["step-30", "step-200", "step-1000"][..],
            ),
            (
                &["b-2/x9", "b-10/x9", "b-1/x9"],
                &["b-1/x9", "b-2/x9", "b-10/x9"],
            ),
        ] {
            assert_eq!(by_number(owned(given)), Some(owned(ordered)));
        }
        for given in [
            &["terse", "long", "a"][..],
            &["a2", "b1"],
            &["v2.1", "v1.2"],
            &["lr-0.125", "lr-0.5"],
            &[],
        ] {
            assert_eq!(by_number(owned(given)), None);
        }
        assert_eq!(parts("é1ü22"), ["é", "1", "ü", "22"]);
    }

    #[test]
    fn the_row_leads_from_good_to_bad() {
        let row = |good: &str, bad: &str| between(good, bad, owned(&["a", "b", "c", "d"]));
        assert_eq!(row("b", "d").unwrap(), ["b", "c", "d"]);
        assert_eq!(row("c", "a").unwrap(), ["c", "b", "a"]);
        assert_eq!(row("x", "b").unwrap(), ["x", "a", "b"]);
        assert_eq!(row("c", "y").unwrap(), ["c", "d", "y"]);
        assert!(row("a", "a").is_err());
        // Candidates beyond the ends are none, also where the ends are not among them.
        let row = |good: &str, bad: &str, names: &[&str]| {
            let names = owned(names);
            between(good, bad, ordered(good, bad, &names)).unwrap()
        };
        assert_eq!(
            row("c2", "c6", &["c1", "c3", "c5", "c7"]),
            ["c2", "c3", "c5", "c6"]
        );
        assert_eq!(row("c6", "c2", &["c1", "c3", "c7"]), ["c6", "c3", "c2"]);
        assert_eq!(
            row("base", "c11", &["c1", "c11", "c7"]),
            ["base", "c1", "c7", "c11"]
        );
        assert!(between("a", "b", owned(&["c", "c"])).is_err());
    }
}
