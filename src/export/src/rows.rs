//! The rows of a training set, episode by episode in the order of the
//! store's files. Chooses nothing.
//!
//! A run that was broken off is begun again where it is dear: verdicts are kept in the store, and
//! images that are in the folder already are neither drawn nor encoded a second time. Rows are
//! cheap, and are written anew.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    fs::{self, File},
    io::{self, BufRead as _, BufReader, Write as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use rayon::prelude::*;
use reel_dataset::{
    AgentSetup, DatasetWriter, Description, Episode, Example, ExampleOptions, Format, ImageId,
    ImageStore, Manifest, PreparedRow, Source, Split, Step, StoredImage, Style, TASK_LIST,
    TokenizerFile, UNFINISHED, examples, task_list,
};
use reel_reward::Preset;
use reel_tables::{Store, Table};
use reel_trace::{Trace, TraceFiles};
use reel_world::{Digest, FRAME_HEIGHT, FRAME_WIDTH, NameSet, Profile};
use serde::{Deserialize, Serialize};

use crate::{
    AnnotationSource, ExportError, ExportOptions, ExportReport, HistoryRepairs, Progress,
    RefusedEpisode,
    episode::{EpisodeRow, columns, repair_histories},
    parquet,
    select::Candidate,
    task_index::TaskIndex,
    verify::Comparison,
};

/// Episodes whose rows are in memory at a time.
const EPISODES_AT_A_TIME: usize = 256;

/// A chosen episode and the part that it goes into.
type SplitAssignment<'c> = (&'c Candidate, Split);

/// The rows of one episode.
struct EpisodeRows {
    examples: Vec<Example>,
    prepared: Vec<PreparedRow>,
    refused: Vec<RefusedEpisode>,
    history: HistoryRepairs,
}

/// Writes the examples of the chosen episodes, and says what is in the dataset.
pub(crate) fn write(
    store: &Store,
    out: &Path,
    options: &ExportOptions,
    places: &HashMap<&str, SplitAssignment<'_>>,
    progress: Progress<'_>,
    report: &mut ExportReport,
) -> Result<Manifest, ExportError> {
    let known_images = ImageIndex::open(out, options)?;
    let mut writer = match &options.tokenizer {
        Some(path) => {
            DatasetWriter::with_tokenizer(out, options.writer, Box::new(TokenizerFile::open(path)?))
        }
        None => DatasetWriter::new(out, options.writer),
    };
    writer.images().sweep()?;
    let mut parquet: BTreeMap<Split, parquet::Shards> = BTreeMap::new();
    let mut known = TaskIndex::new(store, Arc::clone(&options.prompt))?;
    let mut task_ids = BTreeSet::new();
    let mut failed = None;
    store.read(
        Table::Episodes,
        &columns(options.words, options.rollouts.is_some()),
        |batch| {
            if failed.is_some() {
                return Ok(());
            }
            let rows: Vec<EpisodeRow<'_>> = reel_tables::rows_from(&batch)?;
            let wanted: Vec<(&EpisodeRow<'_>, SplitAssignment<'_>)> = rows
                .iter()
                .filter_map(|row| Some((row, *places.get(row.episode_id)?)))
                .collect();
            let mut write_rows = || -> Result<(), ExportError> {
                for portion in wanted.chunks(EPISODES_AT_A_TIME) {
                    known.learn(portion.iter().map(|(row, _)| *row))?;
                    let maker = RowBuilder {
                        options,
                        writer: &writer,
                        images: &known_images,
                        known: &known,
                        files: store.trace_files(),
                        table_version: store.version(),
                    };
                    let make = |(row, place): &(&EpisodeRow<'_>, SplitAssignment<'_>)| {
                        let made = maker.make(row, *place);
                        progress(1);
                        made
                    };
                    let made: Vec<Result<EpisodeRows, ExportError>> =
                        portion.par_iter().map(make).collect();
                    for ((_, (candidate, split)), made) in portion.iter().zip(made) {
                        let EpisodeRows {
                            examples,
                            prepared,
                            refused,
                            history,
                        } = made?;
                        writer.push(&examples, &prepared)?;
                        report.episodes += u64::from(!examples.is_empty());
                        if options.rollouts.is_some() {
                            task_ids.extend(
                                examples
                                    .first()
                                    .map(|example| example.about.task_id.clone()),
                            );
                        }
                        report.unverified += if candidate.verified {
                            0
                        } else {
                            examples.len() as u64
                        };
                        report.history.corrected += history.corrected;
                        report.history.dropped += history.dropped;
                        report.refused.extend(refused);
                        if options.writer.format == Format::Parquet {
                            let shards = parquet.entry(*split).or_insert_with(|| {
                                parquet::Shards::new(out, *split, options.writer.rows_max)
                            });
                            shards.push(examples, writer.images())?;
                        }
                    }
                }
                Ok(())
            };
            failed = write_rows().err();
            Ok(())
        },
    )?;
    if let Some(error) = failed {
        return Err(error);
    }
    for (split, shards) in parquet {
        shards
            .finish(writer.images())?
            .into_iter()
            .for_each(|shard| writer.add_shard(split, shard));
    }
    report
        .excluded
        .iter()
        .for_each(|(reason, count)| writer.count_skipped(reason, *count));
    if !report.refused.is_empty() {
        writer.count_skipped(REFUSED, report.refused.len() as u64);
    }
    report.images = writer.images().count();
    if options.rollouts.is_some() {
        let path = out.join(TASK_LIST);
        fs::write(&path, task_list(task_ids.iter().map(String::as_str)))
            .map_err(|source| ExportError::Io { source, path })?;
    }
    let description = Description {
        name: options.name.clone(),
        style: options.style,
        prompt: Arc::clone(&options.prompt),
        command: options.command.clone(),
        options: serde_json::to_value(options).expect("plain data becomes JSON"),
        table_version: store.version(),
        licence: options.licence.clone(),
    };
    let manifest = writer.finish(description)?;
    let counted = |reason: &str| reason == REFUSED || report.excluded.contains_key(reason);
    let unwritable = manifest.excluded.iter();
    report.unwritable = unwritable
        .filter(|(reason, _)| !counted(reason))
        .map(|(reason, count)| (reason.clone(), *count))
        .collect();
    // Last: until here the next run goes on.
    known_images.remove()?;
    Ok(manifest)
}

