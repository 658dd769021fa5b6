//! Tasks with the scenes they play in.

use std::{
    collections::BTreeMap,
    path::{self, Path, PathBuf},
    sync::Arc,
};

use pyo3::prelude::*;
use reel_tasks::{
    ObjectOrder, SceneSource,
    assets::AssetFolder,
    generate::scene::{built_in, by_id},
};
use reel_world::{AssetId, Assets as _, Mesh, Meshes, Profile, Scene, Scenes, Task, ToolSpec};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::{
    convert,
    error::{OrRaise as _, refuse},
};

/// Tasks of files or a folder, each with its scene.
#[pyclass(frozen, module = "reel._reel")]
pub struct TaskSet {
    pub tasks: Vec<Arc<Task>>,
    pub scenes: Scenes,
    pub meshes: Meshes,
    /// What was odd about files that did load.
    #[pyo3(get)]
    warnings: Vec<String>,
    /// Why files did not load: file, line and field.
    #[pyo3(get)]
    broken: Vec<String>,
    /// Absolute path of the folder that the meshes come from; `None` without meshes.
    assets: Option<PathBuf>,
}

/// A set of tasks as pickle keeps it: the documents themselves, and where the meshes lie.
#[derive(Serialize, Deserialize)]
struct Documents {
    tasks: Vec<Task>,
    scenes: Vec<Scene>,
    warnings: Vec<String>,
    broken: Vec<String>,
    assets: Option<PathBuf>,
    /// Digests of the meshes, by asset.
    meshes: BTreeMap<AssetId, String>,
}

/// How pickle makes a set of tasks again: the function, and the JSON of its documents.
type Pickled<'py> = (Bound<'py, PyAny>, (String,));

/// The meshes of a folder that tasks name.
///
/// # Errors
/// Fails if the folder cannot be read.
fn meshes(assets: Option<&Path>, tasks: &[Arc<Task>]) -> PyResult<Meshes> {
    Ok(match assets {
        Some(folder) => AssetFolder::open(folder)
            .or_raise()?
            .meshes(&mut tasks.iter().flat_map(|task| task.assets())),
        None => Meshes::default(),
    })
}

/// The digest of each mesh.
fn digests(meshes: &Meshes) -> BTreeMap<AssetId, String> {
    let digest = |(asset, mesh): (&AssetId, &Arc<Mesh>)| (asset.clone(), mesh.digest().to_string());
    meshes.iter().map(digest).collect()
}

impl TaskSet {
    /// The scene of one of the tasks.
    pub fn scene_of(&self, task: &Task) -> PyResult<&Arc<Scene>> {
        self.scenes
            .of(task)
            .ok_or_else(|| refuse(format!("task {}: its scene is not there", task.task_id)))
    }

    /// The task at an index, and its scene.
    pub fn get(&self, index: isize) -> PyResult<(&Arc<Task>, &Arc<Scene>)> {
        let task = &self.tasks[convert::index(index, self.tasks.len(), "task")?];
        Ok((task, self.scene_of(task)?))
    }
}

