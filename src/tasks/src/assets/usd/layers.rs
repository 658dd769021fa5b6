//! The layers of a stage: files of one folder and of packages in it, each checked before the
//! library sees it. Names are paths within the folder; nothing outside of it has one.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    io::{self, Cursor},
    rc::Rc,
    sync::mpsc::{Receiver, Sender},
    time::SystemTime,
};

use openusd::ar::{Asset, ResolvedPath, Resolver, split_package_relative_path_outer};

use super::{crate_check, package};
use crate::assets::{MeshError, limits::USD_DEPTH_MAX};

/// What the names of layers start with, so that they differ from what a file may write.
pub(super) const FOLDER: &str = "folder:";
/// What the name of something outside of the folder starts with; nothing of that name opens.
pub(super) const OUTSIDE: &str = "outside:";

/// Asks for files of the folder from the thread of the reader.
pub struct FileRequests {
    /// A name, or that there are no more.
    pub(super) ask: Sender<Option<String>>,
    pub(super) answers: Receiver<Result<Vec<u8>, MeshError>>,
}

impl FileRequests {
    fn read(&self, name: &str) -> Result<Vec<u8>, MeshError> {
        let gone = || MeshError::Missing {
            file: name.to_owned(),
            why: "its folder is gone".to_owned(),
        };
        self.ask.send(Some(name.to_owned())).map_err(|_| gone())?;
        self.answers.recv().map_err(|_| gone())?
    }
}

/// The files that a stage has asked for.
pub struct Layers {
    requests: FileRequests,
    /// By path within the folder.
    files: RefCell<BTreeMap<String, Known>>,
    /// Why something does not open, by its path or by what a layer calls it.
    refusals: RefCell<BTreeMap<String, String>>,
    bytes: Cell<u64>,
    bytes_max: u64,
}

/// What is known of a file.
#[derive(Clone)]
enum Known {
    /// The first layer and packages, which are read from more than once.
    Bytes(Rc<Vec<u8>>),
    /// It is sound, and read again by who opens it: the library has a copy of its own.
    Checked,
    Refused,
}

impl Layers {
    pub(super) fn new(requests: FileRequests, bytes_max: u64) -> Rc<Self> {
        Rc::new(Self {
            requests,
            files: RefCell::default(),
            refusals: RefCell::default(),
            bytes: Cell::default(),
            bytes_max,
        })
    }

    /// Opens the first layer, whose bytes may be known; its name for the stage.
    pub(super) fn root(&self, name: &str, bytes: Option<Vec<u8>>) -> Result<String, MeshError> {
        let bytes = match bytes {
            Some(bytes) => bytes,
            None => self.requests.read(name)?,
        };
        let bytes = self.keep(name, Ok(bytes))?;
        let mut files = self.files.borrow_mut();
        files.insert(name.to_owned(), Known::Bytes(bytes));
        drop(files);
        self.located(name)
    }

    /// Why a layer of that name does not open, if it was asked for.
    pub(super) fn refusal(&self, name: &str) -> Option<String> {
        let refusals = self.refusals.borrow();
        let own = name.trim_start_matches(FOLDER).trim_start_matches(OUTSIDE);
        let same = |known: &&String| {
            let plain = own.trim_start_matches("./");
            *known == own || known.ends_with(&format!("/{plain}")) || *known == plain
        };
        let known = refusals.keys().find(same)?;
        refusals.get(known).cloned()
    }

    /// The bytes of what [`Resolver::resolve`] named.
    pub(super) fn file(&self, located: &str) -> Result<Vec<u8>, MeshError> {
        let path = located.strip_prefix(FOLDER).unwrap_or(located);
        match split_package_relative_path_outer(path) {
            Some((outer, inner)) => package::file(&self.whole(&outer)?, &inner).map(<[u8]>::to_vec),
            None => self.whole(path).map(|bytes| bytes.to_vec()),
        }
    }

    /// A file of the folder, checked.
    fn whole(&self, path: &str) -> Result<Rc<Vec<u8>>, MeshError> {
        let known = self.files.borrow().get(path).cloned();
        match known {
            Some(Known::Bytes(bytes)) => Ok(bytes),
            Some(Known::Refused) => Err(MeshError::Broken(
                self.refusal(path).unwrap_or_else(|| "it is refused".into()),
            )),
            Some(Known::Checked) | None => self.keep(path, self.requests.read(path)),
        }
    }

    fn keep(&self, path: &str, read: Result<Vec<u8>, MeshError>) -> Result<Rc<Vec<u8>>, MeshError> {
        let checked = read.and_then(|bytes| {
            let is_new = !self.files.borrow().contains_key(path);
            let own = if is_new { bytes.len() as u64 } else { 0 };
            let total = self.bytes.get().saturating_add(own);
            if total > self.bytes_max {
                return Err(MeshError::too_large(
                    "bytes, with the files that it names",
                    total as usize,
                    self.bytes_max as usize,
                    "export it with fewer triangles or smaller images",
                ));
            }
            check(path, &bytes)?;
            self.bytes.set(total);
            Ok(Rc::new(bytes))
        });
        let kept = match &checked {
            Ok(bytes) if is_package(path) => Known::Bytes(Rc::clone(bytes)),
            Ok(_) => Known::Checked,
            Err(_) => Known::Refused,
        };
        self.files.borrow_mut().insert(path.to_owned(), kept);
        self.refused(path, checked)
    }