/// Why episodes and decisions are not in the dataset whose reasons the command prints one by one.
const REFUSED: &str = "episodes and decisions refused";

/// Makes the rows of episodes.
struct RowBuilder<'m> {
    options: &'m ExportOptions,
    writer: &'m DatasetWriter,
    images: &'m ImageIndex,
    known: &'m TaskIndex,
    files: &'m TraceFiles,
    table_version: u64,
}

impl RowBuilder<'_> {
    fn make(
        &self,
        row: &EpisodeRow<'_>,
        (candidate, split): SplitAssignment<'_>,
    ) -> Result<EpisodeRows, ExportError> {
        let (options, known) = (self.options, self.known.task_of(row));
        let mut made = EpisodeRows {
            examples: Vec::new(),
            prepared: Vec::new(),
            refused: Vec::new(),
            history: HistoryRepairs::default(),
        };
        let has_own_tools = row.has_own_tools();
        // Reel's annotator knows REAL's tools only.
        let words = match has_own_tools {
            true => AnnotationSource::Recorded,
            false => options.words.of(|| row.has_policy_text()),
        };
        let mends = words == AnnotationSource::Recorded
            && options.rollouts.is_none()
            && !has_own_tools
            && candidate.contradicts;
        let trace = match (options.images || mends || has_own_tools)
            .then(|| self.files.read(Path::new(row.trace)))
            .transpose()
        {
            Ok(trace) => trace,
            Err(error) => {
                made.refused
                    .push(candidate.refusal(None, error.to_string()));
                return Ok(made);
            }
        };
        let (mut notes, annotator) = match row.notes(words, known, options.selection.seed) {
            Ok(notes) => notes,
            Err(error) => {
                made.refused
                    .push(candidate.refusal(None, error.to_string()));
                return Ok(made);
            }
        };
        if let Some(trace) = trace.as_ref().filter(|_| mends) {
            made.history = repair_histories(&mut notes, trace);
        }
        // What a policy is rewarded for is what it said, and its next prompt remembers that. An answer
        // that holds no call stays in any words: the next prompt quotes it.
        let single = options.style == Style::SingleTurn;
        let as_they_came = words == AnnotationSource::Recorded
            && options.rollouts.is_some()
            && single
            && row.answers_hold_calls();
        let mut steps = row.decisions();
        for (step, note) in steps.iter_mut().zip(notes) {
            (step.reasoning, step.history) = (note.reasoning, note.history);
            (step.schedule, step.subtask) = (note.schedule, note.subtask);
            step.held = row
                .held_after(step.call)
                .and_then(|instance| known.object(instance))
                .map(|object| object.category.clone());
            step.message = (has_own_tools.then(|| row.message_of(step.call)).flatten())
                .unwrap_or_default()
                .to_owned();
            step.answer = (as_they_came || (single && step.call_name.is_empty()))
                .then(|| row.answer(step.call).map(str::to_owned))
                .flatten();
            step.learn = candidate
                .decisions
                .iter()
                .any(|decision| decision.call == step.call);
            step.rollout = candidate
                .worth
                .as_ref()
                .and_then(|worth| row.rollout(worth, step.call));
        }
        // Images are drawn by executing, and of other worlds nothing can be executed.
        if let Some(trace) = trace.as_ref().filter(|_| options.images && !has_own_tools) {
            // the first single turn of an episode shows no image, as with REAL's trainer
            let shows = |(index, step): (usize, &Step)| {
                options.style != Style::SingleTurn || (step.learn && index > 0)
            };
            let moments: Vec<Option<FrameIndex>> = steps
                .iter()
                .enumerate()
                .map(|at| {
                    let keep = options.prompt.memory().keep_view;
                    frame_before(trace, at.1.call, keep).filter(|_| shows(at))
                })
                .collect();
            let wanted = moments.iter().flatten().copied().collect();
            let shown =
                match self
                    .images
                    .put(trace, row.trace_digest, &wanted, self.writer.images())?
                {
                    Ok(shown) => shown,
                    Err(reason) => {
                        made.refused.push(candidate.refusal(None, reason));
                        return Ok(made);
                    }
                };
            for (step, moment) in steps.iter_mut().zip(&moments) {
                step.images = moment
                    .iter()
                    .filter_map(|moment| shown.get(moment))
                    .copied()
                    .collect();
            }
        }
        let episode = Episode {
            episode_id: row.episode_id.to_owned(),
            task_id: row.task_id.to_owned(),
            family: row.family.to_owned(),
            scene_id: row.scene_id.to_owned(),
            policy: row.policy.to_owned(),
            split,
            briefing: Arc::clone(&known.briefing),
            names: Profile::parse(row.profile).map_or(NameSet::Paper, Profile::names),
            agent: trace.as_ref().filter(|_| has_own_tools).map(agent_setup),
            steps,
            source: self.source(row, candidate, annotator),
        };
        let how = ExampleOptions {
            style: options.style,
            failed_calls: options.selection.mistakes,
        };
        let result = examples(&episode, &how);
        let refused = result.refused.into_iter();
        made.refused.extend(
            refused.map(|refused| candidate.refusal(refused.call, refused.reason.to_string())),
        );
        made.prepared = self.writer.prepare(&result.examples)?;
        made.examples = result.examples;
        Ok(made)
    }

    fn source(&self, row: &EpisodeRow<'_>, candidate: &Candidate, annotator: String) -> Source {
        let verified = candidate.verified;
        let preset = self
            .options
            .rollouts
            .as_ref()
            .and_then(|how| how.preset.as_ref());
        Source {
            trace_digest: row.trace_digest.to_owned(),
            trace_uri: trace_uri(row.trace, self.options.trace_base.as_deref()),
            verdict: if verified {
                Comparison::of(self.options).exact
            } else {
                "unverified"
            }
            .into(),
            verdict_sim_version: if verified {
                reel_replay::SIM_VERSION.to_string()
            } else {
                String::new()
            },
            preset: preset.map_or(row.preset, Preset::name).to_owned(),
            preset_digest: preset.map_or_else(
                || self.known.preset_digest_of(row).to_owned(),
                |preset| preset.version().to_string(),
            ),
            rules_version: candidate
                .rules_version
                .as_deref()
                .unwrap_or_default()
                .to_owned(),
            table_version: self.table_version,
            annotator,
        }
    }
}

