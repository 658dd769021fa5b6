//! The rows of a training set, episode by episode in the order of the store's files, into files that hold whole episodes.
//! Chooses nothing. What is finished is written down, so that a run that was broken off goes on.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use rayon::prelude::*;
use reel_dataset::{Episode, Example, Format, ImageId, Pictures, Shard, Shards, Source, Split, examples};
use reel_reward::Preset;
use reel_tables::{Store, Table};
use reel_trace::Trace;
use reel_world::{Digest, FRAME_HEIGHT, FRAME_WIDTH, NameSet, Profile, record::StepRecord};
use serde::{Deserialize, Serialize};

use crate::{
    ExportError, Mending, Progress, Refusal, SftOptions, SftReport, Words,
    episode::{COLUMNS, Known, Row, mend_histories},
    example_options, parquet,
    select::Candidate,
};

/// Episodes whose rows are in memory at a time.
const EPISODES_AT_A_TIME: usize = 64;
/// Tasks that are kept in memory.
const TASKS_KEPT: usize = 4_096;
/// What is finished, in the dataset's folder.
const STATE: &str = ".export.json";
/// Where the pictures lie meanwhile that go into the rows.
const LOOSE_PICTURES: &str = ".pictures";

/// Where an episode's rows go.
#[derive(Clone, Copy)]
struct Place<'c> {
    candidate: &'c Candidate,
    split: Split,
    file: usize,
}

/// What a run has finished.
#[derive(Serialize, Deserialize)]
struct State {
    /// Digest of everything that decides the bytes.
    dataset: String,
    files: Vec<Finished>,
}

/// A file that is whole, and what became of the episodes that belong into it.
#[derive(Clone, Default, Serialize, Deserialize)]
struct Finished {
    split: String,
    file: usize,
    /// None: no example was left.
    shard: Option<Shard>,
    episodes: u64,
    unverified: u64,
    refused: Vec<Refusal>,
    history: Mending,
}

/// The rows of one episode.
struct Made {
    examples: Vec<Example>,
    /// By example: the row where it is text, and the provenance.
    rows: Vec<(Vec<u8>, Vec<u8>)>,
    refused: Vec<Refusal>,
    history: Mending,
}

/// Writes the examples of the chosen episodes.
pub(crate) fn write(
    store: &Store,
    out: &Path,
    options: &SftOptions,
    chosen: &[Candidate],
    split_of: impl Fn(&Candidate) -> Split,
    progress: Progress<'_>,
    report: &mut SftReport,
) -> Result<(), ExportError> {
    let places = places(chosen, split_of, options.rows_per_file);
    let mut output = Output::open(out, options, store.version())?;
    let (tasks, scenes) = (store.documents(Table::Tasks, "task")?, store.documents(Table::Scenes, "scene")?);
    let mut known: HashMap<String, Arc<Known>> = HashMap::new();
    let mut failed = None;
    store.read(Table::Episodes, COLUMNS, |batch| {
        if failed.is_some() {
            return Ok(());
        }
        let rows: Vec<Row<'_>> = reel_tables::rows_from(&batch)?;
        let mut write_rows = || -> Result<(), ExportError> {
            let placed = rows.iter().filter_map(|row| Some((row, *places.get(row.episode_id)?)));
            let wanted: Vec<_> = placed.filter(|(_, place)| !output.is_finished(place)).collect();
            for portion in wanted.chunks(EPISODES_AT_A_TIME) {
                if known.len() > TASKS_KEPT {
                    known.clear();
                }
                for (row, _) in portion {
                    if !known.contains_key(row.task_digest) {
                        let document = |documents: &HashMap<String, String>, digest: &str| documents.get(digest).cloned().unwrap_or_default();
                        let of_task = Known::of(&document(&tasks, row.task_digest), &document(&scenes, row.scene_digest));
                        let of_task = of_task
                            .map_err(|reason| ExportError::Document { episode_id: row.episode_id.to_owned(), reason })?;
                        known.insert(row.task_digest.to_owned(), Arc::new(of_task));
                    }
                }
                let version = store.version();
                let make = |(row, place): &(&Row<'_>, Place<'_>)| {
                    let made = make(row, place, &known[row.task_digest], options, &output.pictures, version);
                    progress(1);
                    made
                };
                let made: Vec<Result<Made, ExportError>> = portion.par_iter().map(make).collect();
                for ((_, place), made) in portion.iter().zip(made) {
                    output.push(place, made?)?;
                }
            }
            Ok(())
        };
        failed = write_rows().err();
        Ok(())
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    output.finish(report)
}

/// The part and the file of each episode: files get whole episodes until they have enough examples.
fn places<'c>(
    chosen: &'c [Candidate],
    split_of: impl Fn(&Candidate) -> Split,
    rows_per_file: usize,
) -> HashMap<&'c str, Place<'c>> {
    let mut last: BTreeMap<Split, (usize, usize)> = BTreeMap::new();
    let place = |candidate: &'c Candidate| {
        let split = split_of(candidate);
        let (file, rows) = last.entry(split).or_default();
        if *rows >= rows_per_file.max(1) {
            (*file, *rows) = (*file + 1, 0);
        }
        *rows += candidate.decisions.len();
        (candidate.episode_id.as_str(), Place { candidate, split, file: *file })
    };
    chosen.iter().map(place).collect()
}

