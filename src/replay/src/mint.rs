//! Writing a corpus of golden traces anew with this simulator: lean, and never without a reason.
//!
//! Everything is executed and written beside the corpus first; only then do files take their
//! places, one by one, each of them whole. Never deletes what another version of the simulator
//! recorded: it moves to `v<N>/`.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use reel_sim::{SIM_VERSION, sim_version};
use reel_trace::{Images, Recorder, Trace, TraceError};

use crate::{Changes, Verdict, changes::Reexecution, verify_trace};

/// Fewest characters of a reason.
const REASON_CHARS: usize = 10;
/// Where reasons are kept, in the corpus.
const NOTES: &str = "NOTES.md";
/// Where new traces lie until all of them are written, in the corpus.
const WORKSHOP: &str = ".minting";

/// What to mint: the corpus, the reason and the traces to add.
#[derive(Clone, Debug)]
pub struct MintOptions<'a> {
    /// The folder of the golden traces.
    pub corpus: &'a Path,
    /// Why: for those who wonder later.
    pub reason: &'a str,
    /// Recorded traces to take in, under their own names; each must replay exactly.
    pub add: &'a [PathBuf],
}

/// Result of minting a corpus: the simulator version and every trace in it.
#[derive(Clone, PartialEq, Debug)]
pub struct Minted {
    /// Current simulator version, under which the notes list this minting.
    pub sim_version: u32,
    /// Every trace of the corpus, in the order of their names.
    pub traces: Vec<MintedTrace>,
}

/// A trace that was minted.
#[derive(Clone, PartialEq, Debug)]
pub struct MintedTrace {
    /// Its path in the corpus.
    pub name: PathBuf,
    /// Whether it is new there.
    pub added: bool,
    /// Whether its bytes differ from what stood there.
    pub rewritten: bool,
    /// What differs from how it was recorded.
    pub changes: Changes,
}

/// Why nothing was minted. The corpus is as it was, unless `Place` says otherwise.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum MintError {
    /// No reason worth the name.
    #[error(
        "a golden trace changes only for a reason; '{reason}' has fewer than {REASON_CHARS} characters: say what changed and why"
    )]
    Reason { reason: String },
    /// The corpus holds no trace, and none is added.
    #[error("there is no .mcap file in {corpus}; add the first ones with --add")]
    Empty { corpus: PathBuf },
    /// A trace cannot be read.
    #[error(transparent)]
    Trace(#[from] TraceError),
    /// A trace cannot be executed.
    #[error("{path}: {verdict}")]
    NotExecutable {
        path: PathBuf,
        verdict: Box<Verdict>,
    },
    /// A trace breaks off.
    #[error("{path} has no end; play the episode again or leave it out")]
    NoEnd { path: PathBuf },
    /// A trace of this very version gives something else.
    #[error(
        "{path} was recorded by simulator {version}, which is this one's number too, but it is not exact: {verdict}; \
         raise SIM_VERSION, or find what broke"
    )]
    SameVersion {
        path: PathBuf,
        version: u32,
        verdict: Box<Verdict>,
    },
    /// A trace to add does not replay.
    #[error("{path} is not exact and cannot be added: {verdict}")]
    NotExact {
        path: PathBuf,
        verdict: Box<Verdict>,
    },
    /// Something else stands where a trace should go.
    #[error("{path} stands there already; give the new one another name")]
    Taken { path: PathBuf },
    /// The operating system refused while everything still stood where it was.
    #[error("cannot {action} {path}: {source}; nothing was changed in the corpus")]
    Io {
        /// Operation that failed, as a verb, e.g. `read` or `copy`.
        action: &'static str,
        path: PathBuf,
        source: io::Error,
    },
    /// The operating system refused while files took their places.
    #[error(
        "cannot write {path}: {source}; nothing is lost, but some traces are new and some old: mint again"
    )]
    Place { path: PathBuf, source: io::Error },
}

/// The traces of a corpus, sorted; those of older simulators in `v<N>/` are no part of it.
///
/// # Errors
/// When a folder cannot be listed.
pub fn corpus(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() {
            let old = name
                .strip_prefix('v')
                .is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()));
            if !old && name != WORKSHOP {
                found.extend(corpus(&path)?);
            }
        } else if path
            .extension()
            .is_some_and(|extension| extension == "mcap")
        {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Writes every trace of a corpus anew and tells why in its notes.
///
/// # Errors
/// The first thing that is wrong; [`MintError`] says what became of the corpus.
pub fn mint(options: &MintOptions<'_>) -> Result<Minted, MintError> {
    let reason = options
        .reason
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    if reason.chars().count() < REASON_CHARS {
        return Err(MintError::Reason { reason });
    }
    fs::create_dir_all(options.corpus).map_err(failed("make", options.corpus))?;
    let workshop = options.corpus.join(WORKSHOP);
    // What a minting that broke off left is only copies.
    if workshop.exists() {
        fs::remove_dir_all(&workshop).map_err(failed("clear", &workshop))?;
    }
    let result = write_all(options, &reason, &workshop).and_then(|(minted, places)| {
        for (from, to) in places {
            let placed = fs::create_dir_all(to.parent().unwrap_or(&to))
                .and_then(|()| fs::rename(&from, &to));
            placed.map_err(|source| MintError::Place { path: to, source })?;
        }
        Ok(minted)
    });
    let _ = fs::remove_dir_all(&workshop);
    result
}

/// A file of the workshop, and the place it takes.
type StagedFile = (PathBuf, PathBuf);

/// Writes everything new into the workshop; what is there afterwards only has to take its
/// place, in this order.
fn write_all(
    options: &MintOptions<'_>,
    reason: &str,
    workshop: &Path,
) -> Result<(Minted, Vec<StagedFile>), MintError> {
    let listed = corpus(options.corpus).map_err(failed("list", options.corpus))?;
    if listed.is_empty() && options.add.is_empty() {
        return Err(MintError::Empty {
            corpus: options.corpus.to_owned(),
        });
    }
    let (mut traces, mut places) = (Vec::new(), Vec::new());
    for path in &listed {
        let name = path
            .strip_prefix(options.corpus)
            .expect("it was found in the corpus")
            .to_owned();
        traces.push(write_one(
            options.corpus,
            path,
            name,
            false,
            workshop,
            &mut places,
        )?);
    }
    for path in options.add {
        let name = PathBuf::from(path.file_name().unwrap_or_default());
        if traces.iter().any(|trace: &MintedTrace| trace.name == name) {
            return Err(MintError::Taken {
                path: options.corpus.join(name),
            });
        }
        traces.push(write_one(
            options.corpus,
            path,
            name,
            true,
            workshop,
            &mut places,
        )?);
    }
    traces.sort_by(|a, b| a.name.cmp(&b.name));
    let minted = Minted {
        sim_version: SIM_VERSION,
        traces,
    };
    let (notes, new_notes) = (options.corpus.join(NOTES), workshop.join(NOTES));
    let mut text = match fs::read_to_string(&notes) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            "# Notes on the golden traces\n".to_owned()
        }
        Err(error) => return Err(failed("read", &notes)(error)),
    };
    text.push_str(&minted.note(reason));
    fs::write(&new_notes, text).map_err(failed("write", &new_notes))?;
    places.push((new_notes, notes));
    Ok((minted, places))
}

