//! The disk as an argument: what recording, restoring and keeping traces ask of it. Programs use
//! the one of this machine; a test of faults brings its own. Never what is in a file.

use std::{
    fmt,
    fs::{self, File, TryLockError},
    io::{self, Read, Seek, Write},
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use crate::FileMetadata;

/// A disk that traces are written to and read from.
pub trait Disk: fmt::Debug + Send + Sync {
    /// Makes a file that is not there yet, and opens it for writing.
    ///
    /// # Errors
    /// As the system says; [`io::ErrorKind::AlreadyExists`] where there is one.
    fn create_new(&self, path: &Path) -> io::Result<Box<dyn DiskFile>>;

    /// Opens a file for reading.
    ///
    /// # Errors
    /// As the system says.
    fn open(&self, path: &Path) -> io::Result<Box<dyn DiskFile>>;

    /// Size and time of a file.
    ///
    /// # Errors
    /// As the system says.
    fn metadata(&self, path: &Path) -> io::Result<FileMetadata>;

    /// Gives a file another name, in place of whatever has it.
    ///
    /// # Errors
    /// As the system says.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Gives a file another name, which nothing has.
    ///
    /// # Errors
    /// As the system says; [`io::ErrorKind::AlreadyExists`] where something has the name.
    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a name, and the file with its last one.
    ///
    /// # Errors
    /// As the system says.
    fn remove_file(&self, path: &Path) -> io::Result<()>;

    /// Makes a folder, and those it lies in, where they are not there.
    ///
    /// # Errors
    /// As the system says.
    fn create_dir_all(&self, folder: &Path) -> io::Result<()>;

    /// The paths of what is in a folder, in no order.
    ///
    /// # Errors
    /// As the system says.
    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>>;

    /// Makes the names in a folder survive the loss of power.
    ///
    /// # Errors
    /// As the system says.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;

    /// The one absolute path of a file or folder.
    ///
    /// # Errors
    /// As the system says.
    fn canonicalize(&self, path: &Path) -> io::Result<PathBuf>;

    /// Whether there is something of this name.
    ///
    /// # Errors
    /// As the system says, where it cannot be known.
    fn exists(&self, path: &Path) -> io::Result<bool> {
        match self.metadata(path) {
            Ok(_) => Ok(true),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Whether there is a regular file of this name: no folder, and no pipe that nobody writes to.
    fn is_file(&self, path: &Path) -> bool {
        self.metadata(path).is_ok()
    }
}

/// An open file of a [`Disk`].
pub trait DiskFile: Read + Write + Seek + Send + Sync {
    /// Makes what was written survive the loss of power.
    ///
    /// # Errors
    /// As the system says.
    fn sync(&self) -> io::Result<()>;

    /// Size of the file in bytes.
    ///
    /// # Errors
    /// As the system says.
    fn size(&self) -> io::Result<u64>;

    /// Keeps others from locking the file while this is open.
    ///
    /// # Errors
    /// [`TryLockError::WouldBlock`] where somebody else has; any other where there are no locks.
    fn try_lock(&self) -> Result<(), TryLockError>;

    /// The same open file once more.
    ///
    /// # Errors
    /// As the system says.
    fn try_clone(&self) -> io::Result<Box<dyn DiskFile>>;
}

/// The disk of this machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct LocalDisk;

impl Disk for LocalDisk {
    fn create_new(&self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(File::create_new(path)?))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(File::open(path)?))
    }

    fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        let found = fs::metadata(path)?;
        let since = found
            .modified()
            .ok()
            .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let modified_ns = since
            .and_then(|since| i64::try_from(since.as_nanos()).ok())
            .unwrap_or(0);
        Ok(FileMetadata {
            bytes: found.len(),
            modified_ns,
        })
    }

    fn is_file(&self, path: &Path) -> bool {
        path.is_file()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn rename_new(&self, from: &Path, to: &Path) -> io::Result<()> {
        match fs::hard_link(from, to) {
            Ok(()) => {
                // The file has its name. Its old one is the caller's to remove where this fails.
                let _ = fs::remove_file(from);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
            // Some file systems have no hard links. There an empty file takes the name first:
            // looking and then renaming would replace what came between.
            Err(_) => {
                File::create_new(to)?;
                fs::rename(from, to).inspect_err(|_| drop(fs::remove_file(to)))
            }
        }
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn create_dir_all(&self, folder: &Path) -> io::Result<()> {
        fs::create_dir_all(folder)
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        fs::read_dir(folder)?
            .map(|entry| entry.map(|entry| entry.path()))
            .collect()
    }

    fn canonicalize(&self, path: &Path) -> io::Result<PathBuf> {
        path.canonicalize()
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        // Only Unix can open a folder to do so.
        if cfg!(unix) {
            let folder = if folder.as_os_str().is_empty() {
                Path::new(".")
            } else {
                folder
            };
            File::open(folder)?.sync_all()?;
        }
        Ok(())
    }
}

impl DiskFile for File {
    fn sync(&self) -> io::Result<()> {
        self.sync_data()
    }

    fn size(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn try_lock(&self) -> Result<(), TryLockError> {
        File::try_lock(self)
    }

    fn try_clone(&self) -> io::Result<Box<dyn DiskFile>> {
        Ok(Box::new(File::try_clone(self)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_name_replaces_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [from, to] = ["from", "to"].map(|name| folder.path().join(name));
        fs::write(&from, "mine").unwrap();
        fs::write(&to, "theirs").unwrap();
        let refused = LocalDisk.rename_new(&from, &to).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::AlreadyExists);
        let read = |path| fs::read_to_string(path).unwrap();
        assert_eq!((read(&from), read(&to)), ("mine".into(), "theirs".into()));
        fs::remove_file(&to).unwrap();
        LocalDisk.rename_new(&from, &to).unwrap();
        assert_eq!(read(&to), "mine");
        assert!(!LocalDisk.exists(&from).unwrap());
    }

    #[test]
    fn a_folder_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        assert!(LocalDisk.exists(folder.path()).unwrap() && !LocalDisk.is_file(folder.path()));
        LocalDisk.sync_folder(Path::new("")).unwrap();
    }
}
