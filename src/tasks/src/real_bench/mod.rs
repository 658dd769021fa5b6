//! REAL-Bench as it is published: the `benchmark` folder of a checkout, checked as its own loader
//! checks it, and the scenes that its placements prove.
//!
//! A file that fails a check is named and left out, the others load. The published loader accepts a
//! bundle if and only if [`Checkout::broken`] and [`Checkout::complaints`] are empty.

mod captions;
mod checks;
mod floor;
mod rebuild;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use reel_world::Scene;

use self::checks::Facts;
pub use self::rebuild::{Evidence, RebuiltScene};
use crate::{
    LoadReport, TaskError,
    document::{self, Node},
    error::Problem,
    field::Field,
    load::read_file,
    real_schema,
};

/// The name that the manifest gives the benchmark.
const NAME: &str = "REAL-Bench";

/// The published task files of a checkout.
#[derive(Debug)]
pub struct Checkout {
    /// The folder with `manifest.yaml` and `tasks`.
    pub root: PathBuf,
    /// The task files that pass every check of a file, in the order of their paths.
    pub files: Vec<TaskFile>,
    /// Files that fail one.
    pub broken: Vec<TaskError>,
    /// What is wrong with the bundle as a whole: files that are missing, counts that differ.
    pub complaints: Vec<TaskError>,
}

/// A task file of the published layout.
#[derive(Debug)]
pub struct TaskFile {
    /// Path of the file as the check names it.
    pub path: PathBuf,
    facts: Facts,
    root: Node,
}

impl TaskFile {
    /// Its path below `tasks`: `<family>/<task>.yaml`.
    pub fn relative_path(&self) -> PathBuf {
        PathBuf::from(&self.facts.family).join(format!("{}.yaml", self.facts.task_id))
    }

    /// The scene it plays in.
    pub fn scene_id(&self) -> &str {
        &self.facts.scene_id
    }
}

impl Checkout {
    /// Reads a checkout of the published repository, or its `benchmark` folder.
    ///
    /// # Errors
    /// Fails if there is no folder of tasks in it.
    pub fn read(path: &Path) -> Result<Self, TaskError> {
        let below = path.join("benchmark");
        let root = if below.join("tasks").is_dir() {
            below
        } else {
            path.to_owned()
        };
        let tasks = root.join("tasks");
        if !tasks.is_dir() {
            return Err(TaskError::NoBenchmark {
                folder: path.display().to_string(),
            });
        }
        let mut checkout = Self {
            root,
            files: Vec::new(),
            broken: Vec::new(),
            complaints: Vec::new(),
        };
        let manifest = checkout.manifest();
        let families = manifest
            .as_ref()
            .map(|manifest| manifest.family_order.as_slice());
        let mut paths = Vec::new();
        files_below(&tasks, &mut paths).map_err(|source| TaskError::Read {
            file: tasks.display().to_string(),
            source,
        })?;
        for path in paths {
            if path.extension().is_none_or(|extension| extension != "yaml") {
                let problem =
                    "is not a task file: the folder may hold only files tasks/<family>/<task>.yaml"
                        .to_owned();
                checkout.complaints.push(TaskError::Bundle {
                    file: path.display().to_string(),
                    problem,
                });
                continue;
            }
            match TaskFile::read(&tasks, path, families) {
                Ok(file) => checkout.files.push(file),
                Err(error) => checkout.broken.push(error),
            }
        }
        checkout.check_order();
        if let Some(manifest) = &manifest {
            checkout.check_counts(manifest);
            checkout.check_meshes(manifest);
        }
        Ok(checkout)
    }

    /// The ids of the scenes that tasks play in.
    pub fn scene_ids(&self) -> BTreeSet<&str> {
        self.files.iter().map(TaskFile::scene_id).collect()
    }

