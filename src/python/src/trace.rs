//! Recorded episodes.

use std::{path::PathBuf, sync::Arc};

use numpy::{PyArray2, PyArray3};
use pyo3::{prelude::*, types::PyBytes};
use rayon::prelude::*;
use reel_agents::RecordTo;
use reel_counterfactual::{
    blame::{BlameOptions, measure},
    branch::{Branch, Continuation, fork},
};
use reel_replay::{
    Detail, EndSummary, SnapshotCache, Verdict, Viewpoint, compare, seek, verify_catching_panics,
    view_at,
};
use reel_tasks::assets::AssetFolder;
use reel_trace::{FrameLayers, Images, RecordOptions, TraceFiles};
use reel_world::{Assets, instances};
use serde_json::json;

use crate::{
    convert,
    error::{DivergenceError, OrRaise as _, not_executed, raise, refuse},
    running::{Stop, interruptible, pool, report_progress},
    simulation::ForkPoint,
};

/// A recorded episode: one MCAP file, read and checked.
#[pyclass(frozen, module = "reel._reel")]
pub struct Trace {
    pub inner: Arc<reel_trace::Trace>,
    assets: Option<PathBuf>,
}

/// How pickle makes a trace again: the function, and its arguments.
type Pickled<'py> = (Bound<'py, PyAny>, (PathBuf, Option<PathBuf>));

/// The files that traces are read from, with the meshes of a folder.
fn files(assets: Option<&PathBuf>) -> PyResult<TraceFiles> {
    let meshes = assets
        .map(|folder| AssetFolder::open(folder))
        .transpose()
        .or_raise()?;
    let meshes = meshes.map(|folder| Arc::new(folder) as Arc<dyn Assets + Send>);
    Ok(reel_cli::trace_files(meshes))
}

#[pymethods]
impl Trace {
    #[staticmethod]
    #[pyo3(signature = (path, assets = None))]
    fn read(py: Python<'_>, path: PathBuf, assets: Option<PathBuf>) -> PyResult<Self> {
        py.detach(|| {
            let files = files(assets.as_ref())?;
            let trace = files.with_meshes(files.read(&path).or_raise()?);
            Ok(Self {
                inner: Arc::new(trace),
                assets,
            })
        })
    }

    #[getter]
    fn path(&self) -> PathBuf {
        self.inner.path.clone()
    }

    /// The last link of the hash chain: a digest of all inputs and outputs.
    #[getter]
    fn chain(&self) -> String {
        self.inner.chain().to_string()
    }

    /// Size of the file in bytes.
    #[getter]
    fn bytes(&self) -> u64 {
        self.inner.bytes
    }

    /// How many images the trace holds.
    #[getter]
    fn image_count(&self) -> usize {
        self.inner.image_count()
    }

