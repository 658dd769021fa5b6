//! Recordings of robots (MCAP files, folders of rosbag2) as traces, by a mapping of their topics.
//! Reads what can be read: a torn file, a damaged chunk or a message that says nothing is a loss
//! that is named, and the rest is imported.
//!
//! A recording is read twice: what was said first, and then the images that are wanted, so that
//! memory holds no film.

mod align;
mod assemble;
mod bag;
mod decode;
mod event;
mod image;
mod mapping;
mod source;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use reel_trace::{Images, Recorder, robot::CameraImage};
use reel_world::{Frame, FrameDigests};
use serde::Serialize;
use serde_json::Value;

pub use image::camera_image;
pub use mapping::Mapping;

use self::{
    assemble::{AssembledEpisode, ImageLocation},
    decode::Decoders,
    event::{Event, EventPayload},
    mapping::{Clock, HEAD, Kind},
};
use crate::{ImportError, ImportLoss, ImportOptions, ImportedEpisode, episode};

/// A recording that was imported.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Recording {
    /// The file or folder.
    pub source: PathBuf,
    /// Its episodes, in order.
    pub episodes: Vec<ImportedEpisode>,
    /// What of it could not be read.
    pub losses: Vec<ImportLoss>,
    /// What it leaves open.
    pub notes: Vec<String>,
}

/// The recordings under a path, sorted: the file or folder itself, or what lies in the folder.
///
/// # Errors
/// When a folder cannot be listed, or there is none.
pub fn recordings(root: &Path) -> Result<Vec<PathBuf>, ImportError> {
    source::recordings(root)
}

/// Writes the episodes of a recording as traces into the folder `out`, which exists. Equal
/// recordings give equal bytes under equal names, wherever they lie.
///
/// # Errors
/// When no episode is in it, or a trace cannot be written.
pub fn import(
    recording: &Path,
    mapping: &Mapping,
    out: &Path,
    options: &ImportOptions<'_>,
) -> Result<Recording, ImportError> {
    let files = source::files(recording)?;
    let mut reading = Reading {
        mapping,
        paths: files.paths,
        garbled: BTreeMap::new(),
        topics: BTreeSet::new(),
    };
    let (events, mut losses) = reading.events();
    losses.splice(0..0, files.losses);
    let mut notes = files.notes;
    reading.note_topics(&mut notes);
    let mut played = assemble::episodes(events, mapping);
    if played.is_empty() {
        let read: Vec<String> = losses
            .into_iter()
            .chain(reading.garbled())
            .map(|loss| loss.to_string())
            .collect();
        let what = match (read.is_empty(), reading.topics.is_empty()) {
            (false, _) => read.join("; "),
            (true, true) => "it holds no message".to_owned(),
            (true, false) => {
                let topics: Vec<&str> = reading.topics.iter().map(String::as_str).collect();
                format!(
                    "nothing of what the mapping names is a call or a primitive; its topics are {}",
                    topics.join(", ")
                )
            }
        };
        return Err(ImportError::Empty {
            path: recording.to_owned(),
            reason: what,
        });
    }
    for (ns, what) in played.iter_mut().flat_map(|playing| playing.lost()) {
        losses.push(ImportLoss {
            file: recording.to_owned(),
            message: format!("{what}, at {}", seconds(ns)),
        });
    }
    let wanted: BTreeSet<ImageLocation> =
        played.iter().flat_map(|playing| playing.images()).collect();
    let images = reading.images(&wanted);
    losses.extend(reading.garbled());

    let mut episodes = Vec::new();
    for playing in played {
        let recorded = playing.finish(mapping, options, recording, &|place| {
            Some(images.get(&place)?.digests)
        });
        episodes.push(write(recorded, recording, out, &images)?);
    }
    Ok(Recording {
        source: recording.to_owned(),
        episodes,
        losses,
        notes,
    })
}