    /// Rebuilds a scene from all task files that play in it.
    ///
    /// # Errors
    /// Fails if the files contradict each other, or no scene can be made of them.
    pub fn rebuild(&self, scene_id: &str) -> Result<RebuiltScene, TaskError> {
        let files: Vec<(&Path, Field<'_>)> = self
            .of(scene_id)
            .map(|file| (&*file.path, Field::root(&file.root)))
            .collect();
        rebuild::rebuild(scene_id, &files)
    }

    /// The tasks that play in a scene.
    pub fn load(&self, scene: &Scene) -> LoadReport {
        let mut report = LoadReport::default();
        for file in self.of(&scene.scene_id) {
            match real_schema::read(&Field::root(&file.root), scene) {
                Ok((task, warnings)) => {
                    report.tasks.push(task);
                    report.warnings.extend(warnings);
                }
                Err(problem) => report
                    .broken
                    .push(problem.in_file(&file.path.display().to_string())),
            }
        }
        report
    }

    fn of(&self, scene_id: &str) -> impl Iterator<Item = &TaskFile> {
        self.files
            .iter()
            .filter(move |file| file.scene_id() == scene_id)
    }

    /// The manifest, if there is a good one; else a complaint.
    fn manifest(&mut self) -> Option<Manifest> {
        let file = self.root.join("manifest.yaml").display().to_string();
        let read = read_file(Path::new(&file), &file)
            .and_then(|text| Manifest::parse(&text).map_err(|problem| problem.in_file(&file)));
        read.map_err(|error| self.complaints.push(error)).ok()
    }

    /// Tasks are numbered from 0 without a gap. A gap that a broken file leaves is not told twice.
    fn check_order(&mut self) {
        let mut first: BTreeMap<i64, &TaskFile> = BTreeMap::new();
        let mut complaints = Vec::new();
        for file in &self.files {
            let index = file.facts.global_index;
            if let Some(other) = first.insert(index, file) {
                let problem = format!(
                    "its global_index {index} is that of {}, too",
                    other.path.display()
                );
                complaints.push(TaskError::Bundle {
                    file: file.path.display().to_string(),
                    problem,
                });
            }
        }
        let numbers = 0..i64::try_from(self.files.len()).unwrap_or(i64::MAX);
        if let (true, Some((index, file))) = (
            self.broken.is_empty(),
            first.iter().find(|(index, _)| !numbers.contains(index)),
        ) {
            let problem = format!(
                "its global_index is {index}: the {} tasks that are there are not numbered from 0 without a gap",
                self.files.len()
            );
            complaints.push(TaskError::Bundle {
                file: file.path.display().to_string(),
                problem,
            });
        }
        self.complaints.extend(complaints);
    }

    fn check_counts(&mut self, manifest: &Manifest) {
        let file = self.root.join("manifest.yaml").display().to_string();
        let mut complain = |problem: String| {
            self.complaints.push(TaskError::Bundle {
                file: file.clone(),
                problem,
            })
        };
        let found = self.files.len() + self.broken.len();
        if found != manifest.total_tasks {
            complain(format!(
                "total_tasks is {}, but {found} task files are there",
                manifest.total_tasks
            ));
        }
        for (family, count) in &manifest.family_counts {
            let found = self
                .files
                .iter()
                .filter(|task| task.facts.family == *family)
                .count();
            if found != *count {
                complain(format!(
                    "family_counts.{family} is {count}, but {found} good task files are there"
                ));
            }
        }
    }

    /// `mesa_required.txt` lists the meshes that the tasks name, sorted, each once.
    fn check_meshes(&mut self, manifest: &Manifest) {
        let file = self.root.join("mesa_required.txt").display().to_string();
        let text = match read_file(Path::new(&file), &file) {
            Ok(text) => text,
            Err(error) => return self.complaints.push(error),
        };
        let listed: Vec<(usize, &str)> = text
            .lines()
            .enumerate()
            .map(|(at, line)| (at + 1, line.trim()))
            .filter(|(_, name)| !name.is_empty())
            .collect();
        if let Some(pair) = listed.windows(2).find(|pair| pair[0].1 >= pair[1].1) {
            let problem = format!(
                "{} does not come after {}: the names are sorted, each once",
                pair[1].1, pair[0].1
            );
            self.complaints.push(TaskError::Syntax {
                file: file.clone(),
                line: pair[1].0,
                problem,
            });
        }
        let mut complain = |problem: String| {
            self.complaints.push(TaskError::Bundle {
                file: file.clone(),
                problem,
            })
        };
        if listed.len() != manifest.mesa_required_count {
            complain(format!(
                "lists {} meshes, the manifest's mesa_required_count is {}",
                listed.len(),
                manifest.mesa_required_count
            ));
        }
        let listed: BTreeSet<&str> = listed.into_iter().map(|(_, name)| name).collect();
        let named: BTreeSet<&str> = self
            .files
            .iter()
            .flat_map(|file| &file.facts.meshes)
            .map(String::as_str)
            .collect();
        let example = |one: &BTreeSet<&str>, other: &BTreeSet<&str>| {
            let rest: Vec<&str> = one.difference(other).copied().collect();
            rest.first()
                .map(|first| format!("{}, the first is {first}", rest.len()))
        };
        if let Some(rest) = example(&named, &listed) {
            complain(format!("lacks meshes that tasks name: {rest}"));
        }
        if let Some(rest) = example(&listed, &named) {
            complain(format!("lists meshes that no good task file names: {rest}"));
        }
    }
}

impl TaskFile {
    fn read(tasks: &Path, path: PathBuf, families: Option<&[String]>) -> Result<Self, TaskError> {
        let file = path.display().to_string();
        let text = read_file(&path, &file)?;
        let read = || -> Result<(Node, Facts), Problem> {
            let root = document::parse(&text)?;
            let field = Field::root(&root);
            checks::runtime(&field)?;
            let name = |path: Option<&Path>| {
                path.and_then(|path| path.file_name()?.to_str())
                    .unwrap_or_default()
                    .to_owned()
            };
            let (family, task) = (name(path.parent()), name(Some(&path.with_extension(""))));
            if path.parent().and_then(Path::parent) != Some(tasks) {
                return Err(field.problem("does not lie at tasks/<family>/<task>.yaml"));
            }
            let facts = checks::benchmark(&field, (&family, &task), families)?;
            if !is_file_name(&facts.scene_id) {
                return Err(field
                    .get("scene_id")?
                    .problem("expected letters, digits, '-', '_' and '.' only: it names a file"));
            }
            Ok((root, facts))
        };
        let (root, facts) = read().map_err(|problem| problem.in_file(&file))?;
        Ok(Self { path, facts, root })
    }
}

/// Checks the text of a task file as the published server does before it plays it; `file` is its
/// name in errors. Benchmark files must pass more than that: [`Checkout::read`].
///
/// # Errors
/// Fails at the first field that the server would refuse.
pub fn check_runtime(text: &str, file: &str) -> Result<(), TaskError> {
    let check = || checks::runtime(&Field::root(&document::parse(text)?));
    check().map_err(|problem| problem.in_file(file))
}

/// The counts and the order of families that `manifest.yaml` states.
#[derive(Debug)]
struct Manifest {
    total_tasks: usize,
    family_counts: BTreeMap<String, usize>,
    family_order: Vec<String>,
    mesa_required_count: usize,
}

impl Manifest {
    fn parse(text: &str) -> Result<Self, Problem> {
        let root = document::parse(text)?;
        let root = Field::root(&root);
        let name = root.get("benchmark")?;
        if name.any_text()? != NAME {
            return Err(name.problem(format!("expected {NAME}, found {}", name.any_text()?)));
        }
        let positive = |field: Field<'_>| {
            let count = usize::try_from(field.integer()?)
                .ok()
                .filter(|count| *count > 0);
            count.ok_or_else(|| field.problem("expected a number above 0"))
        };
        let counts = root.get("family_counts")?;
        let mut family_counts = BTreeMap::new();
        for (family, count) in counts.entries()? {
            family_counts.insert(family.to_owned(), positive(count)?);
        }
        let order = root.get("family_order")?;
        let family_order = order
            .items()?
            .iter()
            .map(|name| Ok(name.any_text()?.to_owned()))
            .collect::<Result<Vec<_>, Problem>>()?;
        if family_order.is_empty()
            || !family_order
                .iter()
                .collect::<BTreeSet<_>>()
                .into_iter()
                .eq(family_counts.keys())
        {
            return Err(order.problem("does not list the families of family_counts"));
        }
        let total = root.get("total_tasks")?;
        let (total_tasks, sum) = (
            positive(total.clone())?,
            family_counts.values().sum::<usize>(),
        );
        if total_tasks != sum {
            return Err(total.problem(format!(
                "is {total_tasks}, but family_counts add up to {sum}"
            )));
        }
        let mesa_required_count = positive(root.get("mesa_required_count")?)?;
        Ok(Self {
            total_tasks,
            family_counts,
            family_order,
            mesa_required_count,
        })
    }
}

/// All files below a folder, sorted. A link is a file, so that no circle of links is followed.
fn files_below(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let mut entries: Vec<fs::DirEntry> = fs::read_dir(folder)?.collect::<Result<_, _>>()?;
    entries.sort_by_key(fs::DirEntry::path);
    for entry in entries {
        if entry.file_type()?.is_dir() {
            files_below(&entry.path(), files)?;
        } else {
            files.push(entry.path());
        }
    }
    Ok(())
}

fn is_file_name(name: &str) -> bool {
    name.chars()
        .all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
}
