//! Which files of a folder hold rows: by the ending of their names, without those that describe the
//! set. Reads no file.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::lint::LintError;

/// How names of files end that hold the provenance of rows whose loader refuses other keys.
pub(crate) const PROVENANCE: &str = ".provenance.jsonl";

/// The files below a folder, to any depth, whose names have one of these endings, sorted by path.
/// Hidden files and folders, manifests and files of provenance are left out.
///
/// # Errors
/// Fails if a folder cannot be read.
pub fn row_files(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, LintError> {
    let mut found = Vec::new();
    walk(folder, endings, &mut found)?;
    found.sort();
    Ok(found)
}

fn walk(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) -> Result<(), LintError> {
    let failed = |source| LintError::Io {
        path: folder.to_owned(),
        source,
    };
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(failed)?);
        let name = entry.file_name().to_string_lossy().into_owned();
        let describes = matches!(
            &*name,
            crate::DATASET_INFO | crate::MANIFEST | crate::TASK_LIST
        ) || name.ends_with(PROVENANCE);
        if name.starts_with('.') || describes {
            continue;
        }
        if kind.is_dir() {
            walk(&path, endings, found)?;
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
    Ok(())
}
