//! Which files are recordings: MCAP files, and folders of rosbag2 with theirs in order. Reads
//! `metadata.yaml`; opens no bag.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use saphyr::{LoadableYamlNode, Yaml};

use crate::{ImportError, ImportLoss, layout::list};

/// Deepest folder under the one given.
const FOLDERS_MAX: usize = 8;
/// What rosbag2 writes beside its files.
const METADATA: &str = "metadata.yaml";

/// The files of one recording.
pub(crate) struct Files {
    pub paths: Vec<PathBuf>,
    pub losses: Vec<ImportLoss>,
    pub notes: Vec<String>,
}

/// Recordings at `root` or in folders below it, sorted by path.
pub(crate) fn recordings(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found = Vec::new();
    match fs::metadata(root) {
        Ok(metadata) if metadata.is_dir() => find(root, 0, &mut found)?,
        Ok(_) => found.push(root.to_owned()),
        Err(source) => {
            return Err(ImportError::List {
                path: root.to_owned(),
                source,
            });
        }
    }
    if found.is_empty() {
        return Err(ImportError::NoRecording {
            root: root.to_owned(),
        });
    }
    found.sort();
    Ok(found)
}

fn find(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) -> Result<(), ImportError> {
    let entries = list(folder)?;
    if folder.join(METADATA).is_file() || unfinished(folder, &entries).is_some() {
        found.push(folder.to_owned());
        return Ok(());
    }
    for path in entries {
        // Links to folders are not followed: they may lead back.
        let is_folder = fs::symlink_metadata(&path).is_ok_and(|metadata| metadata.is_dir());
        if is_folder && depth < FOLDERS_MAX {
            find(&path, depth + 1, found)?;
        } else if path.is_file() && (is(&path, "mcap") || refused(&path).is_some()) {
            found.push(path);
        }
    }
    Ok(())
}

/// The files of a recording, in order.
///
/// # Errors
/// When it is stored in a form that is not read.
pub(crate) fn files(recording: &Path) -> Result<Files, ImportError> {
    let refuse = |path: &Path| {
        refused(path).map(|what| ImportError::Storage {
            path: path.to_owned(),
            reason: what,
        })
    };
    let mut files = Files {
        paths: Vec::new(),
        losses: Vec::new(),
        notes: Vec::new(),
    };
    if !recording.is_dir() {
        return match refuse(recording) {
            Some(error) => Err(error),
            None => Ok(Files {
                paths: vec![recording.to_owned()],
                ..files
            }),
        };
    }
    let entries = list(recording)?;
    let metadata = recording.join(METADATA);
    let named = match fs::read_to_string(&metadata) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => {
            files.losses.push(ImportLoss {
                file: metadata,
                message: format!(
                    "it cannot be read ({error}); the order of files follows from their names"
                ),
            });
            None
        }
        Ok(text) => {
            match paths(&text) {
                Some(named) => Some(named),
                None => {
                    let message = "it names no files (relative_file_paths); their order follows from their names".to_owned();
                    files.losses.push(ImportLoss {
                        file: metadata,
                        message,
                    });
                    None
                }
            }
        }
    };
    let mut numbered = unfinished(recording, &entries).unwrap_or_default();
    let Some(named) = named else {
        if files.losses.is_empty() {
            files
                .notes
                .push(format!("there is no {METADATA}: rosbag2 did not end this recording; its files are read in their order"));
        }
        if numbered.is_empty() {
            numbered = entries
                .iter()
                .filter(|path| is(path, "mcap") || refused(path).is_some())
                .cloned()
                .collect();
        }
        if let Some(error) = numbered.iter().find_map(|path| refuse(path)) {
            return Err(error);
        }
        return if numbered.is_empty() {
            Err(ImportError::NoRecording {
                root: recording.to_owned(),
            })
        } else {
            Ok(Files {
                paths: numbered,
                ..files
            })
        };
    };
    for name in named {
        // A name is taken as one of this folder, wherever it points.
        let Some(path) = Path::new(&name)
            .file_name()
            .map(|name| recording.join(name))
        else {
            continue;
        };
        if let Some(error) = refuse(&path) {
            return Err(error);
        }
        match path.is_file() {
            true => files.paths.push(path),
            false => files.losses.push(ImportLoss {
                file: path,
                message: format!("{METADATA} names it, and it is not there"),
            }),
        }
    }
    match files.paths.is_empty() {
        true => Err(ImportError::NoRecording {
            root: recording.to_owned(),
        }),
        false => Ok(files),
    }
}

/// What a `metadata.yaml` names, in order.
fn paths(text: &str) -> Option<Vec<String>> {
    let documents = Yaml::load_from_str(text).ok()?;
    let paths = documents
        .first()?
        .as_mapping_get("rosbag2_bagfile_information")?
        .as_mapping_get("relative_file_paths")?;
    let paths: Vec<String> = paths
        .as_sequence()?
        .iter()
        .filter_map(|path| path.as_str().map(str::to_owned))
        .collect();
    (!paths.is_empty()).then_some(paths)
}

/// The files of a recording that rosbag2 did not end: `<folder>_<number>.mcap`, and no others.
fn unfinished(folder: &Path, entries: &[PathBuf]) -> Option<Vec<PathBuf>> {
    let name = folder.file_name()?.to_str()?;
    let number = |path: &&PathBuf| -> Option<u64> {
        path.file_stem()?
            .to_str()?
            .strip_prefix(name)?
            .strip_prefix('_')?
            .parse()
            .ok()
    };
    let bags: Vec<&PathBuf> = entries.iter().filter(|path| is(path, "mcap")).collect();
    let mut numbered: Vec<(u64, &PathBuf)> = bags
        .iter()
        .filter_map(|path| Some((number(path)?, *path)))
        .collect();
    numbered.sort();
    let all = !bags.is_empty() && numbered.len() == bags.len();
    all.then(|| numbered.into_iter().map(|(_, path)| path.clone()).collect())
}

/// What to do with a file that is a recording in a form that is not read.
fn refused(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_str()?;
    if name.ends_with(".db3") || name.ends_with(".db3.zstd") {
        let what = "a bag in SQLite; convert it: write `output_bags: [{uri: converted, storage_id: mcap, all_topics: true}]` into \
                    convert.yaml and run `ros2 bag convert -i FOLDER -o convert.yaml`";
        return Some(what.to_owned());
    }
    if name.ends_with(".mcap.zstd") {
        return Some(
            "a bag that is compressed as a whole; run `zstd -d` on its files and name them without .zstd in metadata.yaml"
                .to_owned(),
        );
    }
    let converted = "a bag of ROS 1; convert it: `rosbags-convert --src FILE --dst FOLDER --dst-storage mcap` (PyPI: rosbags)";
    name.ends_with(".bag").then(|| converted.to_owned())
}

fn is(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found == extension)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_metadata() {
        let text = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n    - a_0.mcap\n    - a_1.mcap\n";
        assert_eq!(
            paths(text),
            Some(vec!["a_0.mcap".to_owned(), "a_1.mcap".to_owned()])
        );
        for broken in [
            "",
            "a: [",
            "rosbag2_bagfile_information: 3",
            "rosbag2_bagfile_information:\n  relative_file_paths: []\n",
        ] {
            assert_eq!(paths(broken), None, "{broken}");
        }
    }
}
