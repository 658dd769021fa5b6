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
mod sensors;
mod source;
mod trajectory;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use reel_trace::{Images, Recorder, robot::CameraImage, sensors::SensorChannel};
use reel_world::{Frame, FrameDigests};
use serde::Serialize;
use serde_json::Value;

pub use image::camera_image;
pub use mapping::Mapping;
pub use sensors::camera_frames;

use self::{
    assemble::{AssembledEpisode, ImageLocation},
    decode::Decoders,
    event::{Event, EventPayload, SensorEvent},
    mapping::{Clock, Entry, HEAD, Kind},
    sensors::{SensorMessages, SensorSource},
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
        sources: sensors::sources(mapping),
        paths: files.paths,
        garbled: BTreeMap::new(),
        topics: BTreeSet::new(),
    };
    let (events, mut losses) = reading.events();
    losses.splice(0..0, files.losses);
    let mut notes = files.notes;
    reading.note_topics(&mut notes);
    let mut played = assemble::episodes(events, mapping, &reading.sources);
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
    let wanted = WantedMessages {
        images: played.iter().flat_map(|playing| playing.images()).collect(),
        sensors: played
            .iter()
            .flat_map(|playing| playing.sensors())
            .map(|kept| (kept.place, kept.source))
            .collect(),
    };
    let (images, kept) = reading.messages(&wanted);
    losses.extend(reading.garbled());
    losses.extend(kept.excess().map(|message| ImportLoss {
        file: recording.to_owned(),
        message,
    }));

    let mut episodes = Vec::new();
    let lost: Vec<&str> = losses.iter().map(|loss| loss.message.as_str()).collect();
    for playing in played {
        let recorded = playing.finish(mapping, options, (recording, &lost), &|place| {
            Some(images.get(&place)?.digests)
        });
        let sensors = kept.channels(&recorded.sensors, &reading.sources, recorded.began_ns);
        episodes.push(write(recorded, recording, out, &images, &sensors)?);
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
    sensors: &[SensorChannel],
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
    recorder.sensors(sensors)?;
    let summary = recorder.end(&recorded.end)?;
    Ok(ImportedEpisode {
        source: source.to_owned(),
        trace,
        bytes: summary.bytes,
        success: recorded.end.success(&recorded.task),
        task_id: recorded.task.task_id,
        steps: recorded.end.steps,
        images: shown,
        end: recorded.end.reason,
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

/// What is read again for the traces, by where it stands.
struct WantedMessages {
    images: BTreeSet<ImageLocation>,
    /// With the source of each.
    sensors: BTreeMap<ImageLocation, usize>,
}

/// A recording while it is read.
struct Reading<'a> {
    mapping: &'a Mapping,
    /// The topics whose messages are kept as they came.
    sources: Vec<SensorSource>,
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
        let mut clock = ClockWatch::default();
        for (file, path) in (0..).zip(self.paths.clone()) {
            let mut decoders = Decoders::default();
            clock.begin();
            let lost = bag::walk(&path, &mut |message| {
                let topic = &message.channel.topic;
                let ns = self.ns(&message);
                clock.see(topic, ns, events.len());
                if !self.topics.contains(topic) {
                    self.topics.insert(topic.clone());
                }
                let Some(entries) = self.mapping.topics.get(topic) else {
                    return;
                };
                let place = [file, message.number];
                let (cameras, others): (Vec<_>, Vec<_>) =
                    entries.iter().partition(|entry| entry.kind == Kind::Camera);
                if cameras
                    .iter()
                    .any(|entry| entry.name.as_deref().unwrap_or(HEAD) == HEAD)
                {
                    events.push(Event {
                        ns,
                        payload: EventPayload::Image(place),
                    });
                }
                let source = self.sources.iter().position(|source| source.is_of(topic));
                let source = source.map(|source| SensorEvent {
                    place,
                    source,
                    reference: None,
                });
                // Images are decoded when it is known which are wanted.
                events.extend(
                    source
                        .filter(|kept| self.sources[kept.source].is_camera())
                        .map(|kept| Event {
                            ns,
                            payload: EventPayload::Sensor(kept),
                        }),
                );
                if others.is_empty() {
                    return;
                }
                let read = decoders
                    .decode(message.channel, message.data)
                    .and_then(|value| said(&others, self.mapping, source, ns, &value));
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
        losses.extend(
            clock
                .mend(&mut events)
                .into_iter()
                .map(|message| ImportLoss {
                    file: self.paths[0].clone(),
                    message,
                }),
        );
        events.sort_by_key(|event| event.ns);
        (sensors::thinned(events, &self.sources), losses)
    }

    /// The images and messages at these places.
    fn messages(&mut self, wanted: &WantedMessages) -> (DecodedImages, SensorMessages) {
        let (mut images, mut kept) = (BTreeMap::new(), SensorMessages::default());
        let places = wanted.images.iter().chain(wanted.sensors.keys());
        let files: BTreeSet<u64> = places.map(|[file, _]| *file).collect();
        for file in files {
            let path = self.paths[file as usize].clone();
            let mut decoders = Decoders::default();
            // What cannot be read was said before.
            bag::walk(&path, &mut |message| {
                let place = [file, message.number];
                let topic = &message.channel.topic;
                if let Some(source) = wanted.sensors.get(&place) {
                    let source = &self.sources[*source];
                    if let Err(why) = kept.take(place, source, &message, &mut decoders) {
                        self.garble(&path, topic, self.ns(&message), why);
                    }
                }
                let entry =
                    self.mapping.topics.get(topic).and_then(|entries| {
                        entries.iter().find(|entry| entry.kind == Kind::Camera)
                    });
                let Some(entry) = entry.filter(|_| wanted.images.contains(&place)) else {
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
        (images, kept)
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

    /// What the mapping names in vain.
    fn note_topics(&self, notes: &mut Vec<String>) {
        let topics = self.mapping.topics.keys();
        let silent = topics.filter(|topic| !self.topics.contains(*topic));
        notes.extend(silent.map(|topic| format!("no message on {topic}")));
    }
}

/// Finds where the clock of a recording was set back while it went on.
#[derive(Default)]
struct ClockWatch {
    /// The last time of each topic in this file, since the clock was last set back.
    last: BTreeMap<String, u64>,
    /// The last of them all.
    latest_ns: u64,
    jumps: Vec<ClockJump>,
}

/// A place where a topic's own messages go back in time.
struct ClockJump {
    /// Events that stand before it.
    events: usize,
    topic: String,
    last_ns: u64,
    back_ns: u64,
}

impl ClockWatch {
    /// A topic's own messages are out of order by no more than this, where nobody set the clock.
    const ORDER_NS: u64 = 1_000_000_000;
    /// A recording with more places is no recording whose clock was set, but one out of order.
    const JUMPS_MAX: usize = 3;

    /// Begins anew, as with another file.
    fn begin(&mut self) {
        self.last.clear();
        self.latest_ns = 0;
    }

    fn see(&mut self, topic: &str, ns: u64, events: usize) {
        let known = self.last.get(topic).copied();
        if known.is_some_and(|last| last > ns.saturating_add(Self::ORDER_NS)) {
            self.jumps.push(ClockJump {
                events,
                topic: topic.to_owned(),
                last_ns: self.latest_ns,
                back_ns: self.latest_ns - ns,
            });
            self.begin();
        }
        self.latest_ns = self.latest_ns.max(ns);
        let last = self.last.entry(topic.to_owned()).or_default();
        *last = ns.max(*last);
    }

    /// Lets the clock go on at each place, and says where.
    fn mend(self, events: &mut [Event]) -> Vec<String> {
        if self.jumps.len() > Self::JUMPS_MAX {
            return Vec::new();
        }
        let jumps = self.jumps.into_iter();
        jumps
            .map(|jump| {
                for event in &mut events[jump.events..] {
                    event.ns = event.ns.saturating_add(jump.back_ns);
                }
                format!(
                    "the clock goes back by {} at {} (on {}); what follows is read as if it had gone on",
                    seconds(jump.back_ns),
                    seconds(jump.last_ns),
                    jump.topic
                )
            })
            .collect()
    }
}

/// What a message says under the entries of its topic but cameras. What one of several things finds
/// nothing of is not said in this message.
fn said(
    entries: &[&Entry],
    mapping: &Mapping,
    source: Option<SensorEvent>,
    ns: u64,
    message: &Value,
) -> Result<Vec<EventPayload>, String> {
    let all = entries.iter().map(
        |entry| match source.filter(|_| sensors::kind(entry).is_some()) {
            Some(kept) => event::check(entry, ns, message)
                .map(|reference| EventPayload::Sensor(SensorEvent { reference, ..kept })),
            None => event::read(entry, mapping, ns, message),
        },
    );
    let (said, unsaid): (Vec<_>, Vec<_>) = all.partition(Result::is_ok);
    let said: Vec<EventPayload> = said.into_iter().flatten().collect();
    let why = unsaid.into_iter().find_map(Result::err);
    match why.filter(|_| said.is_empty()) {
        Some(why) => Err(why),
        None => Ok(said),
    }
}

/// A moment, in seconds since 1970.
pub(crate) fn seconds(ns: u64) -> String {
    format!("{}.{:09} s", ns / 1_000_000_000, ns % 1_000_000_000)
}
