//! The files of an `eval_output` tree: which folders are episodes, and what lies in one. Owns every
//! file name and the limits of what is read. Reads step by step up to the first that cannot be
//! read; knows no meaning of fields.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use reel_world::Frame;
use serde_json::{Map, Value};

use crate::{
    ImportError, ImportLoss,
    eval_client::{DEBUG_TEXT, replay::BROKEN_OFF},
    image,
    response::Raw,
};

/// Deepest folder under the one given; the published layout has `<scene>/<task>/<model>`.
const FOLDERS_MAX: usize = 8;
/// Largest file; real ones are images of some 500 kB.
const BYTES_MAX: u64 = 64 * 1024 * 1024;
/// Most steps of an episode.
const STEPS_MAX: u32 = 10_000;

const META: &str = "task_meta.json";
const SUMMARY: &str = "episode_summary.json";
const CALL: &str = "tool_call.json";
const DEBUG: &str = "debug_info.json";
const TEXT: &str = "textual_observation.txt";
const INFERENCE_ERROR: &str = "inference_error.txt";

/// What lies in the folder of an episode.
pub(crate) struct Files {
    pub folder: PathBuf,
    /// `task_meta.json`; empty where it is missing.
    pub meta: Map<String, Value>,
    /// Content of `episode_summary.json`; `None` if it is missing or unreadable.
    pub summary: Option<Map<String, Value>>,
    /// Whole steps, in order.
    pub steps: Vec<StepFiles>,
    /// What the folder shows after the last whole step.
    pub after: After,
    pub losses: Vec<ImportLoss>,
    pub notes: Vec<String>,
}

/// What follows the last whole step.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum After {
    /// Nothing follows the last whole step.
    Nothing,
    /// The agent or the tool failed; the decision is not in the files.
    Fault,
    /// The recording that the files were written from ends there: nothing failed.
    BrokenOff,
    /// A step that has begun and is not in the files.
    Begun,
    /// A step that cannot be read.
    Unreadable,
}

/// What lies in the folder of a step.
pub(crate) struct StepFiles {
    /// Content of `tool_call.json`: the tool's name and its arguments.
    pub call: Map<String, Value>,
    pub raw: Option<Raw>,
    /// Content of `inference_time.json`; empty if it is missing or unreadable.
    pub time: Map<String, Value>,
    /// `textual_observation.txt`; none where the result was an image alone.
    pub text: Option<String>,
    /// `debug_info.json`; empty where it is missing.
    pub debug_info: Map<String, Value>,
    pub image: Option<Frame>,
    /// Whether the tool failed after the call was written down.
    pub failed: bool,
}

/// Folders of episodes under `root` (itself included), sorted by path.
pub(crate) fn episodes(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    find(root, 0, &mut found)?;
    if found.is_empty() {
        return Err(ImportError::NoEpisode {
            root: root.to_owned(),
        });
    }
    found.sort();
    Ok(found)
}

/// Reads the folder of an episode.
pub(crate) fn read(folder: &Path) -> Result<Files, ImportError> {
    let entries = list(folder)?;
    let mut files = Files {
        folder: folder.to_owned(),
        meta: Map::new(),
        summary: None,
        steps: Vec::new(),
        after: After::Nothing,
        losses: Vec::new(),
        notes: Vec::new(),
    };
    files.meta = files
        .about(META, "it is taken as missing")
        .unwrap_or_default();
    files.summary = files.about(SUMMARY, "how the episode ended follows from its steps");
    let numbered: BTreeMap<u32, &PathBuf> = entries
        .iter()
        .filter_map(|path| Some((step_number(path)?, path)))
        .collect();
    for (expected, (number, path)) in (0..).zip(&numbered) {
        if *number != expected {
            files.break_off(
                folder.join(format!("step_{expected:03}")),
                format!("it is missing, but there is a step {number}"),
            );
            break;
        }
        match files.step(path)? {
            Ok(step) => {
                let failed = step.failed;
                files.steps.push(step);
                if failed {
                    files.after = After::Fault;
                    break;
                }
            }
            Err(after) => {
                files.after = after;
                break;
            }
        }
    }
    Ok(files)
}

impl Files {
    /// The name of the folder so many levels up; none for a path that does not say.
    pub(crate) fn folder_name(&self, levels: usize) -> Option<String> {
        let absolute = std::path::absolute(&self.folder).ok()?;
        Some(
            absolute
                .ancestors()
                .nth(levels)?
                .file_name()?
                .to_string_lossy()
                .into_owned(),
        )
    }