/// Writes one episode of a recording as a trace into the folder `out`.
fn write(
    recorded: AssembledEpisode,
    source: &Path,
    out: &Path,
    images: &DecodedImages,
) -> Result<ImportedEpisode, ImportError> {
    let trace = out.join(format!("{}.mcap", episode::file_stem(&recorded.header)));
    let mut recorder = Recorder::create(
        &trace,
        &recorded.header,
        &recorded.task,
        &recorded.scene,
        Images::Full,
    )?;
    let mut shown = 0;
    let mut show = |recorder: &mut Recorder,
                    step: Option<u32>,
                    place: Option<ImageLocation>|
     -> Result<Option<Frame>, ImportError> {
        let Some(DecodedImage { image, .. }) = place.and_then(|place| images.get(&place)) else {
            return Ok(None);
        };
        let (frame, whole) = image::frame(image).expect("it was read before");
        if !whole {
            recorder.original(step, image)?;
        }
        shown += 1;
        Ok(Some(frame))
    };
    recorder.robot(None, &recorded.log)?;
    let frame = show(&mut recorder, None, recorded.start_image)?;
    recorder.start(&recorded.start, frame.as_ref())?;
    for (record, timing, place) in &recorded.steps {
        recorder.input(record.step, &record.input)?;
        if let Some(timing) = timing {
            recorder.timing(record.step, timing)?;
        }
        recorder.robot(Some(record.step), &recorded.log)?;
        let frame = show(&mut recorder, Some(record.step), *place)?;
        recorder.step(record, frame.as_ref())?;
    }
    let summary = recorder.end(&recorded.end)?;
    Ok(ImportedEpisode {
        source: source.to_owned(),
        trace,
        bytes: summary.bytes,
        task_id: recorded.task.task_id,
        steps: recorded.end.steps,
        images: shown,
        end: recorded.end.reason,
        success: recorded.end.metrics.success,
        losses: Vec::new(),
        notes: recorded.notes,
    })
}

/// The images that are wanted, as files: pixels take ten times the memory.
type DecodedImages = BTreeMap<ImageLocation, DecodedImage>;

struct DecodedImage {
    image: CameraImage,
    /// Of the pixels that the trace holds.
    digests: FrameDigests,
}

impl DecodedImage {
    fn of_message(message: &Value, pointer: &str) -> Result<Self, String> {
        let image = image::of_message(message, pointer)?;
        let (frame, _) = image::frame(&image)?;
        Ok(Self {
            image,
            digests: frame.digests(),
        })
    }
}

/// A recording while it is read.
struct Reading<'a> {
    mapping: &'a Mapping,
    paths: Vec<PathBuf>,
    /// Messages that could not be read, by file and topic: how many, when the first, and why.
    garbled: BTreeMap<(PathBuf, String), (u64, u64, String)>,
    /// Every topic with a message.
    topics: BTreeSet<String>,
}

