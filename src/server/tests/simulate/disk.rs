//! A disk that is made up: it fills, fails, ends in the middle of a write with the process that
//! uses it, and loses what was not synced when the power goes. Never fails where it was not told
//! to.

use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    fs::TryLockError,
    io::{self, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard},
};

use reel_trace::{Disk, DiskFile, FileMetadata};
use tokio::sync::Notify;

use crate::rng::SeededRng;

/// A disk that is made up.
#[derive(Clone)]
pub struct SimulatedDisk(Arc<Mutex<State>>);

/// What a disk does to the process that uses it.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiskFaults {
    /// The process dies with its so manieth operation.
    pub dies_at: Option<u64>,
    /// Bytes that there is room for.
    pub room: Option<u64>,
    /// One in so many operations fails.
    pub fails_once_in: Option<u64>,
}

struct State {
    rng: SeededRng,
    faults: DiskFaults,
    files: Vec<Content>,
    /// The file that each name means now.
    names: BTreeMap<PathBuf, usize>,
    /// The file that each name would mean after the loss of power, but for `unsynced`.
    synced: BTreeMap<PathBuf, usize>,
    /// Changes of names that no sync of the folder has put on the disk, in their order.
    unsynced: VecDeque<Renaming>,
    /// Operations of the process that runs.
    operations: u64,
    dead: bool,
    died: Arc<Notify>,
    /// All operations of all processes.
    history: blake3::Hasher,
}

#[derive(Default)]
struct Content {
    bytes: Vec<u8>,
    /// As of the last sync.
    synced: Vec<u8>,
}

/// Names, and the files that they mean from now on, if any: all of them or none.
type Renaming = Vec<(PathBuf, Option<usize>)>;

impl SimulatedDisk {
    /// A disk without files, whose accidents follow from the seed.
    pub fn new(seed: u64) -> Self {
        Self(Arc::new(Mutex::new(State {
            rng: SeededRng::new(seed, "disk"),
            faults: DiskFaults::default(),
            files: Vec::new(),
            names: BTreeMap::new(),
            synced: BTreeMap::new(),
            unsynced: VecDeque::new(),
            operations: 0,
            dead: false,
            died: Arc::default(),
            history: blake3::Hasher::new(),
        })))
    }

    /// A process begins to use it, to which it does this.
    pub fn begin(&self, faults: DiskFaults) {
        let mut state = self.lock();
        state.faults = faults;
        state.operations = 0;
        state.dead = false;
        state.died = Arc::default();
    }

    /// Nothing that the process does reaches the disk any more.
    pub fn end(&self) {
        self.lock().die();
    }

    /// Waits until the process has died of an operation.
    pub async fn died(&self) {
        let died = self.lock().died.clone();
        died.notified().await;
    }

    /// Operations of the process so far.
    pub fn operations(&self) -> u64 {
        self.lock().operations
    }

    /// The power went: what was not synced is there in part, or not at all.
    pub fn power_lost(&self) {
        let mut state = self.lock();
        let State {
            rng,
            files,
            synced,
            unsynced,
            names,
            ..
        } = &mut *state;
        let kept = rng.below(unsynced.len() as u64 + 1) as usize;
        unsynced
            .drain(..)
            .take(kept)
            .for_each(|renaming| rename(synced, renaming));
        names.clone_from(synced);
        for file in files {
            let rest = file.bytes.strip_prefix(&file.synced[..]).unwrap_or(&[]);
            let mut left = file.synced.clone();
            let more = rng.below(rest.len() as u64 + 1) as usize;
            left.extend_from_slice(&rest[..more]);
            if more > 0 && rng.once_in(2) {
                // A sector that was given to the file and never written.
                let lost = rng.below(more.min(512) as u64 + 1) as usize;
                let end = left.len();
                left[end - lost..].fill(0);
            }
            file.bytes.clone_from(&left);
            file.synced = left;
        }
    }