    pub(crate) fn lose(&mut self, file: PathBuf, what: String) {
        self.losses.push(ImportLoss {
            file,
            message: what,
        });
    }

    /// A file about the whole episode.
    fn about(&mut self, name: &str, otherwise: &str) -> Option<Map<String, Value>> {
        let path = self.folder.join(name);
        object(&path).unwrap_or_else(|error| {
            self.lose(path, format!("{error}; {otherwise}"));
            None
        })
    }

    fn break_off(&mut self, file: PathBuf, what: String) {
        self.lose(file, format!("{what}; the steps before it are imported"));
        self.after = After::Unreadable;
    }

    /// Reads a step, or says what stands in its place.
    fn step(&mut self, folder: &Path) -> Result<Result<StepFiles, After>, ImportError> {
        let entries = list(folder)?;
        let has = |name: &str| {
            entries
                .iter()
                .any(|path| path.file_name().is_some_and(|found| found == name))
        };
        let failed = has("action_error.txt");
        let call = match object(&folder.join(CALL)) {
            Ok(Some(call)) => call,
            Ok(None) if failed => return Ok(Err(After::Fault)),
            Ok(None) if has(INFERENCE_ERROR) => {
                let why = self.text(&folder.join(INFERENCE_ERROR));
                let broken_off = why.as_deref() == Some(BROKEN_OFF);
                return Ok(Err(if broken_off {
                    After::BrokenOff
                } else {
                    After::Fault
                }));
            }
            Ok(None) => return Ok(Err(After::Begun)),
            Err(error) => {
                self.break_off(folder.join(CALL), error);
                return Ok(Err(After::Unreadable));
            }
        };
        let mut text = self.text(&folder.join(TEXT));
        let told = text.as_mut().and_then(cut_debug_info);
        let debug_info = match object(&folder.join(DEBUG)) {
            Ok(debug_info) => debug_info.or(told).unwrap_or_default(),
            Err(error) => {
                self.break_off(folder.join(DEBUG), error);
                return Ok(Err(After::Unreadable));
            }
        };
        let time = object(&folder.join("inference_time.json")).unwrap_or_else(|error| {
            self.lose(
                folder.join("inference_time.json"),
                format!("{error}; the latency is lost"),
            );
            None
        });
        let raw = match self.text(&folder.join("raw_response.txt")) {
            Some(text) => Some(Raw::Text(text)),
            None => self
                .text(&folder.join("raw_response.json"))
                .map(|text| self.raw_json(folder, text)),
        };
        let frame = self.frame(&entries);
        if text.is_none() && frame.is_none() && !failed {
            self.notes.push(format!(
                "{}: neither text nor image says what the call came to",
                name_of(folder)
            ));
        }
        // A raw debug payload that the client could not read.
        let debug_info = match debug_info
            .get("raw")
            .and_then(Value::as_str)
            .map(serde_json::from_str)
        {
            Some(Ok(Value::Object(parsed))) => parsed,
            _ => debug_info,
        };
        Ok(Ok(StepFiles {
            call,
            raw,
            time: time.unwrap_or_default(),
            text,
            debug_info,
            image: frame,
            failed,
        }))
    }

    fn raw_json(&mut self, folder: &Path, text: String) -> Raw {
        if let Err(error) = serde_json::from_str::<serde::de::IgnoredAny>(&text) {
            let what = format!(
                "it is not JSON ({error}); it is kept unchanged, and nothing is read from it"
            );
            self.lose(folder.join("raw_response.json"), what);
        }
        Raw::Json(text)
    }

    /// A text file; bytes that are no UTF-8 are replaced and named.
    fn text(&mut self, path: &Path) -> Option<String> {
        match bytes(path) {
            Ok(bytes) => Some(String::from_utf8(bytes?).unwrap_or_else(|error| {
                let at = error.utf8_error().valid_up_to();
                self.lose(
                    path.to_owned(),
                    format!("it is not UTF-8 from byte {at} on; invalid bytes were replaced"),
                );
                String::from_utf8_lossy(error.as_bytes()).into_owned()
            })),
            Err(error) => {
                self.lose(path.to_owned(), format!("{error}; it is taken as missing"));
                None
            }
        }
    }

    /// The last image of a step: there is one a result, and room for one.
    fn frame(&mut self, entries: &[PathBuf]) -> Option<Frame> {
        let mut frames: Vec<(u32, &PathBuf)> = entries
            .iter()
            .filter_map(|path| Some((frame_number(path)?, path)))
            .collect();
        frames.sort();
        let (_, path) = frames.last()?;
        if frames.len() > 1 {
            let folder = path.parent().map(name_of).unwrap_or_default();
            self.notes.push(format!(
                "{folder}: of {} images the last is kept",
                frames.len()
            ));
        }
        let read =
            bytes(path).and_then(|bytes| bytes.map(|bytes| image::decode(&bytes)).transpose());
        read.unwrap_or_else(|error| {
            self.lose((*path).clone(), format!("{error}; the step has no image"));
            None
        })
    }
}

