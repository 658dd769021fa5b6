//! What several commands take in: scenes, tasks, trace files, workers.

use std::{
    collections::{BTreeMap, BTreeSet},
    env, fs,
    path::{Path, PathBuf},
    sync::Arc,
    thread::available_parallelism,
};

use anyhow::{Context, bail};
use reel_replay::{PackedTraces, SnapshotCache};
#[cfg(feature = "analytics")]
use reel_tables::{Store, buckets::Buckets};
use reel_tasks::{ObjectOrder, SceneSource};
use reel_tasks::{
    assets::AssetFolder,
    generate::scene::{built_in, names, names_with_parts},
};
use reel_trace::{FrameLayers, Shard, Trace, TraceFiles, is_remote, member, name_of_member};
use reel_world::{AssetId, Meshes, Scene, Scenes, Skills, Task};

/// The argument of commands that measure episodes that may be given instead of paths.
#[cfg(feature = "analytics")]
pub const INSTEAD_OF_PATHS: [&str; 1] = ["store"];
#[cfg(not(feature = "analytics"))]
pub const INSTEAD_OF_PATHS: [&str; 0] = [];

/// The skills of a name, for arguments.
pub fn skills(name: &str) -> Result<Skills, String> {
    Skills::parse(name).ok_or_else(|| {
        format!(
            "there are {}",
            Skills::ALL.map(Skills::as_str).join(" and ")
        )
    })
}

/// What is recorded of each frame besides its image.
pub fn layers(text: &str) -> Result<FrameLayers, String> {
    FrameLayers::parse(text)
}

/// The scene of a file, or one that comes with Reel by its name (`S1` to `S7`, `S1-parts`, `home`);
/// without either, the home.
pub fn scene(path: Option<&Path>) -> anyhow::Result<Arc<Scene>> {
    let Some(path) = path else {
        return Ok(Arc::new(reel_tasks::home_scene()));
    };
    let name = path.to_str().unwrap_or_default();
    if let Some(scene) = built_in(name) {
        return Ok(Arc::new(scene));
    }
    if !path.exists() {
        let names: Vec<&str> = names().chain(names_with_parts()).collect();
        bail!(
            "no scene file {}, and no scene of that name comes along; there are home, {}",
            path.display(),
            names.join(", ")
        );
    }
    let loaded = reel_tasks::scene::load(path)?;
    for warning in &loaded.warnings {
        eprintln!("reel: {}: {warning}", path.display());
    }
    Ok(Arc::new(loaded.scene))
}

/// Task files that failed to load are named, so many of them.
const BROKEN_SHOWN: usize = 10;

/// Tasks with the scenes they play in.
pub struct Tasks {
    /// The tasks, in the order of their files.
    pub tasks: Vec<Arc<Task>>,
    /// The scenes in which these tasks play.
    pub scenes: Scenes,
    /// How many files failed to load.
    pub broken: usize,
}

impl Tasks {
    /// The tasks of each scene, by the id of the scene.
    pub fn by_scene(&self) -> Vec<(Arc<Scene>, Vec<Arc<Task>>)> {
        let of = |scene: &Arc<Scene>| {
            self.tasks
                .iter()
                .filter(|task| task.scene_id == scene.scene_id)
                .cloned()
                .collect()
        };
        let sets = self.scenes.iter().map(|scene| (scene.clone(), of(scene)));
        sets.filter(|(_, tasks): &(_, Vec<_>)| !tasks.is_empty())
            .collect()
    }
}

/// Which scene tasks play in.
#[derive(clap::Args, Clone, Default)]
pub struct SceneArguments {
    /// Scene for all tasks: a file (JSON), or the name of one that comes with Reel; without it the
    /// one that each task names, found beside the tasks, in the folders of --scene-dir, or among
    /// those that come with Reel
    #[arg(long, value_name = "SCENE")]
    pub scene: Option<PathBuf>,
    /// Folders with scene files for tasks that have none beside them [env: REEL_SCENES]
    #[arg(long, value_name = "DIR", value_delimiter = ',')]
    pub scene_dir: Vec<PathBuf>,
}