    /// Every file, by its name.
    pub fn files(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let state = self.lock();
        let content =
            |(path, file): (&PathBuf, &usize)| (path.clone(), state.files[*file].bytes.clone());
        state.names.iter().map(content).collect()
    }

    /// The files that a loss of power leaves as they are, by their names.
    pub fn durable_files(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let state = self.lock();
        let durable = |(path, file): (&PathBuf, &usize)| {
            let content = &state.files[*file];
            (state.synced.get(path) == Some(file) && content.synced == content.bytes)
                .then(|| (path.clone(), content.bytes.clone()))
        };
        state.names.iter().filter_map(durable).collect()
    }

    /// A digest of everything that was done to it.
    pub fn history(&self) -> blake3::Hash {
        self.lock().history.finalize()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().expect("no thread died with it")
    }

    fn operate<T>(
        &self,
        what: &str,
        path: &Path,
        operation: impl FnOnce(&mut State) -> io::Result<T>,
    ) -> io::Result<T> {
        self.lock().operate(what, path, operation)
    }
}

impl State {
    /// One operation of the process, should it live that long.
    fn operate<T>(
        &mut self,
        what: &str,
        path: &Path,
        operation: impl FnOnce(&mut State) -> io::Result<T>,
    ) -> io::Result<T> {
        let dies = self.step(what, path)?;
        // It dies before or after, and never knows.
        if dies && self.rng.once_in(2) {
            return Err(died());
        }
        let done = operation(self);
        if dies { Err(died()) } else { done }
    }

    /// Counts an operation; whether the process dies with it.
    fn step(&mut self, what: &str, path: &Path) -> io::Result<bool> {
        if self.dead {
            return Err(died());
        }
        self.operations += 1;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        // Names of uploads hold numbers of the process.
        let name = if name.ends_with(".upload") {
            "upload"
        } else {
            &*name
        };
        self.history.update(format!("{what} {name}\n").as_bytes());
        if self.faults.dies_at == Some(self.operations) {
            self.die();
            return Ok(true);
        }
        match self.faults.fails_once_in {
            Some(times) if self.rng.once_in(times) => Err(io::Error::other("input/output error")),
            _ => Ok(false),
        }
    }

    fn die(&mut self) {
        self.dead = true;
        self.died.notify_one();
    }

    fn rename(&mut self, renaming: Renaming) {
        rename(&mut self.names, renaming.clone());
        self.unsynced.push_back(renaming);
    }

    fn find(&self, path: &Path) -> io::Result<usize> {
        let found = self.names.get(path).copied();
        found.ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    /// Bytes that there is room for still.
    fn room(&self) -> u64 {
        let used = self
            .names
            .values()
            .map(|&file| self.files[file].bytes.len() as u64);
        let room = self.faults.room.unwrap_or(u64::MAX);
        room.saturating_sub(used.sum())
    }
}

fn rename(names: &mut BTreeMap<PathBuf, usize>, renaming: Renaming) {
    for (path, file) in renaming {
        match file {
            Some(file) => names.insert(path, file),
            None => names.remove(&path),
        };
    }
}

fn died() -> io::Error {
    io::Error::other("the process has died")
}

impl fmt::Debug for SimulatedDisk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SimulatedDisk")
    }
}

impl Disk for SimulatedDisk {
    fn create_new(&self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        let file = self.operate("create", path, |state| {
            if state.names.contains_key(path) {
                return Err(io::ErrorKind::AlreadyExists.into());
            }
            state.files.push(Content::default());
            let file = state.files.len() - 1;
            state.rename(vec![(path.to_owned(), Some(file))]);
            Ok(file)
        })?;
        Ok(Box::new(OpenFile::new(self, path, file)))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        let file = self.operate("open", path, |state| state.find(path))?;
        Ok(Box::new(OpenFile::new(self, path, file)))
    }

    fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        let state = self.lock();
        let file = state.find(path)?;
        Ok(FileMetadata {
            bytes: state.files[file].bytes.len() as u64,
            modified_ns: 0,
        })
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.operate("rename", to, |state| {
            let file = state.find(from)?;
            state.rename(vec![(to.to_owned(), Some(file)), (from.to_owned(), None)]);
            Ok(())
        })
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.operate("rename new", to, |state| {
            let file = state.find(from)?;
            if state.names.contains_key(to) {
                return Err(io::ErrorKind::AlreadyExists.into());
            }
            state.rename(vec![(to.to_owned(), Some(file)), (from.to_owned(), None)]);
            Ok(())
        })
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        // What is not there costs the disk nothing.
        self.lock().find(path)?;
        self.operate("remove", path, |state| {
            state.rename(vec![(path.to_owned(), None)]);
            Ok(())
        })
    }

    fn create_dir_all(&self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let state = self.lock();
        let inside = state
            .names
            .keys()
            .filter(|path| path.parent() == Some(folder));
        Ok(inside.cloned().collect())
    }

    fn canonicalize(&self, path: &Path) -> io::Result<PathBuf> {
        Ok(path.to_owned())
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.operate("sync folder", folder, |state| {
            let changes = std::mem::take(&mut state.unsynced);
            changes
                .into_iter()
                .for_each(|change| rename(&mut state.synced, change));
            Ok(())
        })
    }
}

/// A file that a process has open.
struct OpenFile {
    disk: SimulatedDisk,
    path: PathBuf,
    file: usize,
    position: u64,
}

impl OpenFile {
    fn new(disk: &SimulatedDisk, path: &Path, file: usize) -> Self {
        Self {
            disk: disk.clone(),
            path: path.to_owned(),
            file,
            position: 0,
        }
    }
}

impl Read for OpenFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let state = self.disk.lock();
        if state.dead {
            return Err(died());
        }
        let bytes = &state.files[self.file].bytes;
        let from = bytes.len().min(self.position as usize);
        let count = buffer.len().min(bytes.len() - from);
        buffer[..count].copy_from_slice(&bytes[from..from + count]);
        self.position += count as u64;
        Ok(count)
    }
}

impl Write for OpenFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.disk.lock();
        let dies = state.step("write", &self.path)?;
        let mut count = bytes
            .len()
            .min(usize::try_from(state.room()).unwrap_or(usize::MAX));
        if count == 0 && !bytes.is_empty() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        if dies || state.faults.fails_once_in.is_some() && state.rng.once_in(8) {
            count = state.rng.below(count as u64 + 1) as usize;
        }
        let content = &mut state.files[self.file].bytes;
        let (from, to) = (self.position as usize, self.position as usize + count);
        if content.len() < to {
            content.resize(to, 0);
        }
        content[from..to].copy_from_slice(&bytes[..count]);
        self.position = to as u64;
        match (dies, count) {
            (true, _) => Err(died()),
            (false, 0) if !bytes.is_empty() => Err(io::ErrorKind::Interrupted.into()),
            (false, _) => Ok(count),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for OpenFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let end = self.size()?;
        let moved = match to {
            SeekFrom::Start(to) => Some(to),
            SeekFrom::End(by) => end.checked_add_signed(by),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
        };
        self.position = moved.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}

impl DiskFile for OpenFile {
    fn sync(&self) -> io::Result<()> {
        let file = self.file;
        self.disk.operate("sync", &self.path, |state| {
            let content = &mut state.files[file];
            content.synced.clone_from(&content.bytes);
            Ok(())
        })
    }

    fn size(&self) -> io::Result<u64> {
        Ok(self.disk.lock().files[self.file].bytes.len() as u64)
    }

    /// One process at a time uses the disk: there is nobody to keep out.
    fn try_lock(&self) -> Result<(), TryLockError> {
        Err(TryLockError::Error(io::ErrorKind::Unsupported.into()))
    }

    fn try_clone(&self) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(Self {
            disk: self.disk.clone(),
            path: self.path.clone(),
            ..*self
        }))
    }
}