impl Reading<'_> {
    /// Everything that the messages say but images, in the order of time.
    fn events(&mut self) -> (Vec<Event>, Vec<ImportLoss>) {
        let (mut events, mut losses) = (Vec::new(), Vec::new());
        for (file, path) in (0..).zip(self.paths.clone()) {
            let mut decoders = Decoders::default();
            let lost = bag::walk(&path, &mut |message| {
                let topic = &message.channel.topic;
                if !self.topics.contains(topic) {
                    self.topics.insert(topic.clone());
                }
                let Some(entries) = self.mapping.topics.get(topic) else {
                    return;
                };
                let ns = self.ns(&message);
                let (cameras, others): (Vec<_>, Vec<_>) =
                    entries.iter().partition(|entry| entry.kind == Kind::Camera);
                if cameras
                    .iter()
                    .any(|entry| entry.name.as_deref().unwrap_or(HEAD) == HEAD)
                {
                    events.push(Event {
                        ns,
                        payload: EventPayload::Image([file, message.number]),
                    });
                }
                if others.is_empty() {
                    return;
                }
                let read = decoders
                    .decode(message.channel, message.data)
                    .and_then(|value| {
                        // What one of several things finds nothing of is not said in this message.
                        let all = others
                            .iter()
                            .map(|entry| event::read(entry, self.mapping, ns, &value));
                        let (said, unsaid): (Vec<_>, Vec<_>) = all.partition(Result::is_ok);
                        let said: Vec<EventPayload> = said.into_iter().flatten().collect();
                        match unsaid
                            .into_iter()
                            .find_map(Result::err)
                            .filter(|_| said.is_empty())
                        {
                            Some(why) => Err(why),
                            None => Ok(said),
                        }
                    });
                match read {
                    Ok(said) => {
                        events.extend(said.into_iter().map(|what| Event { ns, payload: what }))
                    }
                    Err(why) => self.garble(&path, topic, ns, why),
                }
            });
            losses.extend(lost.into_iter().map(|message| ImportLoss {
                file: path.clone(),
                message,
            }));
        }
        events.sort_by_key(|event| event.ns);
        (events, losses)
    }

    /// The images at these places.
    fn images(&mut self, wanted: &BTreeSet<ImageLocation>) -> DecodedImages {
        let mut images = BTreeMap::new();
        let files: BTreeSet<u64> = wanted.iter().map(|[file, _]| *file).collect();
        for file in files {
            let path = self.paths[file as usize].clone();
            let mut decoders = Decoders::default();
            // What cannot be read was said before.
            bag::walk(&path, &mut |message| {
                let place = [file, message.number];
                let topic = &message.channel.topic;
                let entry =
                    self.mapping.topics.get(topic).and_then(|entries| {
                        entries.iter().find(|entry| entry.kind == Kind::Camera)
                    });
                let Some(entry) = entry.filter(|_| wanted.contains(&place)) else {
                    return;
                };
                let pointer = entry.places("data")[0];
                let read = decoders
                    .decode(message.channel, message.data)
                    .and_then(|value| DecodedImage::of_message(&value, pointer));
                match read {
                    Ok(image) => drop(images.insert(place, image)),
                    Err(why) => self.garble(&path, topic, self.ns(&message), why),
                }
            });
        }
        images
    }

    fn ns(&self, message: &bag::Message<'_>) -> u64 {
        match self.mapping.clock {
            Clock::Log => message.log_ns,
            Clock::Publish => message.publish_ns,
        }
    }

    fn garble(&mut self, path: &Path, topic: &str, ns: u64, why: String) {
        let (count, ..) = self
            .garbled
            .entry((path.to_owned(), topic.to_owned()))
            .or_insert((0, ns, why));
        *count += 1;
    }

    fn garbled(&self) -> Vec<ImportLoss> {
        let loss = |((file, topic), (count, ns, why)): (
            &(PathBuf, String),
            &(u64, u64, String),
        )| ImportLoss {
            file: file.clone(),
            message: format!(
                "{count} of the messages on {topic} cannot be read and are left out, the first at {} ({why})",
                seconds(*ns)
            ),
        };
        self.garbled.iter().map(loss).collect()
    }

    /// What the mapping names in vain, and what it names and is not kept.
    fn note_topics(&self, notes: &mut Vec<String>) {
        for (topic, entries) in &self.mapping.topics {
            if !self.topics.contains(topic) {
                notes.push(format!("no message on {topic}"));
            } else if let Some(camera) = entries
                .iter()
                .find_map(|entry| entry.name.as_deref())
                .filter(|name| *name != HEAD)
            {
                notes.push(format!(
                    "images of the camera {camera} on {topic} are dropped; those of {HEAD} are kept"
                ));
            }
        }
    }
}

/// A moment, in seconds since 1970.
pub(crate) fn seconds(ns: u64) -> String {
    format!("{}.{:09} s", ns / 1_000_000_000, ns % 1_000_000_000)
}