/// What an agent with tools of its own was told, from the parameters of its policy.
fn agent_setup(trace: &Trace) -> AgentSetup {
    let parameters = &trace.header.policy.parameters;
    AgentSetup {
        system: parameters
            .get("system_prompt")
            .and_then(|prompt| Some(prompt.as_str()?.to_owned())),
        tools: parameters
            .get("tools")
            .filter(|tools| tools.is_array())
            .map(ToString::to_string),
    }
}

/// When an image was taken: after a call; none: before the first.
type FrameIndex = Option<u32>;

/// The image that the agent has before a call: of the result of the call before, or of the start.
/// With `keep` the latest one, if that result had none.
fn frame_before(trace: &Trace, call: u32, keep: bool) -> Option<FrameIndex> {
    let earlier = trace.steps.iter().rev().filter(|record| record.step < call);
    let results = earlier
        .map(|record| (Some(record.step), record.digests.frame.is_some()))
        .chain([(None, true)]);
    let considered = if keep { usize::MAX } else { 1 };
    results
        .take(considered)
        .find_map(|(moment, has_frame)| has_frame.then_some(moment))
}

/// Which images are in the folder already, in a file beside them that is there as long as the
/// dataset is not whole.
struct ImageIndex {
    path: PathBuf,
    known: HashMap<(String, FrameIndex), (ImageId, StoredImage)>,
    file: Mutex<File>,
}

/// A line of that file.
#[derive(Serialize, Deserialize)]
struct ImageIndexLine {
    trace: String,
    moment: FrameIndex,
    image: ImageId,
    stored: StoredImage,
}