impl SceneArguments {
    /// The scene of `--scene`, if one is named.
    pub fn fixed(&self) -> anyhow::Result<Option<Arc<Scene>>> {
        let named = self.scene.as_deref();
        named.map(|path| scene(Some(path))).transpose()
    }

    /// Where the scenes of tasks come from.
    pub fn source(&self) -> anyhow::Result<SceneSource> {
        Ok(match self.fixed()? {
            Some(scene) => SceneSource::Fixed(scene),
            None => SceneSource::ById {
                built_in: reel_tasks::generate::scene::by_id,
                folders: self.scene_dir.clone(),
            },
        })
    }

    /// The flags that these stand for, for a command line to print or run.
    pub fn flags(&self) -> Vec<String> {
        let dirs = self.scene_dir.iter().map(|folder| ("--scene-dir", folder));
        let flags = self.scene.iter().map(|path| ("--scene", path)).chain(dirs);
        flags
            .flat_map(|(flag, path)| [flag.to_owned(), path.display().to_string()])
            .collect()
    }
}

/// The tasks of a file or folder with their scenes. Files that fail to load are named and left out.
pub fn tasks(path: &Path, scene: &SceneArguments, listed: ObjectOrder) -> anyhow::Result<Tasks> {
    let loaded = reel_tasks::load_with(path, &scene.source()?, listed);
    for warning in &loaded.warnings {
        eprintln!("reel: {warning}");
    }
    let report = loaded.report;
    for error in report.broken.iter().take(BROKEN_SHOWN) {
        eprintln!("reel: {error}");
    }
    if report.broken.len() > BROKEN_SHOWN {
        let more = report.broken.len() - BROKEN_SHOWN;
        eprintln!(
            "reel: {more} more files failed to load; `reel task check {}` names them",
            path.display()
        );
    }
    if report.tasks.is_empty() {
        bail!(
            "no task could be loaded from {}; `reel task check {0}` says more",
            path.display()
        );
    }
    let tasks = report.tasks.into_iter().map(Arc::new).collect();
    Ok(Tasks {
        tasks,
        scenes: loaded.scenes,
        broken: report.broken.len(),
    })
}

/// The trace files among the paths: files as given, folders, also those in buckets,
/// searched for `.mcap`, sorted; of a shard all episodes, `shard.mcap#0` and so on.
pub fn traces(files: &TraceFiles, paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for path in paths {
        if is_remote(path) {
            let below = files
                .list_remote(path)
                .with_context(|| format!("cannot list {}", path.display()))?;
            found.extend(below.into_iter().filter(|path| is_trace(path)));
        } else if path.is_dir() {
            collect(path, &is_trace, &mut found)
                .with_context(|| format!("cannot list {}", path.display()))?;
        } else if path.exists() || member(path).is_some_and(|(shard, _)| shard.exists()) {
            found.push(path.clone());
        } else {
            bail!("no such trace or folder: {}", path.display());
        }
    }
    found = members(found)?;
    if found.is_empty() {
        let names: Vec<String> = paths
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        bail!(
            "no .mcap file in {}; `reel run` records some",
            names.join(", ")
        );
    }
    Ok(found)
}

/// The files in their order, with the episodes of a shard in its place.
fn members(mut files: Vec<PathBuf>) -> anyhow::Result<Vec<PathBuf>> {
    files.sort();
    let mut found = Vec::with_capacity(files.len());
    for path in files {
        // What cannot be read is somebody else's to report.
        if !is_remote(&path) && Shard::is_one(&path).unwrap_or(false) {
            let episodes = 0..Shard::open(&path)?.len();
            found.extend(episodes.map(|number| name_of_member(&path, number)));
        } else {
            found.push(path);
        }
    }
    Ok(found)
}

/// Where snapshots are kept: a folder that may be deleted at any time.
#[derive(clap::Args)]
pub struct Cache {
    /// Folder for snapshots to seek by; it may be deleted at any time [default: reel-snapshots in
    /// the user's cache folder]
    #[arg(long, value_name = "DIR", conflicts_with = "no_cache")]
    cache: Option<PathBuf>,
    /// Seek by executing from the start, and keep nothing
    #[arg(long)]
    no_cache: bool,
}