#[pymethods]
impl TaskSet {
    #[staticmethod]
    #[pyo3(signature = (path, scene = None, scene_dirs = Vec::new(), assets = None))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        scene: Option<PathBuf>,
        scene_dirs: Vec<PathBuf>,
        assets: Option<PathBuf>,
    ) -> PyResult<Self> {
        py.detach(|| {
            let source = match &scene {
                Some(scene) => SceneSource::Fixed(fixed_scene(scene)?),
                None => SceneSource::ById {
                    built_in: by_id,
                    folders: scene_dirs,
                },
            };
            let loaded = reel_tasks::load_with(&path, &source, ObjectOrder::AsWritten);
            let broken: Vec<String> = loaded
                .report
                .broken
                .iter()
                .map(ToString::to_string)
                .collect();
            if loaded.report.tasks.is_empty() {
                let first = broken
                    .first()
                    .map_or(String::new(), |why| format!(": {why}"));
                return Err(refuse(format!(
                    "no task could be loaded from {}{first}",
                    path.display()
                )));
            }
            let tasks: Vec<Arc<Task>> = loaded.report.tasks.into_iter().map(Arc::new).collect();
            let meshes = meshes(assets.as_deref(), &tasks)?;
            // pickle may be read in another folder
            let assets = assets.map(|folder| path::absolute(&folder).unwrap_or(folder));
            Ok(Self {
                assets,
                tasks,
                scenes: loaded.scenes,
                meshes,
                warnings: loaded.warnings.iter().map(ToString::to_string).collect(),
                broken,
            })
        })
    }

    fn __len__(&self) -> usize {
        self.tasks.len()
    }

    /// Ids of the tasks, in the order of their files.
    fn ids(&self) -> Vec<String> {
        self.tasks
            .iter()
            .map(|task| task.task_id.to_string())
            .collect()
    }

    /// The index of a task, by its id or by the part after the family.
    fn find(&self, id: &str) -> PyResult<usize> {
        let whole = self.tasks.iter().position(|task| task.task_id == id);
        let mut short = self
            .tasks
            .iter()
            .enumerate()
            .filter(|(_, task)| task.short_id() == id);
        whole
            .or_else(|| {
                short
                    .next()
                    .map(|(index, _)| index)
                    .filter(|_| short.next().is_none())
            })
            .ok_or_else(|| refuse(format!("no task, or several, are called {id}")))
    }

    /// A task as a dictionary: instruction, objects, goal. Privileged.
    fn task<'py>(&self, py: Python<'py>, index: isize) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &**self.get(index)?.0)
    }

    /// The scene of a task as a dictionary.
    fn scene<'py>(&self, py: Python<'py>, index: isize) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &**self.get(index)?.1)
    }

    /// The tasks at these indices alone.
    fn select(&self, indices: Vec<isize>) -> PyResult<Self> {
        let tasks = indices
            .into_iter()
            .map(|index| Ok(self.get(index)?.0.clone()));
        Ok(Self {
            tasks: tasks.collect::<PyResult<_>>()?,
            scenes: self.scenes.clone(),
            meshes: self.meshes.clone(),
            warnings: self.warnings.clone(),
            broken: self.broken.clone(),
            assets: self.assets.clone(),
        })
    }

    /// The set that [`TaskSet::__reduce__`] wrote down.
    ///
    /// # Errors
    /// Fails if the text is damaged, or if the folder of meshes holds others than it did.
    #[staticmethod]
    fn from_documents(py: Python<'_>, text: &str) -> PyResult<Self> {
        py.detach(|| {
            let documents: Documents = serde_json::from_str(text).or_raise()?;
            let tasks: Vec<Arc<Task>> = documents.tasks.into_iter().map(Arc::new).collect();
            let meshes = meshes(documents.assets.as_deref(), &tasks)?;
            if let (Some(folder), true) = (
                &documents.assets,
                digests(&meshes) != documents.meshes,
            ) {
                return Err(refuse(format!(
                    "the meshes are no longer those that the tasks were loaded with; load the tasks here: {}",
                    folder.display()
                )));
            }
            let mut scenes = Scenes::default();
            for scene in documents.scenes {
                scenes.insert(Arc::new(scene));
            }
            Ok(Self {
                tasks,
                scenes,
                meshes,
                warnings: documents.warnings,
                broken: documents.broken,
                assets: documents.assets,
            })
        })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Pickled<'py>> {
        let mut scenes = Scenes::default();
        for task in &self.tasks {
            scenes.insert(self.scene_of(task)?.clone());
        }
        let documents = Documents {
            tasks: self.tasks.iter().map(|task| (**task).clone()).collect(),
            scenes: scenes.iter().map(|scene| (**scene).clone()).collect(),
            warnings: self.warnings.clone(),
            broken: self.broken.clone(),
            assets: self.assets.clone(),
            meshes: digests(&self.meshes),
        };
        let text = serde_json::to_string(&documents).or_raise()?;
        let read = py.get_type::<Self>().getattr("from_documents")?;
        Ok((read, (text,)))
    }
}

fn fixed_scene(path: &Path) -> PyResult<Arc<Scene>> {
    match path.to_str().and_then(built_in) {
        Some(scene) => Ok(Arc::new(scene)),
        None => Ok(Arc::new(reel_tasks::scene::load(path).or_raise()?.scene)),
    }
}

/// The tools that a policy has in a profile: name, description and JSON Schema of the arguments.
#[pyfunction]
pub fn tools<'py>(py: Python<'py>, profile: &str) -> PyResult<Bound<'py, PyAny>> {
    let names = self::profile(profile)?.names();
    let tool = |spec: &ToolSpec| {
        let parameters = match spec.argument {
            Some(argument) => json!({
                "type": "object", "required": [argument.name],
                "properties": { argument.name: { "type": argument.json_type } },
            }),
            None => json!({ "type": "object", "properties": {} }),
        };
        json!({
            "name": spec.name(names), "description": spec.description,
            "parameters": parameters,
        })
    };
    let tools: Vec<_> = ToolSpec::POLICY.iter().map(tool).collect();
    convert::object(py, &tools)
}

/// The profile of a name.
pub fn profile(name: &str) -> PyResult<Profile> {
    Profile::parse(name).ok_or_else(|| {
        refuse(format!(
            "no profile is called '{name}'; there are paper, real-repo and real-gspo"
        ))
    })
}
