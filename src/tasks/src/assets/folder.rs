//! A folder of assets: finds the file of an asset, reads it once, and opens nothing outside of it.

use std::{
    collections::{BTreeMap, btree_map::Entry},
    fs::{self, File},
    io::{self, Read as _},
    path::{Component, Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use reel_world::{AssetId, Assets, Mesh};
use serde::Serialize;

use crate::assets::{
    MeshError, MeshFormat, SiblingFiles, Survey, limits::FILE_BYTES_MAX, parse_file,
};

/// A folder of meshes, each file named by its asset. Only the folder itself is looked into, not
/// what lies in folders below.
#[derive(Debug)]
pub struct AssetFolder {
    /// Canonical path of the folder, with symbolic links resolved.
    path: PathBuf,
    files: BTreeMap<AssetId, (MeshFormat, PathBuf)>,
    /// Files of assets that another kind of file comes first for.
    hidden: Vec<PathBuf>,
    read: Mutex<BTreeMap<AssetId, Read>>,
}

/// What came of reading a file.
type Read = Result<Arc<Mesh>, Arc<MeshError>>;

/// A file of a folder, and what is to say of it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct FileReport {
    /// Name of the file within the folder, with its extension.
    pub file: String,
    /// The asset it shows.
    pub asset: String,
    /// Whether it is a mesh.
    #[serde(flatten)]
    pub verdict: MeshVerdict,
}

/// Whether a file is a mesh.
#[derive(Clone, PartialEq, Debug, Serialize)]
#[serde(rename_all = "snake_case", tag = "verdict")]
pub enum MeshVerdict {
    /// The file holds a valid mesh, with these properties.
    Loads(Survey),
    /// The file does not hold a valid mesh.
    Refused {
        /// Why the file failed to load, as a message for people.
        reason: String,
    },
    /// Another file of the same asset comes first.
    Hidden {
        /// Name of the file that is loaded for this asset instead.
        by: String,
    },
}

impl AssetFolder {
    /// Lists a folder.
    ///
    /// # Errors
    /// When it cannot be listed.
    pub fn open(path: &Path) -> io::Result<Self> {
        let path = path.canonicalize()?;
        let mut found = Vec::new();
        for entry in fs::read_dir(&path)? {
            let file = entry?.path();
            let kind = file
                .extension()
                .and_then(|extension| MeshFormat::of(extension.to_str()?));
            let stem = file.file_stem().and_then(|stem| stem.to_str());
            if let (Some(kind), Some(stem)) = (kind, stem) {
                found.push((AssetId::from(stem), kind, file));
            }
        }
        found.sort();
        let (mut files, mut hidden) = (BTreeMap::new(), Vec::new());
        for (asset, kind, file) in found {
            match files.entry(asset) {
                Entry::Vacant(first) => drop(first.insert((kind, file))),
                Entry::Occupied(_) => hidden.push(file),
            }
        }
        Ok(Self {
            path,
            files,
            hidden,
            read: Mutex::default(),
        })
    }

    /// How many assets there are files of.
    pub fn len(&self) -> usize {
        self.files.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// The mesh of an asset; nothing where there is no file of it.
    ///
    /// # Errors
    /// Why its file is refused.
    pub fn load(&self, asset: &AssetId) -> Result<Option<Arc<Mesh>>, Arc<MeshError>> {
        let Some((kind, file)) = self.files.get(asset) else {
            return Ok(None);
        };
        let known = || self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(read) = known().get(asset) {
            return read.clone().map(Some);
        }
        // Others need not wait meanwhile; who reads the same at the same time gets the same.
        let read: Read = self.read_file(*kind, file).map(Arc::new).map_err(Arc::new);
        known().insert(asset.clone(), read.clone());
        read.map(Some)
    }

    /// Reads every file, and says what it is; in the order of their names. Keeps none.
    pub fn check(&self) -> Vec<FileReport> {
        let name = |file: &Path| {
            file.file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned()
        };
        let read = |(asset, (kind, file)): (&AssetId, &(MeshFormat, PathBuf))| {
            let verdict = match self.read_file(*kind, file) {
                Ok(mesh) => MeshVerdict::Loads(Survey::of(&mesh)),
                Err(reason) => MeshVerdict::Refused {
                    reason: reason.to_string(),
                },
            };
            FileReport {
                file: name(file),
                asset: asset.to_string(),
                verdict,
            }
        };
        let mut listed: Vec<FileReport> = self.files.iter().map(read).collect();
        listed.extend(self.hidden.iter().map(|file| {
            let asset = file
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            let by = self
                .files
                .get(asset.as_str())
                .map_or_else(String::new, |(_, file)| name(file));
            FileReport {
                file: name(file),
                asset,
                verdict: MeshVerdict::Hidden { by },
            }
        }));
        listed.sort_by(|a, b| a.file.cmp(&b.file));
        listed
    }

    fn read_file(&self, kind: MeshFormat, file: &Path) -> Result<Mesh, MeshError> {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        parse_file(kind, &name, &self.bytes(&name)?, self)
    }

    /// The bytes of a file, which may lie in a folder below.
    fn bytes(&self, name: &str) -> Result<Vec<u8>, MeshError> {
        let outside = || MeshError::Outside {
            file: name.chars().take(200).collect(),
        };
        let relative = Path::new(name);
        // A URI of the web and a drive of Windows are relative paths here, but meant otherwise.
        let below = relative
            .components()
            .all(|component| matches!(component, Component::Normal(_) | Component::CurDir));
        if !below || name.is_empty() || name.contains([':', '\\', '\0']) {
            return Err(outside());
        }
        let missing = |error: io::Error| MeshError::Missing {
            file: name.to_owned(),
            why: error.to_string(),
        };
        let path = self.path.join(relative).canonicalize().map_err(missing)?;
        if !path.starts_with(&self.path) {
            return Err(outside());
        }
        // Asked before it is opened: opening a pipe would wait.
        let metadata = fs::metadata(&path).map_err(missing)?;
        if !metadata.is_file() {
            return Err(MeshError::Missing {
                file: name.to_owned(),
                why: "it is no file".to_owned(),
            });
        }
        // It may grow while it is read.
        let mut bytes = Vec::new();
        File::open(&path)
            .map_err(missing)?
            .take(FILE_BYTES_MAX + 1)
            .read_to_end(&mut bytes)
            .map_err(missing)?;
        match bytes.len() as u64 > FILE_BYTES_MAX {
            true => {
                let found = metadata.len().max(FILE_BYTES_MAX + 1) as usize;
                Err(MeshError::too_large(
                    "bytes",
                    found,
                    FILE_BYTES_MAX as usize,
                    "export it with fewer triangles or smaller images",
                ))
            }
            false => Ok(bytes),
        }
    }
}

impl SiblingFiles for AssetFolder {
    fn read(&self, name: &str) -> Result<Vec<u8>, MeshError> {
        self.bytes(name)
    }
}

impl Assets for AssetFolder {
    fn mesh(&self, asset: &AssetId) -> Option<Arc<Mesh>> {
        self.load(asset).ok().flatten()
    }
}
