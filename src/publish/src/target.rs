//! Where a dataset goes: a folder, or a dataset repository of the Hub. Owns the reading of names;
//! opens nothing.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use reel_world::printable_line;

use crate::PublishError;

/// How names of repositories of the Hub begin when they are written as addresses.
const SCHEME: &str = "hf://datasets/";
/// Longest name of an owner or a repository.
const NAME_MAX: usize = 96;

/// Where a dataset goes.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Target {
    /// A folder on this machine.
    Folder(PathBuf),
    /// A dataset repository of the Hub.
    Hub(RepositoryId),
}

/// The name of a dataset repository, as `owner/name`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RepositoryId {
    owner: String,
    name: String,
}

impl Target {
    /// Reads `hf://datasets/OWNER/NAME` or `OWNER/NAME` as a repository, everything else as a
    /// folder. `exists` says whether a path is there: a name that may be both is refused.
    ///
    /// # Errors
    /// Fails if the name is empty, ambiguous, or the name of no repository.
    pub fn parse(text: &str, exists: impl Fn(&Path) -> bool) -> Result<Self, PublishError> {
        let refuse = |reason: &str| PublishError::TargetName {
            name: printable_line(text),
            reason: reason.to_owned(),
        };
        if let Some(id) = text.strip_prefix(SCHEME) {
            return RepositoryId::parse(id).map(Self::Hub).ok_or_else(|| {
                refuse("write hf://datasets/OWNER/NAME, in letters, digits, '-', '_' and '.'")
            });
        }
        if text.contains("://") {
            return Err(refuse("known are folders and hf://datasets/OWNER/NAME"));
        }
        if text.is_empty() {
            return Err(refuse("it is empty"));
        }
        match RepositoryId::parse(text) {
            Some(id) if exists(Path::new(text)) || exists(Path::new(&id.owner)) => Err(refuse(
                "it may be a folder or a repository; write ./ before a folder, hf://datasets/ before a repository",
            )),
            Some(id) => Ok(Self::Hub(id)),
            None => Ok(Self::Folder(PathBuf::from(text))),
        }
    }
}

impl RepositoryId {
    /// Reads `OWNER/NAME`; `None` if it is no such name.
    pub fn parse(text: &str) -> Option<Self> {
        let (owner, name) = text.split_once('/')?;
        (is_name(owner) && is_name(name)).then(|| Self {
            owner: owner.to_owned(),
            name: name.to_owned(),
        })
    }

    /// The user or the organization that owns the repository.
    pub fn owner(&self) -> &str {
        &self.owner
    }

    /// The name without its owner.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl fmt::Display for RepositoryId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.owner, self.name)
    }
}

/// The Hub's rule for names.
fn is_name(text: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    !text.is_empty()
        && text.len() <= NAME_MAX
        && text.chars().all(is_letter)
        && !text.starts_with(['-', '.'])
        && !text.ends_with(['-', '.'])
        && !text.contains("--")
        && !text.contains("..")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told_apart() {
        let none = |_: &Path| false;
        let hub = |text: &str| match Target::parse(text, none).unwrap() {
            Target::Hub(id) => id.to_string(),
            Target::Folder(path) => format!("folder {}", path.display()),
        };
        assert_eq!(hub("a-1/b.c"), "a-1/b.c");
        assert_eq!(hub("hf://datasets/a/b"), "a/b");
        for folder in ["out", "./a/b", "../a", "/a/b", "a/b/c", "a/b/", "a b/c"] {
            assert_eq!(hub(folder), format!("folder {folder}"));
        }
        for wrong in [
            "",
            "hf://a/b",
            "hf://datasets/a",
            "hf://datasets/../b",
            "s3://a/b",
        ] {
            assert!(Target::parse(wrong, none).is_err(), "{wrong}");
        }
        let ambiguous = Target::parse("a/b", |path| path == Path::new("a")).unwrap_err();
        assert!(ambiguous.to_string().contains("./"), "{ambiguous}");
    }
}
