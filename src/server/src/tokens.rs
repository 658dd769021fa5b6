//! Bearer tokens and what they allow. The file holds hashes: whoever reads it cannot use it.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::SystemTime,
};

use reel_live::Owner;
use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

use crate::files::put;

/// What a client may do. `act` does not include `read`: a policy must not read what it is graded
/// by. `admin` includes both.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read episodes, tables and traces, and ask about them.
    Read,
    /// Play: policy sessions and prompt groups.
    Act,
    /// All of that, and change what is kept: uploads, jobs, labels, other people's sessions.
    Admin,
}

impl Role {
    /// Parses the name of a role; `None` if there is no such role.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "read" => Some(Role::Read),
            "act" => Some(Role::Act),
            "admin" => Some(Role::Admin),
            _ => None,
        }
    }

    /// Its name, as in the file of tokens and in the OpenAPI document.
    pub const fn name(self) -> &'static str {
        match self {
            Role::Read => "read",
            Role::Act => "act",
            Role::Admin => "admin",
        }
    }
}

/// A token, without what proves it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenEntry {
    /// Name of the token, by which it is revoked.
    pub name: String,
    /// Roles that the token grants to its holder.
    pub roles: BTreeSet<Role>,
    /// BLAKE3 of the token: 256 random bits need no salt.
    pub hash: String,
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    token: Vec<TokenEntry>,
}

/// Why tokens cannot be had.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TokenError {
    /// The file cannot be read or written.
    #[error("cannot {action} {path}: {source}", path = path.display())]
    Io {
        /// Operation that failed, as a verb, e.g. `read` or `write`.
        action: &'static str,
        /// Path of the token file, e.g. `tokens.toml`.
        path: PathBuf,
        source: io::Error,
    },
    /// It is no file of tokens.
    #[error("{path} is not a token file: {message}", path = path.display())]
    Syntax { path: PathBuf, message: String },
    /// A name that would not show who it is in a log.
    #[error("'{}' cannot be the name of a token: it is empty, or holds control characters", .0.escape_debug())]
    Name(String),
    /// A name that is taken.
    #[error("token '{0}' exists already; revoke it first")]
    Taken(String),
    /// A name of nobody.
    #[error("unknown token '{0}'")]
    Unknown(String),
}

/// The tokens of a file, read again when it changes.
pub struct Tokens {
    path: PathBuf,
    known: Mutex<(Option<SystemTime>, Arc<Vec<TokenEntry>>)>,
    were_in_use: AtomicBool,
    /// What ends with a token that somebody showed, by its hash.
    shown: Mutex<BTreeMap<String, CancellationToken>>,
}