fn make(
    row: &Row<'_>,
    place: &Place<'_>,
    known: &Known,
    options: &SftOptions,
    pictures: &Pictures,
    table_version: u64,
) -> Result<Made, ExportError> {
    let Place { candidate, split, .. } = *place;
    let mut made = Made { examples: Vec::new(), rows: Vec::new(), refused: Vec::new(), history: Mending::default() };
    let refusal = |call: Option<u32>, reason: String| Refusal {
        episode_id: candidate.episode_id.clone(),
        trace: candidate.trace.clone(),
        call,
        reason,
    };
    let recorded = match options.words {
        Words::Auto => row.has_words(),
        Words::Rules => false,
        Words::Recorded => true,
    };
    let trace = if options.pictures.is_some() || (recorded && row.contradicts()) {
        match Trace::read(Path::new(row.trace)) {
            Ok(trace) => Some(trace),
            Err(error) => {
                made.refused.push(refusal(None, error.to_string()));
                return Ok(made);
            }
        }
    } else {
        None
    };
    let mut notes = if recorded {
        row.recorded()
    } else {
        row.written(known, reel_annotate::episode_seed(options.selection.seed, &Digest::of(row.trace_digest.as_bytes())))
    };
    if let (true, Some(trace)) = (recorded && row.contradicts(), &trace) {
        let (mended, dropped) = mend_histories(&mut notes, trace);
        made.history = Mending { mended: mended as u64, dropped: dropped as u64 };
    }
    let mut steps = row.decisions();
    for (step, note) in steps.iter_mut().zip(notes) {
        (step.reasoning, step.history) = (note.reasoning, note.history);
        (step.schedule, step.subtask) = (note.schedule, note.subtask);
        step.learn = candidate.decisions.iter().any(|decision| decision.call == step.call);
    }
    if let (Some(_), Some(trace)) = (options.pictures, &trace) {
        let whole = options.style != reel_dataset::Style::SingleTurn;
        let moments: Vec<Option<Option<u32>>> =
            steps.iter().map(|step| (whole || step.learn).then(|| moment_before(trace, step.call))).collect();
        let shown = match put_pictures(trace, &moments.iter().flatten().copied().collect(), pictures)? {
            Ok(shown) => shown,
            Err(reason) => {
                made.refused.push(refusal(None, reason));
                return Ok(made);
            }
        };
        for (step, moment) in steps.iter_mut().zip(&moments) {
            step.images = moment.iter().filter_map(|moment| shown.get(moment)).copied().collect();
        }
    }
    let episode = Episode {
        episode_id: row.episode_id.to_owned(),
        task_id: row.task_id.to_owned(),
        family: row.family.to_owned(),
        scene_id: row.scene_id.to_owned(),
        policy: row.policy.to_owned(),
        split,
        instruction: known.instruction().to_owned(),
        names: if row.profile == "real-repo" { Profile::RealRepo.names() } else { NameSet::Paper },
        receptacles: known.receptacles.clone(),
        steps,
        source: source(row, candidate, recorded, table_version),
    };
    let result = examples(&episode, &example_options(options), &known.secrets);
    made.refused.extend(result.refused.into_iter().map(|refused| refusal(refused.call, refused.reason.to_string())));
    for example in &result.examples {
        let (mut line, mut provenance) = (Vec::new(), Vec::new());
        if options.format != Format::Parquet {
            options.format.write_row(example, pictures, &mut line)?;
        }
        example.provenance(&mut provenance);
        made.rows.push((line, provenance));
    }
    made.examples = result.examples;
    Ok(made)
}