/// Executes one trace and writes it, and a copy of the old one if another simulator recorded
/// it, into the workshop.
fn write_one(
    corpus: &Path,
    path: &Path,
    name: PathBuf,
    added: bool,
    workshop: &Path,
    places: &mut Vec<StagedFile>,
) -> Result<MintedTrace, MintError> {
    let trace = Trace::read(path)?;
    let path = || path.to_owned();
    if trace.end.is_none() {
        return Err(MintError::NoEnd { path: path() });
    }
    let (recorded, this) = (trace.header.sim_version, sim_version(trace.header.profile));
    if added || recorded == this {
        let verdict = Box::new(verify_trace(&trace));
        if !verdict.is_exact() {
            return Err(match added {
                true => MintError::NotExact {
                    path: path(),
                    verdict,
                },
                false => MintError::SameVersion {
                    path: path(),
                    version: this,
                    verdict,
                },
            });
        }
    }
    let executed = Reexecution::run(&trace).map_err(|verdict| MintError::NotExecutable {
        path: path(),
        verdict: Box::new(verdict),
    })?;
    let new = workshop.join("new").join(&name);
    make_parent(&new)?;
    write_lean(&new, &trace, &executed)?;

    let target = corpus.join(&name);
    if recorded != this {
        let kept = corpus.join(format!("v{recorded}")).join(&name);
        let copy = workshop.join("old").join(&name);
        if kept.exists() && !same_bytes(&kept, &target)? {
            return Err(MintError::Taken { path: kept });
        }
        make_parent(&copy)?;
        fs::copy(&target, &copy).map_err(failed("copy", &target))?;
        places.push((copy, kept));
    }
    let rewritten = added || !same_bytes(&target, &new)?;
    if rewritten {
        places.push((new, target));
    }
    Ok(MintedTrace {
        name,
        added,
        rewritten,
        changes: executed.compare(&trace),
    })
}

/// Writes a trace without images.
fn write_lean(path: &Path, trace: &Trace, executed: &Reexecution) -> Result<(), TraceError> {
    let mut recorder = Recorder::create(
        path,
        &executed.header,
        &trace.task,
        &trace.scene,
        Images::None,
    )?;
    recorder.start(&executed.start, None)?;
    for step in &executed.steps {
        recorder.input(step.step, &step.input)?;
        recorder.step(step, None)?;
    }
    recorder.end(&executed.end)?;
    Ok(())
}

impl Minted {
    /// How many are new.
    pub fn added(&self) -> usize {
        self.traces.iter().filter(|trace| trace.added).count()
    }

    /// Those that stood there and differ now.
    pub fn rewritten(&self) -> impl Iterator<Item = &MintedTrace> {
        self.traces
            .iter()
            .filter(|trace| trace.rewritten && !trace.added)
    }

    /// The entry in the notes: dated by the simulator's version, for a clock says
    /// nothing of what changed.
    fn note(&self, reason: &str) -> String {
        let (all, added, rewritten) = (self.traces.len(), self.added(), self.rewritten().count());
        let mut note = format!(
            "\n## simulator {}: {all} traces, {added} added, {rewritten} rewritten\n\n{reason}\n",
            self.sim_version
        );
        if rewritten > 0 {
            note.push('\n');
        }
        for trace in self.rewritten() {
            note.push_str(&format!(
                "- `{}`: {}\n",
                trace.name.display(),
                trace.changes
            ));
        }
        note
    }
}

fn same_bytes(a: &Path, b: &Path) -> Result<bool, MintError> {
    let read = |path: &Path| fs::read(path).map_err(failed("read", path));
    Ok(read(a)? == read(b)?)
}

fn make_parent(path: &Path) -> Result<(), MintError> {
    let parent = path.parent().expect("it lies in the corpus");
    fs::create_dir_all(parent).map_err(failed("make", parent))
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> MintError {
    let path = path.to_owned();
    move |source| MintError::Io {
        action,
        path,
        source,
    }
}