    fn __len__(&self) -> usize {
        self.inner.steps.len()
    }

    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &self.inner.header)
    }

    fn task<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &*self.inner.task)
    }

    fn scene<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &*self.inner.scene)
    }

    fn start<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &self.inner.start)
    }

    fn end<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &self.inner.end)
    }

    fn step<'py>(&self, py: Python<'py>, call: isize) -> PyResult<Bound<'py, PyAny>> {
        let call = convert::index(call, self.inner.steps.len(), "call")?;
        convert::object(py, &self.inner.steps[call])
    }

    /// The call of a step as people write it, e.g. `pick(2)`.
    fn call_text(&self, call: isize) -> PyResult<String> {
        let call = convert::index(call, self.inner.steps.len(), "call")?;
        Ok(self.inner.steps[call].input.call.to_string())
    }

    /// The graphs before the first call (none) or after a call, by both authorities.
    #[pyo3(signature = (call = None))]
    fn graphs<'py>(&self, py: Python<'py>, call: Option<u32>) -> PyResult<Bound<'py, PyAny>> {
        let mut graphs = self.inner.start.graphs.clone();
        let made = call.map_or(0, |call| call as usize + 1);
        for step in self.inner.steps.iter().take(made) {
            graphs.physics.apply(&step.changes.physics);
            graphs.registry.apply(&step.changes.registry);
        }
        convert::object(py, &graphs)
    }

    /// The image of the trace, RGB; none where it holds none for that call.
    #[pyo3(signature = (call = None))]
    fn image<'py>(
        &self,
        py: Python<'py>,
        call: Option<u32>,
    ) -> PyResult<Option<Bound<'py, PyArray3<u8>>>> {
        let pixels = py.detach(|| self.inner.frame_rgb(call)).or_raise()?;
        pixels.map(|pixels| convert::rgb(py, pixels)).transpose()
    }

    /// The recorded depth in millimetres; none where the trace holds none.
    #[pyo3(signature = (call = None))]
    fn depth<'py>(
        &self,
        py: Python<'py>,
        call: Option<u32>,
    ) -> PyResult<Option<Bound<'py, PyArray2<u16>>>> {
        let values = py.detach(|| self.inner.depth_mm(call)).or_raise()?;
        values.map(|values| convert::layer(py, values)).transpose()
    }

    /// The recorded instance ids; none where the trace holds none.
    #[pyo3(signature = (call = None))]
    fn instance_ids<'py>(
        &self,
        py: Python<'py>,
        call: Option<u32>,
    ) -> PyResult<Option<Bound<'py, PyArray2<u16>>>> {
        let values = py.detach(|| self.inner.instance_ids(call)).or_raise()?;
        values.map(|values| convert::layer(py, values)).transpose()
    }

    /// What the numbers of instance ids stand for.
    fn instances<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        convert::object(py, &instances(&self.inner.task, &self.inner.scene))
    }

    /// Draws what is seen from a camera after a call (none: before the first): RGB, depth, ids.
    #[pyo3(signature = (call, camera, eye = None, look_at = None, cache = None))]
    fn draw<'py>(
        &self,
        py: Python<'py>,
        call: Option<u32>,
        camera: &str,
        eye: Option<&str>,
        look_at: Option<&str>,
        cache: Option<PathBuf>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let viewpoint = Viewpoint::named(camera, eye, look_at, &self.inner.task).or_raise()?;
        let cache = cache.map(|folder| SnapshotCache::at(&folder));
        let frame = py.detach(|| view_at(&self.inner, call, &viewpoint, cache.as_ref()));
        convert::frame(py, frame.map_err(|verdict| not_executed(&verdict))?)
    }

    /// Executes the episode again and compares everything.
    fn replay<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let verdict = py.detach(|| verify_catching_panics(&self.inner, Detail::Full));
        let told = verdict.to_string();
        let mut object = serde_json::to_value(&verdict).or_raise()?;
        object["text"] = json!(told);
        convert::object(py, &object)
    }

    /// The state after so many calls, from which other futures can be played.
    #[pyo3(signature = (calls, cache = None))]
    fn fork(&self, py: Python<'_>, calls: usize, cache: Option<PathBuf>) -> PyResult<ForkPoint> {
        let cache = cache.map(|folder| SnapshotCache::at(&folder));
        py.detach(|| {
            let replay = seek(&self.inner, calls, cache.as_ref());
            let replay = replay.map_err(|verdict| not_executed(&verdict))?;
            ForkPoint::of(self.inner.clone(), calls, replay.episode())
        })
    }

    /// Plays another future from a call on, and records it.
    #[pyo3(signature = (at, calls, then, seed = None, out = None, images = None, cache = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn branch<'py>(
        &self,
        py: Python<'py>,
        at: usize,
        calls: Vec<(String, Bound<'py, PyAny>)>,
        then: Option<&str>,
        seed: Option<u64>,
        out: Option<PathBuf>,
        images: Option<bool>,
        cache: Option<PathBuf>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let calls = calls
            .iter()
            .map(|(name, arguments)| convert::call(name, Some(arguments)))
            .collect::<PyResult<Vec<_>>>()?;
        let seed = seed.unwrap_or(self.inner.header.seed);
        let branch = Branch {
            continuation: continuation(then, at + calls.len(), seed)?,
            calls,
        };
        let parent = &self.inner;
        let images = images.unwrap_or_else(|| parent.image_count() > 0);
        let record = out.map(|path| RecordTo {
            path,
            options: RecordOptions::from(if images { Images::Full } else { Images::None }),
        });
        let cache = cache.map(|folder| SnapshotCache::at(&folder));
        let report = interruptible(
            py,
            || (),
            || {
                let fork = fork(parent, at, cache.as_ref())?;
                branch.play(&fork, record.as_ref())
            },
        )?;
        let report = report.map_err(|error| match error.is_divergence() {
            true => DivergenceError::new_err(error.to_string()),
            false => raise(&error),
        })?;
        convert::object(py, &crate::policy::report(&report))
    }

    /// Which call decided that it failed, by other futures that were played.
    #[pyo3(signature = (alternatives = true, branches = None))]
    fn blame<'py>(
        &self,
        py: Python<'py>,
        alternatives: bool,
        branches: Option<PathBuf>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let options = BlameOptions {
            alternatives,
            branches,
            ..BlameOptions::default()
        };
        let measured = interruptible(py, || (), || measure(&self.inner, &options))?
            .map_err(|verdict| not_executed(&verdict))?;
        convert::object(py, &measured)
    }

    /// Both episodes side by side, call by call.
    fn diff<'py>(&self, py: Python<'py>, other: &Trace) -> PyResult<Bound<'py, PyAny>> {
        let compared = py
            .detach(|| compare(&self.inner, &other.inner))
            .or_raise()?;
        convert::object(py, &compared)
    }

    /// The episode as text.
    fn transcript(&self) -> String {
        reel_view::transcript(&self.inner)
    }

    /// The episode as a recording for Rerun, with depth, masks or both.
    #[pyo3(signature = (layers = ""))]
    fn rerun_recording<'py>(&self, py: Python<'py>, layers: &str) -> PyResult<Bound<'py, PyBytes>> {
        let layers = FrameLayers::parse(layers).map_err(refuse)?;
        let bytes = py
            .detach(|| reel_view::rrd(&self.inner, layers))
            .or_raise()?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// How it ended, in one line.
    fn ending(&self) -> String {
        match &self.inner.end {
            Some(end) => EndSummary::of(end, &self.inner.task).to_string(),
            None => format!("broken off after {} calls", self.inner.steps.len()),
        }
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Pickled<'py>> {
        let read = py.get_type::<Self>().getattr("read")?;
        Ok((read, (self.inner.path.clone(), self.assets.clone())))
    }
}

