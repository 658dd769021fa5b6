//! The audit log: who changed, deleted, exported, granted or revoked what, one line of JSON each.
//! Only ever appended to; reading and playing are not in it.

use std::{
    fs::{self, OpenOptions},
    io::{self, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
    time::SystemTime,
};

use chrono::{DateTime, SecondsFormat, Utc};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// One change of what the server keeps, or of who may use it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct AuditEntry {
    /// When it was answered, in UTC (RFC 3339).
    pub at: String,
    /// Name of the token that was shown; none without tokens, and for changes on the command line.
    pub token: Option<String>,
    /// IP address of the client; none on the command line.
    pub client: Option<String>,
    /// The change: method and path of the request, or the command with its subject.
    pub action: String,
    /// HTTP status of the answer; none on the command line, where only what succeeded is kept.
    pub status: Option<u16>,
    /// The body of the request, if it is JSON and at most 4 KiB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request: Option<Value>,
}

impl AuditEntry {
    /// A change that was made on the command line.
    pub fn of_command(action: String) -> Self {
        Self {
            at: now(),
            token: None,
            client: None,
            action,
            status: None,
            request: None,
        }
    }
}

/// The time now, as an entry has it.
pub(crate) fn now() -> String {
    DateTime::<Utc>::from(SystemTime::now()).to_rfc3339_opts(SecondsFormat::Millis, true)
}

/// The file of all changes. It is opened for each of them, so that it may be moved away at any
/// time.
#[derive(Clone, Debug)]
pub struct AuditLog(PathBuf);

impl AuditLog {
    /// The log in this file, which is made by the first entry.
    pub fn at(path: PathBuf) -> Self {
        Self(path)
    }

    /// Appends an entry; it is on disk when this returns.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&self, entry: &AuditEntry) -> io::Result<()> {
        if let Some(folder) = self.0.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut line = serde_json::to_string(entry)?;
        line.push('\n');
        let mut options = OpenOptions::new();
        let mut file = options.create(true).read(true).append(true).open(&self.0)?;
        // What a full disk cut off ends here, and takes no entry with it.
        let mut last = [b'\n'];
        if file.seek(SeekFrom::End(-1)).is_ok() {
            file.read_exact(&mut last)?;
        }
        if last != *b"\n" {
            line.insert(0, '\n');
        }
        // In one piece: several processes may append.
        file.write_all(line.as_bytes())?;
        file.sync_data()
    }

    /// All entries, in the order in which they were made; none where there is no file yet. A line
    /// that a full disk cut off is passed over.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn entries(&self) -> io::Result<Vec<AuditEntry>> {
        let bytes = match fs::read(&self.0) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error),
        };
        let text = String::from_utf8_lossy(&bytes);
        let entries = text.lines().map(serde_json::from_str);
        Ok(entries.filter_map(Result::ok).collect())
    }

    /// Where the log is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_full_disk_cut_off_takes_no_other_entry_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let log = AuditLog::at(folder.path().join("data/audit.jsonl"));
        assert_eq!(log.entries().unwrap(), []);
        let entry = |action: &str| AuditEntry::of_command(action.to_owned());
        log.append(&entry("first")).unwrap();
        let mut file = OpenOptions::new().append(true).open(log.path()).unwrap();
        file.write_all(b"{\"at\":\"2026-\xff").unwrap();
        log.append(&entry("second")).unwrap();
        log.append(&entry("third")).unwrap();
        let actions: Vec<String> = log
            .entries()
            .unwrap()
            .into_iter()
            .map(|it| it.action)
            .collect();
        assert_eq!(actions, ["first", "second", "third"]);
    }
}