impl Tokens {
    /// The tokens of a file; none where there is no file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn open(path: &Path) -> Result<Self, TokenError> {
        let entries = read(path)?;
        let found = changed(path);
        let were_in_use = AtomicBool::new(found.is_some());
        Ok(Self {
            path: path.to_owned(),
            known: Mutex::new((found, Arc::new(entries))),
            were_in_use,
            shown: Mutex::default(),
        })
    }

    /// All tokens of the file as it was last read.
    pub fn entries(&self) -> Arc<Vec<TokenEntry>> {
        self.known
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .1
            .clone()
    }

    /// Whether there is, or was, a file of tokens. An empty one lets nobody in: who revoked the
    /// last token, or moved the file away, did not open the doors.
    pub fn in_use(&self) -> bool {
        let is_there = self
            .known
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .0
            .is_some();
        self.were_in_use.fetch_or(is_there, Ordering::AcqRel) || is_there
    }

    /// Looks whether the file changed, and ends what hangs on tokens that are gone or have lost a
    /// role; says whose they were. A file that became unreadable leaves the tokens as they were.
    ///
    /// # Errors
    /// When it changed and cannot be read.
    pub fn refresh(&self) -> Result<Vec<String>, TokenError> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let now = changed(&self.path);
        if known.0 == now {
            return Ok(Vec::new());
        }
        let before = std::mem::replace(&mut *known, (now, Arc::new(read(&self.path)?))).1;
        let kept = |old: &TokenEntry| {
            let same = known.1.iter().find(|new| new.hash == old.hash);
            same.is_some_and(|new| {
                let all = new.roles.contains(&Role::Admin) || new.roles.is_superset(&old.roles);
                new.name == old.name && all
            })
        };
        let gone = before.iter().filter(|entry| !kept(entry));
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let gone = gone.map(|entry| {
            if let Some(ends) = shown.remove(&entry.hash) {
                ends.cancel();
            }
            entry.name.clone()
        });
        Ok(gone.collect())
    }

    /// Cancelled when this token is taken back or loses a role.
    pub fn revocation(&self, entry: &TokenEntry) -> CancellationToken {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if !known.1.iter().any(|known| known.hash == entry.hash) {
            let gone = CancellationToken::new();
            gone.cancel();
            return gone;
        }
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        shown.entry(entry.hash.clone()).or_default().clone()
    }

    /// Whose token this is.
    pub fn find(&self, token: &str) -> Option<TokenEntry> {
        let hash = hash(token);
        // Comparing hashes of random tokens tells nothing about them, however long it takes.
        self.entries()
            .iter()
            .find(|entry| entry.hash == hash)
            .cloned()
    }

    /// Whether the token of this owner has a role.
    pub(crate) fn has_role(&self, owner: &Owner, role: Role) -> bool {
        let has =
            |entry: &TokenEntry| owner.name() == Some(&*entry.name) && entry.roles.contains(&role);
        self.entries().iter().any(has)
    }

    /// Makes a token and keeps its hash. Nobody can see the token again.
    ///
    /// # Errors
    /// When the name is taken or the file cannot be written.
    pub fn create(&self, name: &str, roles: BTreeSet<Role>) -> Result<String, TokenError> {
        if name.is_empty() || name.chars().any(char::is_control) {
            return Err(TokenError::Name(name.to_owned()));
        }
        let mut entries = read(&self.path)?;
        if entries.iter().any(|entry| entry.name == name) {
            return Err(TokenError::Taken(name.to_owned()));
        }
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes).expect("the system has randomness");
        let token = format!(
            "reel_{}",
            bytes
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect::<String>()
        );
        entries.push(TokenEntry {
            name: name.to_owned(),
            roles,
            hash: hash(&token),
        });
        self.write(entries)?;
        Ok(token)
    }

    /// Takes a token back.
    ///
    /// # Errors
    /// When there is none of that name or the file cannot be written.
    pub fn revoke(&self, name: &str) -> Result<(), TokenError> {
        let mut entries = read(&self.path)?;
        let before = entries.len();
        entries.retain(|entry| entry.name != name);
        if entries.len() == before {
            return Err(TokenError::Unknown(name.to_owned()));
        }
        self.write(entries)
    }

    fn write(&self, token: Vec<TokenEntry>) -> Result<(), TokenError> {
        let failed = |action| {
            move |source| TokenError::Io {
                action,
                path: self.path.clone(),
                source,
            }
        };
        if let Some(folder) = self
            .path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
        {
            fs::create_dir_all(folder).map_err(failed("make the folder of"))?;
        }
        let text = toml::to_string_pretty(&File { token }).expect("tokens have a TOML form");
        put(&self.path, &text).map_err(failed("write"))?;
        self.refresh().map(drop)
    }
}

fn hash(token: &str) -> String {
    blake3::hash(token.as_bytes()).to_hex().to_string()
}

fn changed(path: &Path) -> Option<SystemTime> {
    fs::metadata(path)
        .and_then(|metadata| metadata.modified())
        .ok()
}

fn read(path: &Path) -> Result<Vec<TokenEntry>, TokenError> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => {
            return Err(TokenError::Io {
                action: "read",
                path: path.to_owned(),
                source,
            });
        }
    };
    let file: File = toml::from_str(&text).map_err(|error| TokenError::Syntax {
        path: path.to_owned(),
        message: error.to_string().trim_end().to_owned(),
    })?;
    Ok(file.token)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_found_by_itself_alone_and_not_after_it_was_revoked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys/tokens.toml");
        let tokens = Tokens::open(&path).unwrap();
        assert!(tokens.entries().is_empty());
        let token = tokens.create("trainer", [Role::Act].into()).unwrap();
        for name in ["", "a\nb", "a\u{1b}[31m"] {
            let refused = tokens.create(name, [Role::Act].into());
            assert!(matches!(refused, Err(TokenError::Name(_))), "{name:?}");
        }
        assert!(matches!(
            tokens.create("trainer", [Role::Read].into()),
            Err(TokenError::Taken(_))
        ));
        assert!(
            !fs::read_to_string(&path).unwrap().contains(&token),
            "the token itself is nowhere"
        );
        assert_eq!(tokens.find(&token).unwrap().roles, [Role::Act].into());
        let hash = tokens.find(&token).unwrap().hash;
        for wrong in ["", "reel_", &token[..token.len() - 1], &hash] {
            assert!(tokens.find(wrong).is_none(), "{wrong}");
        }
        let ends = tokens.revocation(&tokens.find(&token).unwrap());
        // Another process revokes it.
        Tokens::open(&path).unwrap().revoke("trainer").unwrap();
        assert!(matches!(
            tokens.revoke("trainer"),
            Err(TokenError::Unknown(_))
        ));
        assert!(!ends.is_cancelled());
        assert_eq!(tokens.refresh().unwrap(), ["trainer"]);
        assert!(tokens.find(&token).is_none() && ends.is_cancelled());
        fs::write(&path, "token = 3").unwrap();
        assert!(matches!(
            Tokens::open(&path),
            Err(TokenError::Syntax { .. })
        ));
    }
}