impl Cache {
    /// The cache to seek by, if any.
    pub fn open(&self) -> Option<SnapshotCache> {
        if self.no_cache {
            return None;
        }
        self.cache
            .clone()
            .or_else(|| user_cache("reel-snapshots"))
            .map(|folder| SnapshotCache::at(&folder))
    }
}

/// A folder in the user's cache folder.
fn user_cache(name: &str) -> Option<PathBuf> {
    let home = || Some(PathBuf::from(env::var_os("HOME")?).join(".cache"));
    env::var_os("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(home)
        .map(|cache| cache.join(name))
}

/// GiB of buckets' files that are kept where nobody says otherwise.
#[cfg(feature = "analytics")]
const BUCKET_CACHE_GIB: f64 = 10.0;

/// The buckets that the environment gives access to, with the cache that
/// `REEL_BUCKET_CACHE` and `REEL_BUCKET_CACHE_GIB` say.
#[cfg(feature = "analytics")]
pub fn buckets() -> Buckets {
    let folder = env::var_os("REEL_BUCKET_CACHE")
        .map(PathBuf::from)
        .or_else(|| user_cache("reel-buckets"));
    let gib = env::var("REEL_BUCKET_CACHE_GIB")
        .ok()
        .and_then(|text| text.parse::<f64>().ok())
        .filter(|gib| *gib > 0.0);
    let bytes_max = (gib.unwrap_or(BUCKET_CACHE_GIB) * f64::from(1 << 30)) as u64;
    Buckets::new(reel_tables::buckets::Cache::at(
        folder.unwrap_or_else(|| env::temp_dir().join("reel-buckets")),
        bytes_max,
    ))
}

/// Where commands read traces from: this machine and, in builds with tables, buckets. A command
/// makes it once and passes it on, because it remembers what it listed.
pub fn trace_files() -> TraceFiles {
    trace_files_with(None)
}

/// Where traces are read from: this machine and, in builds with tables, buckets. Episodes that were
/// recorded with meshes find them here, too.
pub fn trace_files_with(assets: Option<Arc<dyn reel_world::Assets + Send>>) -> TraceFiles {
    #[cfg(feature = "analytics")]
    let files = TraceFiles::with_remote(Arc::new(buckets()));
    #[cfg(not(feature = "analytics"))]
    let files = TraceFiles::default();
    let packed = PackedTraces::with_assets(assets.clone());
    files.with_assets(assets).with_packed(Arc::new(packed))
}

/// Opens a store, at an earlier version if one is named. Its rows may name traces in buckets.
#[cfg(feature = "analytics")]
pub fn store(location: &str, version: Option<u64>) -> anyhow::Result<Store> {
    let store = match version {
        Some(version) => Store::open_at(location, version)?,
        None => Store::open(location)?,
    };
    Ok(store.with_trace_files(trace_files()))
}

/// Where the meshes of objects are.
#[derive(clap::Args, Clone, Default)]
pub struct Assets {
    /// Folder of meshes, as glTF, OBJ or USD, each named by the asset it shows; assets without one
    /// are primitives. What was recorded with meshes is executed again with the same
    #[arg(
        id = "assets",
        long = "assets",
        value_name = "DIR",
        env = "REEL_ASSETS"
    )]
    folder: Option<PathBuf>,
}