fn find(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), ImportError> {
    let entries = list(folder)?;
    let named = |path: &PathBuf| {
        path.file_name()
            .is_some_and(|name| name == META || name == SUMMARY)
    };
    if entries
        .iter()
        .any(|path| named(path) || step_number(path).is_some())
    {
        found.push(folder.to_owned());
        return Ok(());
    }
    // Links are not followed: they may lead back.
    let is_folder =
        |path: &&PathBuf| fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_dir());
    for path in entries
        .iter()
        .filter(is_folder)
        .filter(|_| depth < FOLDERS_MAX)
    {
        find(path, depth + 1, found)?;
    }
    Ok(())
}

/// What lies in a folder, sorted.
pub(crate) fn list(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let listed = fs::read_dir(folder).and_then(|entries| {
        entries
            .map(|entry| Ok(entry?.path()))
            .collect::<io::Result<Vec<_>>>()
    });
    let mut paths = listed.map_err(|source| ImportError::List {
        path: folder.to_owned(),
        source,
    })?;
    paths.sort();
    Ok(paths)
}

/// The files in a folder and in those below it that belong, sorted; or the file itself, if it is one. Links to folders
/// are not followed.
pub(crate) fn files_below(
    root: &Path,
    belongs: impl Fn(&Path) -> bool,
) -> Result<Vec<PathBuf>, ImportError> {
    if root.is_file() {
        return Ok(vec![root.to_owned()]);
    }
    let (mut found, mut open) = (Vec::new(), vec![root.to_owned()]);
    while let Some(folder) = open.pop() {
        for path in list(&folder)? {
            if path.is_dir() && !path.is_symlink() {
                open.push(path);
            } else if path.is_file() && belongs(&path) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

/// Number in the name of a step's folder: `step_007` is 7; `None` for anything else.
fn step_number(path: &Path) -> Option<u32> {
    let digits = path.file_name()?.to_str()?.strip_prefix("step_")?;
    let number = digits
        .bytes()
        .all(|byte| byte.is_ascii_digit())
        .then(|| digits.parse().ok())
        .flatten()?;
    (number < STEPS_MAX && path.is_dir()).then_some(number)
}

/// `image_observation_1.png` is 1; older agents wrote `image_observation.png` and
/// `obs_image_1.png`.
fn frame_number(path: &Path) -> Option<u32> {
    let stem = path.file_name()?.to_str()?.strip_suffix(".png")?;
    let rest = stem
        .strip_prefix("image_observation")
        .or_else(|| stem.strip_prefix("obs_image"))?;
    if rest.is_empty() {
        Some(0)
    } else {
        rest.strip_prefix('_')?.parse().ok()
    }
}

/// Takes the debug payload off the end of a text, if it stands there.
pub fn cut_debug_info(text: &mut String) -> Option<Map<String, Value>> {
    let at = text.rfind(DEBUG_TEXT)?;
    let Ok(Value::Object(debug_info)) = serde_json::from_str(&text[at + DEBUG_TEXT.len()..]) else {
        return None;
    };
    text.truncate(at);
    text.truncate(text.trim_end().len());
    Some(debug_info)
}

/// A JSON object; none where there is no such file.
fn object(path: &Path) -> Result<Option<Map<String, Value>>, String> {
    let Some(bytes) = bytes(path)? else {
        return Ok(None);
    };
    serde_json::from_slice(&bytes)
        .map(Some)
        .map_err(|error| format!("it is not the JSON object it should be ({error})"))
}

/// The bytes of a file; none where there is none.
fn bytes(path: &Path) -> Result<Option<Vec<u8>>, String> {
    let refused = |error: io::Error| format!("it cannot be read ({error})");
    match fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => {}
        Ok(_) => return Err("it is no file".to_owned()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(refused(error)),
    }
    let mut bytes = Vec::new();
    File::open(path)
        .map_err(refused)?
        .take(BYTES_MAX + 1)
        .read_to_end(&mut bytes)
        .map_err(refused)?;
    if bytes.len() as u64 > BYTES_MAX {
        return Err(format!("it has more than {BYTES_MAX} bytes"));
    }
    Ok(Some(bytes))
}

fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}
