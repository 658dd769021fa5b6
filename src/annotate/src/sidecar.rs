//! Notes in a file beside their trace, `<trace>.notes.jsonl`: a line that says whose notes they
//! are, then one line a decision. Never reads the trace itself.

use std::{
    ffi::OsString,
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use reel_world::Digest;
use serde::{Deserialize, Serialize};

use crate::{AnnotateError, Annotation};

/// First line of a notes file: which trace was annotated, and how.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Provenance {
    /// The trace that was annotated: its last chain digest.
    pub trace: Digest,
    /// Decisions of the trace.
    pub steps: usize,
    /// `rules`, or the name of the model.
    pub annotator: String,
    /// Version of the rules ([`crate::version`]), or that
    /// of the prompts ([`crate::prompt_version`]).
    pub version: Digest,
    /// Of the choice of words.
    pub seed: u64,
    /// How a model was asked; `None` where none was, and in files of before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request: Option<RequestForm>,
}

/// What a request to a model holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct RequestForm {
    /// Most decisions in one request.
    pub decisions: usize,
    /// Whether it holds the images that the robot saw.
    pub frames: bool,
}

/// A further line: the note of a decision.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Entry {
    /// The note itself; its fields are inlined in the line.
    #[serde(flatten)]
    pub note: Annotation,
    /// Why the rules wrote it in a model's place, if they did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fallback: Option<String>,
}

impl From<Annotation> for Entry {
    fn from(note: Annotation) -> Self {
        Entry {
            note,
            fallback: None,
        }
    }
}

/// Where the notes of a trace lie.
pub fn notes_path(trace: &Path) -> PathBuf {
    let mut name = OsString::from(trace);
    name.push(".notes.jsonl");
    name.into()
}

/// Writes notes as a whole or not at all: a reader never sees half a file.
///
/// # Errors
/// When the file cannot be written.
pub fn write_notes(
    path: &Path,
    provenance: &Provenance,
    entries: &[Entry],
) -> Result<(), AnnotateError> {
    let mut text = line(provenance);
    entries.iter().for_each(|entry| text.push_str(&line(entry)));
    let mut beside = OsString::from(path);
    beside.push(".new");
    let write = || -> io::Result<()> {
        let mut file = fs::File::create(&beside)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&beside, path)
    };
    write().map_err(|source| AnnotateError::Write {
        path: path.to_owned(),
        source,
    })
}

/// Reads the notes of a trace, one for each of its decisions.
///
/// # Errors
/// When there are none, they are damaged or incomplete, or those of another recording.
pub fn read_notes(path: &Path, trace: &Digest) -> Result<(Provenance, Vec<Entry>), AnnotateError> {
    let (provenance, entries) = read_some(path, trace)?;
    if entries.len() != provenance.steps {
        return Err(AnnotateError::Incomplete {
            path: path.to_owned(),
            expected: provenance.steps,
            found: entries.len(),
        });
    }
    Ok((provenance, entries))
}

/// Reads notes that may not be all yet.
pub(crate) fn read_some(
    path: &Path,
    trace: &Digest,
) -> Result<(Provenance, Vec<Entry>), AnnotateError> {
    let text = fs::read_to_string(path).map_err(|source| AnnotateError::Read {
        path: path.to_owned(),
        source,
    })?;
    let malformed = |line, expected, message: String| AnnotateError::Malformed {
        path: path.to_owned(),
        line,
        expected,
        message,
    };
    let mut lines = text.lines().enumerate();
    let (_, first) = lines
        .next()
        .ok_or_else(|| malformed(1, "provenance of notes", "the file is empty".to_owned()))?;
    let provenance: Provenance = serde_json::from_str(first)
        .map_err(|error| malformed(1, "provenance of notes", error.to_string()))?;
    if provenance.trace != *trace {
        return Err(AnnotateError::OtherTrace {
            path: path.to_owned(),
            expected: *trace,
            found: provenance.trace,
        });
    }
    let entry = |(index, line)| {
        serde_json::from_str(line).map_err(|error| malformed(index + 1, "note", error.to_string()))
    };
    let entries: Result<Vec<Entry>, _> = lines.map(entry).collect();
    Ok((provenance, entries?))
}

fn line<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("notes are always JSON") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn provenance(steps: usize) -> Provenance {
        Provenance {
            trace: Digest::of(b"a"),
            steps,
            annotator: "rules".to_owned(),
            version: Digest::of(b"v"),
            seed: 3,
            request: None,
        }
    }

    fn entry(word: &str) -> Entry {
        Annotation {
            reasoning: format!("{word}\n\"é\""),
            history: word.to_owned(),
            ..Annotation::default()
        }
        .into()
    }

    #[test]
    fn notes_come_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = notes_path(&folder.path().join("x.mcap"));
        assert!(path.ends_with("x.mcap.notes.jsonl"));
        let entries = [
            entry("a"),
            Entry {
                fallback: Some("it says too much".to_owned()),
                ..entry("b")
            },
        ];
        write_notes(&path, &provenance(2), &entries).unwrap();
        assert_eq!(
            read_notes(&path, &Digest::of(b"a")).unwrap(),
            (provenance(2), entries.to_vec())
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_does_not_belong_or_is_damaged_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes");
        let refusal = |trace: &[u8]| {
            read_notes(&path, &Digest::of(trace))
                .unwrap_err()
                .to_string()
        };
        assert!(refusal(b"a").contains("annotate the trace first"));
        write_notes(&path, &provenance(2), &[entry("a"), entry("b")]).unwrap();
        assert!(
            refusal(b"other").contains("recorded again"),
            "{}",
            refusal(b"other")
        );
        let whole = fs::read_to_string(&path).unwrap();
        let lines: Vec<&str> = whole.lines().collect();
        for (text, word) in [
            (String::new(), "line 1"),
            ("{}\n".to_owned(), "line 1 is not a provenance"),
            (lines[..2].join("\n"), "1 of 2 decisions"),
            (whole[..whole.len() - 9].to_owned(), "line 3 is not a note"),
        ] {
            fs::write(&path, text).unwrap();
            assert!(refusal(b"a").contains(word), "{word}: {}", refusal(b"a"));
        }
    }
}
