//! Files and requests of spans are found and read, divided into episodes and written as traces.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Read as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_otlp::{ExportTraceServiceRequest, decode, gunzip, is_document};

use super::{
    convention::{self, Role, SpanFacts},
    conversation::conversation,
};
use crate::{
    ImportError, ImportLoss, ImportOptions, ImportedEpisode, SuccessRule,
    atif::{Episode, read_file},
    layout::files_below,
};

/// Largest file that is read, compressed or not.
const BYTES_MAX: u64 = 1 << 30;
/// Most spans that are read at once.
const SPANS_MAX: usize = 5_000_000;
/// How many spans around one are searched for a conversation; ids of broken exporters may go in a circle.
const DEPTH_MAX: usize = 256;
/// How much of a file is read to see whether it is one of spans.
const BEGINNING: u64 = 64 << 10;

/// The files of spans under a folder, or the file itself: OTLP/JSON (`.json`, `.jsonl`, `.ndjson`) and protobuf (`.pb`,
/// `.binpb`, `.otlp`), each of them also with `.gz`.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn documents(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let found = files_below(root, is_of_spans)?;
    if found.is_empty() {
        return Err(ImportError::NoSpans {
            root: root.to_owned(),
        });
    }
    Ok(found)
}

fn is_of_spans(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let plain = name.strip_suffix(".gz").unwrap_or(&name);
    let Some((_, extension)) = plain.rsplit_once('.') else {
        return false;
    };
    if plain.len() < name.len() {
        // What is in it is seen when it is read.
        return is_document(extension, br#""resourceSpans""#);
    }
    let mut beginning = Vec::new();
    let read =
        fs::File::open(path).and_then(|file| file.take(BEGINNING).read_to_end(&mut beginning));
    read.is_ok() && is_document(extension, &beginning)
}

/// Spans of files, divided into episodes.
#[derive(Debug, Default)]
pub struct SpanFiles {
    /// In the order of their first spans.
    pub episodes: Vec<SpanEpisode>,
    /// What could not be read.
    pub losses: Vec<ImportLoss>,
    /// How many traces and conversations have no span of an agent, a response or a tool.
    pub without_agent: usize,
}

/// The spans of one episode.
#[derive(Debug)]
pub struct SpanEpisode {
    /// The file that its first span is from.
    pub source: PathBuf,
    /// The conversation's id, else the trace's.
    pub id: String,
    spans: Vec<SpanFacts>,
}

/// Reads files of spans. What one trace or conversation has in several files is one episode.
///
/// # Errors
/// When nothing can be read, or they hold more spans than are read at once.
pub fn read(files: &[PathBuf]) -> Result<SpanFiles, ImportError> {
    let mut division = Division::default();
    for file in files {
        let bytes = read_file(file, BYTES_MAX)
            .and_then(|bytes| gunzip(bytes, BYTES_MAX).map_err(|error| error.to_string()));
        let (requests, broken) = match bytes {
            Ok(bytes) => {
                let (requests, error) = decode(&bytes);
                (requests, error.map(|error| error.to_string()))
            }
            Err(reason) => (Vec::new(), Some(reason)),
        };
        division.add(file, requests)?;
        if let Some(message) = broken {
            division.losses.push(ImportLoss {
                file: file.clone(),
                message,
            });
        }
    }
    let divided = division.finish();
    match divided.losses.first() {
        Some(loss) if divided.episodes.is_empty() && divided.without_agent == 0 => {
            Err(ImportError::Storage {
                path: loss.file.clone(),
                reason: loss.message.clone(),
            })
        }
        _ => Ok(divided),
    }
}

/// Divides the spans of requests into episodes; `source` is told as the place that they are from.
///
/// # Errors
/// When they hold more spans than are read at once.
pub fn read_requests(
    source: &Path,
    requests: Vec<ExportTraceServiceRequest>,
) -> Result<SpanFiles, ImportError> {
    let mut division = Division::default();
    division.add(source, requests)?;
    Ok(division.finish())
}

/// Spans on their way to episodes.
#[derive(Default)]
struct Division {
    /// With the file that each is from.
    spans: Vec<(usize, SpanFacts)>,
    files: Vec<PathBuf>,
    known: BTreeSet<(Vec<u8>, Vec<u8>)>,
    losses: Vec<ImportLoss>,
}

impl Division {
    fn add(
        &mut self,
        file: &Path,
        requests: Vec<ExportTraceServiceRequest>,
    ) -> Result<(), ImportError> {
        let at = self.files.len();
        self.files.push(file.to_owned());
        let mut without_id = 0;
        for of_resource in requests
            .into_iter()
            .flat_map(|request| request.resource_spans)
        {
            let resource = of_resource.resource.unwrap_or_default();
            let resource = Arc::new(convention::by_name(&resource.attributes));
            for span in of_resource
                .scope_spans
                .into_iter()
                .flat_map(|scope| scope.spans)
            {
                if span.trace_id.iter().all(|byte| *byte == 0) || span.span_id.is_empty() {
                    without_id += 1;
                    continue;
                }
                // Exporters may send a span again.
                if !self
                    .known
                    .insert((span.trace_id.clone(), span.span_id.clone()))
                {
                    continue;
                }
                if self.spans.len() >= SPANS_MAX {
                    return Err(ImportError::Storage {
                        path: file.to_owned(),
                        reason: format!(
                            "more than {SPANS_MAX} spans, which are read at once; import the files in parts"
                        ),
                    });
                }
                self.spans
                    .push((at, SpanFacts::new(span, Arc::clone(&resource))));
            }
        }
        if without_id > 0 {
            self.losses.push(ImportLoss {
                file: file.to_owned(),
                message: format!("{without_id} spans without an id are left out"),
            });
        }
        Ok(())
    }

    fn finish(self) -> SpanFiles {
        let Self {
            spans,
            files,
            losses,
            ..
        } = self;
        let ids = episode_ids(&spans);
        let mut order: Vec<usize> = (0..spans.len()).collect();
        // Spans come when they end.
        order.sort_by_key(|at| {
            let span = &spans[*at].1.span;
            (
                span.start_time_unix_nano,
                std::cmp::Reverse(span.end_time_unix_nano),
            )
        });
        let mut spans: Vec<Option<(usize, SpanFacts)>> = spans.into_iter().map(Some).collect();
        let mut by_id: BTreeMap<&str, usize> = BTreeMap::new();
        let mut episodes: Vec<SpanEpisode> = Vec::new();
        for at in order {
            let Some((file, facts)) = spans[at].take() else {
                continue;
            };
            let id = ids[at].as_str();
            let number = *by_id.entry(id).or_insert_with(|| {
                episodes.push(SpanEpisode {
                    source: files[file].clone(),
                    id: id.to_owned(),
                    spans: Vec::new(),
                });
                episodes.len() - 1
            });
            episodes[number].spans.push(facts);
        }
        let found = episodes.len();
        episodes.retain(|episode| episode.spans.iter().any(|span| span.role != Role::Other));
        SpanFiles {
            without_agent: found - episodes.len(),
            episodes,
            losses,
        }
    }
}

/// The episode of each span: the conversation that it names, else that of the nearest span around it that names one,
/// else the only one of its trace, else its trace.
fn episode_ids(spans: &[(usize, SpanFacts)]) -> Vec<String> {
    let by_id: BTreeMap<(&[u8], &[u8]), usize> = spans
        .iter()
        .enumerate()
        .map(|(at, (_, facts))| ((&facts.span.trace_id[..], &facts.span.span_id[..]), at))
        .collect();
    let own: Vec<Option<String>> = spans
        .iter()
        .map(|(_, facts)| facts.conversation())
        .collect();
    let mut of_trace: BTreeMap<&[u8], BTreeSet<&str>> = BTreeMap::new();
    for ((_, facts), own) in spans.iter().zip(&own) {
        let names = of_trace.entry(&facts.span.trace_id).or_default();
        names.extend(own.as_deref());
    }
    let inherited = |at: usize| -> Option<&str> {
        let mut at = at;
        for _ in 0..DEPTH_MAX {
            if let Some(name) = &own[at] {
                return Some(name);
            }
            let span = &spans[at].1.span;
            at = *by_id.get(&(&span.trace_id[..], &span.parent_span_id[..]))?;
        }
        None
    };
    let only = |trace: &[u8]| -> Option<&str> {
        let names = of_trace.get(trace)?;
        names.first().copied().filter(|_| names.len() == 1)
    };
    (0..spans.len())
        .map(|at| {
            let trace = &spans[at].1.span.trace_id;
            let name = inherited(at).or_else(|| only(trace));
            name.map_or_else(|| reel_otlp::to_hex(trace), str::to_owned)
        })
        .collect()
}

/// Writes the episode of spans as a trace into the folder `out`, which exists. Equal spans give equal bytes under an
/// equal name. `rule` says which score is success; `task` names the attribute that says which task it was.
///
/// # Errors
/// When nothing was done in it, or the trace cannot be written.
pub fn import(
    told: &SpanEpisode,
    out: &Path,
    options: &ImportOptions<'_>,
    rule: Option<&SuccessRule>,
    task: Option<&str>,
) -> Result<ImportedEpisode, ImportError> {
    let read = conversation(&told.id, &told.spans, rule, task);
    let mut episode = Episode::new(&told.source, options, read.facts);
    read.left_out
        .into_iter()
        .for_each(|what| episode.lose(what));
    read.notes.into_iter().for_each(|what| episode.note(what));
    episode.write(read.trajectory, out)
}