impl ImageIndex {
    /// Makes the folder ready: what is left of a run that was broken off, or of the same
    /// dataset, is taken up.
    fn open(out: &Path, options: &ExportOptions) -> Result<Self, ExportError> {
        let io_error = |source| ExportError::Io {
            source,
            path: out.to_path_buf(),
        };
        fs::create_dir_all(out).map_err(io_error)?;
        let path = out.join(UNFINISHED);
        let how = serde_json::to_string(&options.writer.images).expect("plain data becomes JSON");
        let mut known = HashMap::new();
        let mut lines = match File::open(&path) {
            Ok(file) => BufReader::new(file).lines(),
            Err(_) => {
                if fs::read_dir(out).map_err(io_error)?.next().is_some() {
                    return Err(ExportError::OtherDataset {
                        path: out.to_path_buf(),
                    });
                }
                BufReader::new(File::create_new(&path).map_err(io_error)?).lines()
            }
        };
        let same = lines
            .next()
            .transpose()
            .map_err(io_error)?
            .is_some_and(|first| first == how);
        // the last line may be torn
        for line in lines.map_while(Result::ok).filter(|_| same) {
            if let Ok(ImageIndexLine {
                trace,
                moment,
                image,
                stored,
            }) = serde_json::from_str(&line)
            {
                known.insert((trace, moment), (image, stored));
            }
        }
        let rewrite = || -> io::Result<File> {
            let mut file = File::create(&path)?;
            writeln!(file, "{how}")?;
            for ((trace, moment), (image, stored)) in &known {
                let line = ImageIndexLine {
                    trace: trace.clone(),
                    moment: *moment,
                    image: *image,
                    stored: stored.clone(),
                };
                writeln!(file, "{}", serde_json::to_string(&line)?)?;
            }
            for split in Split::ALL {
                match fs::remove_dir_all(out.join(split.as_str())) {
                    Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                    _ => {}
                }
            }
            Ok(file)
        };
        let file = Mutex::new(rewrite().map_err(io_error)?);
        Ok(Self { path, known, file })
    }

    /// Sees that the images of these moments are in the dataset; gives them, or
    /// why there are none.
    fn put(
        &self,
        trace: &Trace,
        digest: &str,
        moments: &BTreeSet<FrameIndex>,
        store: &ImageStore,
    ) -> Result<Result<BTreeMap<FrameIndex, ImageId>, String>, ExportError> {
        let mut shown = BTreeMap::new();
        let mut missing = BTreeSet::new();
        for moment in moments {
            match self.known.get(&(digest.to_owned(), *moment)) {
                Some((image, stored)) if store.reuse(*image, stored) => {
                    shown.insert(*moment, *image);
                }
                _ => {
                    missing.insert(*moment);
                }
            }
        }
        let frames = match reel_replay::frames_at(trace, &missing) {
            Ok(frames) => frames,
            Err(verdict) => return Ok(Err(verdict.to_string())),
        };
        for (moment, rgb) in frames {
            let image = Digest::of(&rgb);
            let stored = store.put(image, &rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32)?;
            let line = ImageIndexLine {
                trace: digest.to_owned(),
                moment,
                image,
                stored,
            };
            let line = serde_json::to_string(&line).expect("plain data becomes JSON") + "\n";
            let mut file = self
                .file
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            file.write_all(line.as_bytes())
                .map_err(|source| ExportError::Io {
                    source,
                    path: self.path.clone(),
                })?;
            shown.insert(moment, image);
        }
        Ok(Ok(shown))
    }

    /// The dataset is whole.
    fn remove(self) -> Result<(), ExportError> {
        fs::remove_file(&self.path).map_err(|source| ExportError::Io {
            source,
            path: self.path,
        })
    }
}

/// How rows name a trace: by the path from the base folder where it lies below it, else as the
/// store has it.
fn trace_uri(trace: &str, base: Option<&Path>) -> String {
    let below = base
        .filter(|base| base.parent().is_some())
        .and_then(|base| Path::new(trace).strip_prefix(base).ok());
    let Some(below) = below else {
        return trace.to_owned();
    };
    let parts: Vec<_> = below
        .components()
        .map(|part| part.as_os_str().to_string_lossy())
        .collect();
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn traces_below_the_base_are_named_from_there() {
        let base = Some(Path::new("/a/b"));
        assert_eq!(trace_uri("/a/b/traces/x.mcap", base), "traces/x.mcap");
        for trace in ["/a/bc/x.mcap", "s3://a/b/x.mcap", "traces/x.mcap"] {
            assert_eq!(trace_uri(trace, base), trace);
            assert_eq!(trace_uri(trace, None), trace);
            assert_eq!(trace_uri(trace, Some(Path::new("/"))), trace);
        }
    }
}