impl Assets {
    /// The folder, if there is one.
    pub fn path(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// The meshes, none where no folder is named.
    pub fn open(&self) -> anyhow::Result<Option<AssetFolder>> {
        let open = |path: &PathBuf| {
            AssetFolder::open(path)
                .with_context(|| format!("cannot list the assets in {}", path.display()))
        };
        self.folder.as_ref().map(open).transpose()
    }

    /// [`trace_files`], with the meshes of the folder.
    pub fn trace_files(&self) -> anyhow::Result<TraceFiles> {
        let assets = self.open()?;
        let assets = assets.map(|folder| Arc::new(folder) as Arc<dyn reel_world::Assets + Send>);
        Ok(trace_files_with(assets))
    }

    /// [`store`], whose functions execute traces with the meshes of the folder.
    #[cfg(feature = "analytics")]
    pub fn store(&self, location: &str, version: Option<u64>) -> anyhow::Result<Store> {
        Ok(store(location, version)?.with_trace_files(self.trace_files()?))
    }

    /// Reads a trace, with the meshes that it was recorded with.
    pub fn read(&self, files: &TraceFiles, path: &Path) -> anyhow::Result<Trace> {
        Ok(files.read(path)?.with_meshes(&self.open()?))
    }

    /// The meshes of all objects of tasks, and how many files were refused. Says of every asset
    /// without a mesh that it has none.
    pub fn of(&self, tasks: &[Arc<Task>]) -> anyhow::Result<(Meshes, usize)> {
        let (Some(folder), Some(path)) = (self.open()?, &self.folder) else {
            return Ok((Meshes::default(), 0));
        };
        let assets: BTreeSet<&AssetId> = tasks.iter().flat_map(|task| task.assets()).collect();
        let (mut meshes, mut absent, mut refused) = (BTreeMap::new(), Vec::new(), 0);
        for &asset in &assets {
            match folder.load(asset) {
                Ok(Some(mesh)) => drop(meshes.insert(asset.clone(), mesh)),
                Ok(None) => absent.push(asset.as_str()),
                Err(reason) => {
                    refused += 1;
                    eprintln!(
                        "reel: the mesh of {asset} is refused, primitives stand in: {reason}"
                    );
                }
            }
        }
        if !absent.is_empty() {
            let (all, shown) = (
                absent.len(),
                absent
                    .iter()
                    .take(5)
                    .copied()
                    .collect::<Vec<_>>()
                    .join(", "),
            );
            let more = if all > 5 { ", ..." } else { "" };
            let folder = path.display();
            eprintln!(
                "reel: {all} of {} assets have no mesh in {folder}, primitives stand in: {shown}{more}",
                assets.len()
            );
        }
        Ok((Arc::new(meshes), refused))
    }
}

/// As [`traces`], with the unfinished recordings (`.mcap.part`); these first.
pub fn recordings(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let (folders, mut found): (Vec<PathBuf>, Vec<PathBuf>) =
        paths.iter().cloned().partition(|path| path.is_dir());
    if let Some(missing) = found.iter().find(|path| !path.exists()) {
        bail!("no such recording or folder: {}", missing.display());
    }
    for folder in &folders {
        collect(folder, &is_recording, &mut found)
            .with_context(|| format!("cannot list {}", folder.display()))?;
    }
    if found.is_empty() {
        let names: Vec<String> = paths
            .iter()
            .map(|path| path.display().to_string())
            .collect();
        bail!("no .mcap and no .mcap.part file in {}", names.join(", "));
    }
    found.sort_by_key(|path| (is_trace(path), path.clone()));
    found.dedup();
    Ok(found)
}

/// The workers asked for, or one for each core.
pub fn workers(jobs: Option<usize>) -> usize {
    jobs.unwrap_or_else(|| available_parallelism().map_or(1, usize::from))
        .max(1)
}

/// Threads for the workers asked for, as [`workers`] counts them.
pub fn pool(jobs: Option<usize>) -> anyhow::Result<rayon::ThreadPool> {
    Ok(rayon::ThreadPoolBuilder::new()
        .num_threads(workers(jobs))
        .build()?)
}

/// The files below a folder that somebody wants.
pub fn collect(
    folder: &Path,
    wanted: &dyn Fn(&Path) -> bool,
    found: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, wanted, found)?;
        } else if wanted(&path) {
            found.push(path);
        }
    }
    Ok(())
}

fn is_trace(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "mcap")
}

fn is_recording(path: &Path) -> bool {
    is_trace(path) || path.to_string_lossy().ends_with(".mcap.part")
}