/// How a branch goes on, by the words of `reel branch --then`.
fn continuation(then: Option<&str>, next: usize, seed: u64) -> PyResult<Continuation> {
    Ok(match then {
        None => Continuation::Stop,
        Some("parent") => Continuation::Parent(next),
        Some(who) => match who.strip_prefix("parent:").map(str::parse) {
            Some(Ok(from)) => Continuation::Parent(from),
            Some(Err(_)) => return Err(refuse(format!("then='{who}': no call"))),
            None => Continuation::Policy {
                name: who.to_owned(),
                seed,
            },
        },
    })
}

/// The trace files below folders, and files as given, sorted.
#[pyfunction]
pub fn trace_paths(paths: Vec<PathBuf>) -> PyResult<Vec<PathBuf>> {
    let files = TraceFiles::with_remote(Arc::new(reel_cli::buckets()));
    reel_cli::trace_paths(&files, &paths).map_err(|error| refuse(format!("{error:#}")))
}

/// Replays traces on so many threads; verdicts in the order of the paths.
#[pyfunction]
#[pyo3(signature = (paths, jobs, assets = None, progress = None))]
pub fn replay_all<'py>(
    py: Python<'py>,
    paths: Vec<PathBuf>,
    jobs: usize,
    assets: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let files = files(assets.as_ref())?;
    let stop = Stop::default();
    let replay = |path: &PathBuf| {
        // nobody waits any more: the rest is passed over
        if stop.is_set() {
            return None;
        }
        let verdict = match files.read(path) {
            Ok(trace) => verify_catching_panics(&files.with_meshes(trace), Detail::Full),
            Err(error) => Verdict::Refused {
                reason: error.to_string(),
            },
        };
        report_progress(progress.as_ref(), 1);
        Some(verdict)
    };
    let pool = pool(jobs)?;
    let verdicts = interruptible(
        py,
        || stop.set(),
        || {
            pool.install(|| {
                paths
                    .par_iter()
                    .with_max_len(1)
                    .map(replay)
                    .collect::<Vec<_>>()
            })
        },
    )?;
    let told = verdicts.iter().flatten().map(|verdict| {
        let mut object = serde_json::to_value(verdict).or_raise()?;
        object["text"] = json!(verdict.to_string());
        Ok(object)
    });
    convert::object(py, &told.collect::<PyResult<Vec<_>>>()?)
}