    fn refused<T>(&self, path: &str, result: Result<T, MeshError>) -> Result<T, MeshError> {
        if let Err(reason) = &result {
            let mut refusals = self.refusals.borrow_mut();
            refusals
                .entry(path.to_owned())
                .or_insert_with(|| reason.to_string());
        }
        result
    }

    /// The name that a path of the folder opens by: of a package its first layer.
    fn located(&self, path: &str) -> Result<String, MeshError> {
        let found = match split_package_relative_path_outer(path) {
            Some((outer, inner)) => {
                let bytes = self.whole(&outer)?;
                package::file(&bytes, &inner).and_then(|bytes| check(&inner, bytes))?;
                path.to_owned()
            }
            None if is_package(path) => {
                let inner = package::first_layer(&self.whole(path)?)?;
                return self.located(&format!("{path}[{inner}]"));
            }
            None => {
                if !matches!(self.files.borrow().get(path), Some(Known::Checked)) {
                    self.whole(path)?;
                }
                path.to_owned()
            }
        };
        Ok(format!("{FOLDER}{found}"))
    }
}

/// Finds layers for the library.
pub(super) struct FolderResolver(pub(super) Rc<Layers>);

impl Resolver for FolderResolver {
    fn create_identifier(&self, asset_path: &str, anchor: Option<&ResolvedPath>) -> String {
        if asset_path.is_empty() || asset_path.starts_with(FOLDER) {
            return asset_path.to_owned();
        }
        let anchor = anchor.map(|anchor| anchor.to_string_lossy().into_owned());
        let anchor = anchor.as_deref().unwrap_or_default();
        let anchor = anchor.strip_prefix(FOLDER).unwrap_or(anchor);
        match joined(anchor, asset_path) {
            Some(path) => format!("{FOLDER}{path}"),
            None => {
                let file = asset_path.chars().take(200).collect();
                drop(
                    self.0
                        .refused::<()>(asset_path, Err(MeshError::Outside { file })),
                );
                format!("{OUTSIDE}{asset_path}")
            }
        }
    }

    fn resolve(&self, asset_path: &str) -> Option<ResolvedPath> {
        let path = asset_path.strip_prefix(FOLDER)?;
        // A name that a file made up may start so, too.
        let path = joined("", path)?;
        let located = self.0.located(&path);
        self.0.refused(&path, located).ok().map(ResolvedPath::new)
    }

    fn resolve_for_new_asset(&self, _: &str) -> Option<ResolvedPath> {
        None
    }

    fn open_asset(&self, path: &ResolvedPath) -> io::Result<Box<dyn Asset>> {
        let bytes = self.0.file(&path.to_string_lossy());
        Ok(Box::new(Cursor::new(bytes.map_err(io::Error::other)?)))
    }

    fn get_modification_timestamp(&self, _: &str, _: &ResolvedPath) -> Option<SystemTime> {
        None
    }

    fn identity(&self) -> String {
        FOLDER.to_owned()
    }
}

/// What a layer calls a file, as a path within the folder or within a package of it; `None` where
/// it leaves the folder.
fn joined(anchor: &str, name: &str) -> Option<String> {
    if let Some((outer, inner)) = split_package_relative_path_outer(name) {
        let outer = joined(anchor, &outer).filter(|outer| !outer.contains('['))?;
        return Some(format!("{outer}[{}]", plain("", &inner)?));
    }
    let directory = |path: &str| {
        let above = path.rsplit_once('/');
        above.map_or_else(String::new, |(above, _)| above.to_owned())
    };
    match split_package_relative_path_outer(anchor) {
        Some((outer, inner)) => Some(format!("{outer}[{}]", plain(&directory(&inner), name)?)),
        None => plain(&directory(anchor), name),
    }
}

/// A path without `.` and `..`, from a folder; `None` where it leads above, or is none.
fn plain(directory: &str, name: &str) -> Option<String> {
    if name.starts_with('/') || name.contains([':', '\\', '\0', '[', ']']) {
        return None;
    }
    let mut parts: Vec<&str> = directory
        .split('/')
        .filter(|part| !part.is_empty())
        .collect();
    for part in name.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()?),
            part => parts.push(part),
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

fn is_package(path: &str) -> bool {
    path.to_ascii_lowercase().ends_with(".usdz")
}

/// Checks a layer, by its bytes; other files pass.
fn check(path: &str, bytes: &[u8]) -> Result<(), MeshError> {
    let ending = path.rsplit('.').next().unwrap_or_default();
    if !ending.to_ascii_lowercase().starts_with("usd") || is_package(path) {
        return Ok(());
    }
    if bytes.starts_with(openusd::usdc::MAGIC) {
        return crate_check::check(bytes)
            .map_err(|problem| MeshError::Broken(format!("no sound usdc layer ({problem})")));
    }
    match too_deep(bytes) {
        Some(line) => Err(MeshError::Line {
            line,
            problem: format!("brackets nest deeper than {USD_DEPTH_MAX}"),
        }),
        None => Ok(()),
    }
}

/// The line where brackets nest too deep in a text layer; its parser would recurse as deep.
fn too_deep(bytes: &[u8]) -> Option<usize> {
    let (mut depth, mut line) = (0_usize, 1);
    for byte in bytes {
        match byte {
            b'\n' => line += 1,
            b'{' | b'[' | b'(' => depth += 1,
            b'}' | b']' | b')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        // A prim and what is in it count as two.
        if depth > 2 * USD_DEPTH_MAX {
            return Some(line);
        }
    }
    None
}
