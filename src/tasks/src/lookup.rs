//! Which scene a task plays in: the one of its `scene_id`, in a scene file beside the task or in
//! a folder above, else in a folder that the caller names, else among those that come with Reel.
//! The one place that knows where scene files lie.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_world::{Scene, Scenes};
use serde::{Deserialize, de::IgnoredAny};

use crate::{TaskError, error::Problem, field::Field, load::read_file, scene};

/// Folders above the one that was named, in which scenes are
/// searched: `benchmark/tasks/FDP` finds `benchmark/scenes`.
const FOLDERS_ABOVE: usize = 2;
/// Name of a folder of scenes beside tasks.
const SCENES: &str = "scenes";
/// Most `.json` files that are looked into in a folder.
const FILES_MAX: usize = 4096;

/// Where the scenes of tasks come from.
#[derive(Clone)]
pub enum SceneSource {
    /// This scene, for all tasks.
    Fixed(Arc<Scene>),
    /// The scene file that has the task's `scene_id`: beside the tasks or above, else in one of
    /// the folders, else what the function gives for the id.
    ById {
        /// The scene that comes with Reel under an id.
        built_in: fn(&str) -> Option<Scene>,
        /// Further folders of scene files, in the order of the search.
        folders: Vec<PathBuf>,
    },
}

/// Finds the scenes of tasks, and keeps them.
pub(crate) struct SceneFinder {
    source: SceneSource,
    /// Number of components of the topmost folder that is searched.
    top: usize,
    folders: BTreeMap<PathBuf, Vec<SceneFile>>,
    /// The files that were read, with their scenes.
    read: BTreeMap<PathBuf, Arc<Scene>>,
    /// What was found, and where if it was a file.
    found: BTreeMap<String, (Arc<Scene>, Option<PathBuf>)>,
    pub(crate) warnings: Vec<String>,
}

/// A `.json` file that may be a scene.
struct SceneFile {
    path: PathBuf,
    /// Absent where the file cannot be read so far.
    scene_id: Option<String>,
}

/// What tells scene files from others.
#[derive(Deserialize)]
struct Header {
    scene_id: String,
    #[expect(dead_code, reason = "a file without receptacles is no scene")]
    receptacles: IgnoredAny,
}

impl SceneFinder {
    /// A finder for the tasks of a file or folder.
    pub fn new(source: SceneSource, tasks: &Path) -> Self {
        let absolute = absolute(tasks);
        let folder = if absolute.is_dir() {
            absolute.as_path()
        } else {
            absolute.parent().unwrap_or(&absolute)
        };
        let top = folder
            .components()
            .count()
            .saturating_sub(FOLDERS_ABOVE)
            .max(1);
        Self {
            source,
            top,
            folders: BTreeMap::new(),
            read: BTreeMap::new(),
            found: BTreeMap::new(),
            warnings: Vec::new(),
        }
    }

    /// The scene of a task file.
    pub fn of(&mut self, root: &Field<'_>, file: &Path) -> Result<Arc<Scene>, TaskError> {
        let name = file.display().to_string();
        let in_file = |problem: Problem| problem.in_file(&name);
        let built_in = match &self.source {
            SceneSource::Fixed(scene) => return Ok(scene.clone()),
            SceneSource::ById { built_in, .. } => *built_in,
        };
        let field = root.get("scene_id").map_err(in_file)?;
        let scene_id = field.text().map_err(in_file)?;
        let Some(path) = self.nearest(scene_id, file) else {
            if let Some((scene, None)) = self.found.get(scene_id) {
                return Ok(scene.clone());
            }
            let missing = || TaskError::NoScene {
                file: name.clone(),
                line: field.line(),
                scene_id: scene_id.to_owned(),
                searched: self.searched(file),
            };
            let scene = Arc::new(built_in(scene_id).ok_or_else(missing)?);
            return self
                .keep(scene_id, scene, None)
                .map_err(|problem| in_file(field.problem(problem)));
        };
        let scene = match self.read.get(&path) {
            Some(scene) => scene.clone(),
            None => {
                let loaded = scene::load(&path)?;
                self.warnings.extend(
                    loaded
                        .warnings
                        .iter()
                        .map(|warning| format!("{}: {warning}", path.display())),
                );
                let scene = Arc::new(loaded.scene);
                self.read.insert(path.clone(), scene.clone());
                scene
            }
        };
        self.keep(scene_id, scene, Some(path))
            .map_err(|problem| in_file(field.problem(problem)))
    }