fn source(row: &Row<'_>, candidate: &Candidate, recorded: bool, table_version: u64) -> Source {
    let verified = candidate.verified;
    Source {
        trace_digest: row.trace_digest.to_owned(),
        trace_uri: row.trace.to_owned(),
        verdict: if verified { "exact" } else { "unverified" }.into(),
        verdict_sim_version: if verified { reel_replay::SIM_VERSION.to_string() } else { String::new() },
        preset: row.preset.to_owned(),
        preset_digest: Preset::parse(row.preset).map_or_else(|_| String::new(), |preset| preset.version().to_string()),
        rules_version: candidate.rules_version.as_deref().unwrap_or_default().to_owned(),
        table_version,
        annotator: if recorded { row.policy.to_owned() } else { format!("rules-{}", reel_annotate::version().short()) },
    }
}

/// The latest moment before a call at which the agent got a picture; none: before the first call.
fn moment_before(trace: &Trace, call: u32) -> Option<u32> {
    let pictured = |record: &&StepRecord| record.step < call && record.digests.frame.is_some();
    trace.steps.iter().rev().find(pictured).map(|record| record.step)
}

/// The pictures of these moments, in the dataset; or why there are none.
#[expect(clippy::type_complexity, reason = "what stops the export, what refuses the episode, and the pictures")]
fn put_pictures(
    trace: &Trace,
    moments: &BTreeSet<Option<u32>>,
    pictures: &Pictures,
) -> Result<Result<BTreeMap<Option<u32>, ImageId>, String>, ExportError> {
    let frames = match reel_replay::pictures_at(trace, moments) {
        Ok(frames) => frames,
        Err(verdict) => return Ok(Err(verdict.to_string())),
    };
    let mut shown = BTreeMap::new();
    for (moment, rgb) in frames {
        let image = Digest::of(&rgb);
        pictures.put(image, &rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32)?;
        shown.insert(moment, image);
    }
    Ok(Ok(shown))
}

/// The files of a dataset, one open in each part.
struct Output<'o> {
    out: PathBuf,
    options: &'o SftOptions,
    state: State,
    pictures: Arc<Pictures>,
    /// What becomes of the episodes of the file that is open.
    open: BTreeMap<Split, Finished>,
    files: BTreeMap<Split, Files>,
    kept: usize,
}

/// The files of a part.
enum Files {
    Text(Shards),
    Parquet(parquet::Shards),
}

impl<'o> Output<'o> {
    fn open(out: &Path, options: &'o SftOptions, table_version: u64) -> Result<Self, ExportError> {
        let io_error = |source| ExportError::Io { source, path: out.to_path_buf() };
        let what = (options, table_version, reel_dataset::prompt_digest(), reel_annotate::version());
        let dataset = Digest::of_json(&what).to_string();
        fs::create_dir_all(out).map_err(io_error)?;
        let state = match fs::read(out.join(STATE)) {
            Ok(bytes) => serde_json::from_slice(&bytes).ok().filter(|state: &State| state.dataset == dataset),
            Err(_) if fs::read_dir(out).map_err(io_error)?.next().is_some() => None,
            Err(_) => Some(State { dataset, files: Vec::new() }),
        };
        let state = state.ok_or_else(|| ExportError::OtherDataset { path: out.to_path_buf() })?;
        let root = if options.format.holds_pictures() { out.join(LOOSE_PICTURES) } else { out.to_path_buf() };
        let mut output = Self {
            pictures: Arc::new(Pictures::new(&root, options.pictures.unwrap_or_default())),
            kept: state.files.len(),
            out: out.to_path_buf(),
            options,
            state,
            open: BTreeMap::new(),
            files: BTreeMap::new(),
        };
        for finished in output.state.files.clone() {
            if let (Some(split), Some(shard)) = (Split::parse(&finished.split), finished.shard) {
                match output.files(split) {
                    Files::Text(shards) => shards.keep(shard),
                    Files::Parquet(shards) => shards.keep(shard),
                }
            }
        }
        Ok(output)
    }

