//! Files and folders of tasks: every task that can be taken, every file that cannot, every warning.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_world::{Scene, Scenes, Task};

use crate::{
    TaskError, TaskWarning,
    document::{self, Node},
    error::Problem,
    field::Field,
    lookup::{SceneFinder, SceneSource},
    real_proc, real_schema,
};

/// Largest task file; real ones have 30 kB.
const MOST_BYTES: u64 = 4 * 1024 * 1024;
/// Deepest nesting of folders that is searched; deeper ones are reported as errors.
const MOST_FOLDERS: usize = 16;

/// What came of loading.
#[derive(Debug, Default)]
pub struct LoadReport {
    /// The tasks, in the order of their paths.
    pub tasks: Vec<Task>,
    /// What is strange in them, in the same order.
    pub warnings: Vec<TaskWarning>,
    /// Files that could not be taken.
    pub broken: Vec<TaskError>,
}

/// Loads a task file, or every `.yaml` and `.yml` file of a folder and its folders, in the order
/// of their paths. A broken file is reported and the rest load. The scene completes the graphs:
/// files leave receptacles out.
pub fn load(path: &Path, scene: &Scene) -> LoadReport {
    load_as(path, scene, ObjectOrder::AsWritten)
}

/// In which order the objects that a file lists are read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ObjectOrder {
    /// As they stand there.
    AsWritten,
    /// Last first: a check, nothing may depend on it. (Mappings are read in the
    /// order of their keys.)
    Reversed,
}

/// [`load`], reading lists of objects in an order.
pub fn load_as(path: &Path, scene: &Scene, listed: ObjectOrder) -> LoadReport {
    load_with(path, &SceneSource::Fixed(Arc::new(scene.clone())), listed).report
}

/// What came of loading tasks together with their scenes.
#[derive(Debug, Default)]
pub struct LoadedSet {
    /// Tasks, warnings, broken files.
    pub report: LoadReport,
    /// The scenes of the tasks.
    pub scenes: Scenes,
    /// What is doubtful in the scenes, for people.
    pub warnings: Vec<String>,
}

/// [`load`] for tasks of whatever scenes.
pub fn load_with(path: &Path, scenes: &SceneSource, listed: ObjectOrder) -> LoadedSet {
    let mut report = LoadReport::default();
    let mut finder = SceneFinder::new(scenes.clone(), path);
    let mut files = Vec::new();
    find_files(path, 0, &mut files, &mut report.broken);
    if files.is_empty() && report.broken.is_empty() {
        report.broken.push(TaskError::Empty {
            file: path.display().to_string(),
        });
    }
    let mut first_file: BTreeMap<String, String> = BTreeMap::new();
    for path in files {
        let file = path.display().to_string();
        let mut read = || {
            let root = document(&read_file(&path, &file)?, listed)
                .map_err(|problem| problem.in_file(&file))?;
            let scene = finder.of(&Field::root(&root), &path)?;
            tasks_of(&Field::root(&root), &scene).map_err(|problem| problem.in_file(&file))
        };
        match read() {
            Err(error) => report.broken.push(error),
            Ok(tasks) => {
                for (task, warnings) in tasks {
                    match first_file.get(&task.task_id) {
                        Some(first) => {
                            let (file, task_id, first) =
                                (file.clone(), task.task_id, first.clone());
                            report.broken.push(TaskError::DuplicateTask {
                                file,
                                first,
                                task_id,
                            });
                        }
                        None => {
                            first_file.insert(task.task_id.clone(), file.clone());
                            report.tasks.push(task);
                            report.warnings.extend(warnings);
                        }
                    }
                }
            }
        }
    }
    LoadedSet {
        scenes: finder.scenes(),
        warnings: finder.warnings,
        report,
    }
}

/// Reads one task from the text of a file; `file` is its name in errors.
///
/// # Errors
/// Fails if it is no YAML, lacks a field, does not fit the scene, or holds no or several tasks.
pub fn parse(text: &str, file: &str, scene: &Scene) -> Result<(Task, Vec<TaskWarning>), TaskError> {
    let read = || {
        tasks_of(
            &Field::root(&document(text, ObjectOrder::AsWritten)?),
            scene,
        )
    };
    let tasks = read().map_err(|problem| problem.in_file(file))?;
    let count = tasks.len();
    let only = <[_; 1]>::try_from(tasks).map(|[task]| task);
    only.map_err(|_| Problem::syntax(1, format!("expected 1 episode, found {count}")).in_file(file))
}

/// The tasks of a document: one of REAL-Bench, any number of REAL's task generator.
fn tasks_of(root: &Field<'_>, scene: &Scene) -> Result<Vec<(Task, Vec<TaskWarning>)>, Problem> {
    if real_proc::is_proc(root) {
        let tasks = real_proc::read(root, scene)?;
        return Ok(tasks.into_iter().map(|task| (task, Vec::new())).collect());
    }
    Ok(vec![real_schema::read(root, scene)?])
}

fn document(text: &str, listed: ObjectOrder) -> Result<Node, Problem> {
    let mut root = document::parse(text)?;
    if listed == ObjectOrder::Reversed {
        root.reverse_lists("content");
    }
    Ok(root)
}

fn find_files(path: &Path, depth: usize, files: &mut Vec<PathBuf>, broken: &mut Vec<TaskError>) {
    let failed = |source| TaskError::Read {
        file: path.display().to_string(),
        source,
    };
    match fs::metadata(path) {
        Err(source) => broken.push(failed(source)),
        Ok(metadata) if metadata.is_dir() => {
            if depth == MOST_FOLDERS {
                return broken.push(failed(std::io::Error::other(format!(
                    "folders nested deeper than {MOST_FOLDERS}"
                ))));
            }
            match fs::read_dir(path).and_then(|entries| {
                entries
                    .map(|entry| Ok(entry?.path()))
                    .collect::<Result<Vec<_>, _>>()
            }) {
                Err(source) => broken.push(failed(source)),
                Ok(mut paths) => {
                    paths.sort();
                    let wanted = |path: &PathBuf| path.is_dir() || has_yaml_name(path);
                    paths
                        .iter()
                        .filter(|path| wanted(path))
                        .for_each(|path| find_files(path, depth + 1, files, broken));
                }
            }
        }
        Ok(_) => files.push(path.to_owned()),
    }
}

fn has_yaml_name(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "yaml" || extension == "yml")
}

pub(crate) fn read_file(path: &Path, file: &str) -> Result<String, TaskError> {
    let failed = |source| TaskError::Read {
        file: file.to_owned(),
        source,
    };
    let mut text = Vec::new();
    File::open(path)
        .map_err(failed)?
        .take(MOST_BYTES + 1)
        .read_to_end(&mut text)
        .map_err(failed)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(TaskError::TooLarge {
            file: file.to_owned(),
            most: MOST_BYTES,
        });
    }
    String::from_utf8(text).map_err(|error| {
        let line = 1 + error.as_bytes()[..error.utf8_error().valid_up_to()]
            .iter()
            .filter(|byte| **byte == b'\n')
            .count();
        TaskError::Syntax {
            file: file.to_owned(),
            line,
            problem: "not UTF-8 text".to_owned(),
        }
    })
}