    /// The scenes that were found.
    pub fn scenes(&self) -> Scenes {
        let mut scenes = Scenes::default();
        match &self.source {
            SceneSource::Fixed(scene) => scenes.insert(scene.clone()),
            SceneSource::ById { .. } => self
                .found
                .values()
                .for_each(|(scene, _)| scenes.insert(scene.clone())),
        }
        scenes
    }

    /// Keeps a scene under its id; two different ones of an id cannot live together.
    fn keep(
        &mut self,
        scene_id: &str,
        scene: Arc<Scene>,
        path: Option<PathBuf>,
    ) -> Result<Arc<Scene>, String> {
        let (known, first) = self
            .found
            .entry(scene_id.to_owned())
            .or_insert_with(|| (scene.clone(), path.clone()));
        if **known == *scene {
            return Ok(known.clone());
        }
        let name = |path: &Option<PathBuf>| {
            path.as_ref()
                .map_or("the one that comes with Reel".to_owned(), |path| {
                    path.display().to_string()
                })
        };
        Err(format!(
            "two different scenes have this id: {} and {}",
            name(first),
            name(&path)
        ))
    }

    /// The folders in which the scene of a task file is searched, in their order.
    fn searched(&self, file: &Path) -> Vec<PathBuf> {
        let file = absolute(file);
        let above = file.ancestors().skip(1).map(Path::to_owned);
        let above = above.take_while(|folder| folder.components().count() >= self.top);
        match &self.source {
            SceneSource::Fixed(_) => Vec::new(),
            SceneSource::ById { folders, .. } => above.chain(folders.iter().cloned()).collect(),
        }
    }

    /// The scene file of an id in the first of these folders that has one.
    fn nearest(&mut self, scene_id: &str, file: &Path) -> Option<PathBuf> {
        for folder in self.searched(file) {
            let files = self
                .folders
                .entry(folder)
                .or_insert_with_key(|folder| scene_files(folder));
            let named = |file: &&SceneFile| match &file.scene_id {
                Some(id) => id == scene_id,
                None => file.path.file_stem().is_some_and(|stem| stem == scene_id),
            };
            if let Some(file) = files.iter().find(named) {
                return Some(file.path.clone());
            }
        }
        None
    }
}

/// The files of a folder, and of its folder `scenes`, that may be scenes.
fn scene_files(folder: &Path) -> Vec<SceneFile> {
    let list = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path());
        let mut paths: Vec<PathBuf> = entries
            .filter(|path| {
                path.extension()
                    .is_some_and(|extension| extension == "json")
            })
            .take(FILES_MAX)
            .collect();
        paths.sort();
        paths
    };
    let file = |path: PathBuf| {
        let header = read_file(&path, "")
            .ok()
            .map(|text| serde_json::from_str::<Header>(&text));
        let scene_id = header.and_then(Result::ok).map(|header| header.scene_id);
        SceneFile { path, scene_id }
    };
    list(folder)
        .into_iter()
        .chain(list(&folder.join(SCENES)))
        .map(file)
        .collect()
}

/// A path from the root, where that can be told.
fn absolute(path: &Path) -> PathBuf {
    fs::canonicalize(path)
        .or_else(|_| std::path::absolute(path))
        .unwrap_or_else(|_| path.to_owned())
}