    fn files(&mut self, split: Split) -> &mut Files {
        let (out, format) = (&self.out, self.options.format);
        self.files.entry(split).or_insert_with(|| match format {
            Format::Parquet => Files::Parquet(parquet::Shards::new(out, split)),
            _ => Files::Text(Shards::new(out, format, split, u64::MAX)),
        })
    }

    /// Whether an earlier run wrote the file that an episode belongs into.
    fn is_finished(&self, place: &Place<'_>) -> bool {
        let mut files = self.state.files[..self.kept].iter();
        files.any(|finished| finished.file == place.file && finished.split == place.split.as_str())
    }

    fn push(&mut self, place: &Place<'_>, made: Made) -> Result<(), ExportError> {
        if self.open.get(&place.split).is_some_and(|open| open.file != place.file) {
            self.close(place.split)?;
        }
        let open = self.open.entry(place.split).or_insert_with(|| Finished {
            split: place.split.as_str().into(),
            file: place.file,
            ..Finished::default()
        });
        let rows = made.rows.len() as u64;
        open.episodes += u64::from(rows > 0);
        open.unverified += if place.candidate.verified { 0 } else { rows };
        open.refused.extend(made.refused);
        open.history.mended += made.history.mended;
        open.history.dropped += made.history.dropped;
        let pictures = Arc::clone(&self.pictures);
        match self.files(place.split) {
            Files::Text(shards) => Ok(made.rows.iter().try_for_each(|(row, provenance)| shards.push(row, provenance))?),
            Files::Parquet(shards) => shards.push(&made.examples, &pictures),
        }
    }

    /// Closes the file of a part and writes down that it is whole.
    fn close(&mut self, split: Split) -> Result<(), ExportError> {
        let Some(mut finished) = self.open.remove(&split) else { return Ok(()) };
        let before = self.shards(split);
        match self.files(split) {
            Files::Text(shards) => shards.close()?,
            Files::Parquet(shards) => shards.close()?,
        }
        finished.shard = self.shards(split).get(before.len()).cloned();
        self.state.files.push(finished);
        let path = self.out.join(STATE);
        let part = self.out.join(format!("{STATE}.part"));
        let json = serde_json::to_vec(&self.state).expect("plain data becomes JSON");
        fs::write(&part, json).and_then(|()| fs::rename(&part, &path)).map_err(|source| ExportError::Io { source, path })
    }

    fn shards(&mut self, split: Split) -> Vec<Shard> {
        match self.files(split) {
            Files::Text(shards) => shards.done().to_vec(),
            Files::Parquet(shards) => shards.done().to_vec(),
        }
    }

    fn finish(mut self, report: &mut SftReport) -> Result<(), ExportError> {
        for split in Split::ALL {
            self.close(split)?;
        }
        report.files_kept = self.kept;
        report.pictures = self.pictures.count();
        self.state.files.sort_by(|one, other| (&one.split, one.file).cmp(&(&other.split, other.file)));
        for finished in self.state.files {
            let split = Split::parse(&finished.split).map_or("", Split::as_str);
            *report.examples.entry(split).or_default() += finished.shard.as_ref().map_or(0, |shard| shard.rows);
            report.episodes += finished.episodes;
            report.unverified += finished.unverified;
            report.refused.extend(finished.refused);
            report.history.mended += finished.history.mended;
            report.history.dropped += finished.history.dropped;
            report.files.extend(finished.shard);
        }
        let loose = self.out.join(LOOSE_PICTURES);
        if loose.exists() {
            fs::remove_dir_all(&loose).map_err(|source| ExportError::Io { source, path: loose })?;
        }
        Ok(())
    }
}
