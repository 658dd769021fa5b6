//! Traces: files of any bytes, and files that are sound but for one message, so that what is in it
//! is read.

use std::{fs, path::Path, sync::LazyLock};

use reel_reward::Preset;
use reel_trace::{
    Images, Limits, Recorder, Shard, Timing, Trace, TraceError,
    robot::{Alignment, CameraImage, Odometry, PrimitiveOutcome, RobotLog, VlaLatency},
};
use reel_world::{
    Scene, Task, TokenLogprobs, canonical_json,
    record::{Lookup, Metrics, PolicyOutput, UserReply, UserSource},
};

use super::{file, folder};

/// Files that are changed once more at most, so that a link of their hash chain holds.
const LINKS_MAX: usize = 16;

/// A trace as a file of any bytes.
pub fn trace(bytes: &[u8]) {
    file(bytes, "trace.mcap", |path| {
        let _ = Trace::read(path);
        let _ = reel_trace::examine(path);
    });
}

/// A shard as a file of any bytes: its first episodes, by number and by id.
pub fn shard(bytes: &[u8]) {
    file(bytes, "shard.mcap", |path| {
        let Ok(shard) = Shard::open(path) else {
            return;
        };
        for number in 0..shard.len().min(4) {
            if let Ok(episode) = shard.episode(number) {
                let _ = shard.find(&episode.header.episode_id);
            }
        }
    });
}

/// The attachments: a task, a scene.
pub fn attachment(bytes: &[u8]) {
    if let Ok(task) = serde_json::from_slice::<Task>(bytes) {
        let _ = canonical_json(&task);
    }
    if let Ok(scene) = serde_json::from_slice::<Scene>(bytes) {
        let _ = canonical_json(&scene);
    }
}

/// One message of a recording: its place (a byte), the topic that it is inserted under (a byte; 0:
/// it takes the place of the one there), and its payload. Checksums and hash chain are right. What
/// is read is scored and shown.
pub fn record(bytes: &[u8]) {
    if let Some((_, Ok(trace))) = changed(bytes) {
        let preset = Preset::paper();
        let (task, scene) = (&trace.task, &trace.scene);
        let _ = reel_reward::rewards(&preset, task, scene, &trace.start, &trace.steps);
        let _ = reel_view::transcript(&trace);
        let _ = trace.verify_images();
        let _ = trace.scored_tokens().count();
    }
}

/// A recording as in [`record`], which is examined and restored. One without errors is whole then.
pub fn recovery(bytes: &[u8]) {
    let Some((bytes, trace)) = changed(bytes) else {
        return;
    };
    file(&bytes, "trace.mcap.part", |part| {
        let _ = reel_trace::examine(part);
        let recovery = reel_trace::recover(part, None, |_: &Trace, _: &_| Metrics::default());
        if let Ok(trace) = &trace {
            let path = recovery
                .expect("a recording without errors is restored")
                .trace;
            let restored = Trace::read(&path).expect("what is restored is read");
            let last = (trace.steps.len() as u32).checked_sub(1);
            assert_eq!(restored.link(last), trace.link(last));
        }
    });
}

/// The recording with another message, and what is read of it.
fn changed(bytes: &[u8]) -> Option<(Vec<u8>, Result<Trace, TraceError>)> {
    match bytes {
        [place, topic, payload @ ..] => Some(linked(RECORDING.with(*place, *topic, payload))),
        _ => None,
    }
}

/// The recording with every link of its chain as it should be, if it can be read that far.
fn linked(mut bytes: Vec<u8>) -> (Vec<u8>, Result<Trace, TraceError>) {
    let path = Path::new("trace.mcap.part");
    let mut trace = Trace::from_bytes(path, &bytes, &Limits::default());
    for _ in 0..LINKS_MAX {
        let Err(TraceError::ChainBroken {
            expected, found, ..
        }) = &trace
        else {
            break;
        };
        let places: Vec<usize> = bytes
            .windows(found.0.len())
            .enumerate()
            .filter(|(_, window)| *window == found.0)
            .map(|(place, _)| place)
            .collect();
        for place in places {
            bytes[place..place + found.0.len()].copy_from_slice(&expected.0);
        }
        trace = Trace::from_bytes(path, &bytes, &Limits::default());
    }
    (bytes, trace)
}

/// An unfinished recording with a message of every kind. Nothing in it has a checksum but the chain.
static RECORDING: LazyLock<Recording> = LazyLock::new(|| Recording::parse(&recorded()));

/// MCAP before it is put into chunks: magic bytes, then records.
struct Recording {
    magic: Vec<u8>,
    records: Vec<Record>,
    /// Places of messages among the records.
    messages: Vec<usize>,
    /// Ids of the channels.
    channels: Vec<[u8; 2]>,
}

#[derive(Clone)]
struct Record {
    opcode: u8,
    body: Vec<u8>,
}

impl Recording {
    const MAGIC: usize = 8;
    const CHANNEL: u8 = 4;
    const MESSAGE: u8 = 5;
    /// Channel, sequence, log time and publish time of a message.
    const MESSAGE_HEAD: usize = 2 + 4 + 8 + 8;

    fn parse(file: &[u8]) -> Self {
        let (magic, mut rest) = file.split_at(Self::MAGIC);
        let mut records = Vec::new();
        while let Some((prefix, behind)) = rest.split_first_chunk::<9>() {
            let length = u64::from_le_bytes(*prefix[1..].first_chunk().expect("eight bytes"));
            let (body, behind) = behind.split_at(length as usize);
            records.push(Record {
                opcode: prefix[0],
                body: body.to_vec(),
            });
            rest = behind;
        }
        let of = |opcode| {
            (0..)
                .zip(&records)
                .filter(move |(_, record)| record.opcode == opcode)
        };
        let messages = of(Self::MESSAGE).map(|(place, _)| place).collect();
        let channels = of(Self::CHANNEL)
            .map(|(_, record)| [record.body[0], record.body[1]])
            .collect();
        Self {
            magic: magic.to_vec(),
            messages,
            channels,
            records,
        }
    }

    /// The file with another message.
    fn with(&self, place: u8, topic: u8, payload: &[u8]) -> Vec<u8> {
        let mut records = self.records.clone();
        let mut place = self.messages[usize::from(place) % self.messages.len()];
        if let Some(topic) = topic.checked_sub(1) {
            let mut inserted = records[place].clone();
            let channel = self.channels[usize::from(topic) % self.channels.len()];
            inserted.body[..2].copy_from_slice(&channel);
            // A channel stands before its messages.
            let announced =
                |record: &Record| record.opcode == Self::CHANNEL && record.body[..2] == channel[..];
            let known = records.iter().position(announced);
            place = place.max(known.expect("a channel of the file") + 1);
            records.insert(place, inserted);
        }
        records[place].body.truncate(Self::MESSAGE_HEAD);
        records[place].body.extend_from_slice(payload);
        let mut file = self.magic.clone();
        let mut time = 0;
        for mut record in records {
            if record.opcode == Self::MESSAGE {
                // Each is later than the one before it.
                time = u64::from_le_bytes(record.body[6..14].try_into().expect("eight bytes"))
                    .max(time + 1);
                record.body[6..14].copy_from_slice(&u64::to_le_bytes(time));
            }
            file.push(record.opcode);
            file.extend_from_slice(&(record.body.len() as u64).to_le_bytes());
            file.extend_from_slice(&record.body);
        }
        file
    }
}

/// A small trace of the corpus, recorded again with what it lacks.
fn recorded() -> Vec<u8> {
    let whole = include_bytes!("../corpus/trace/whole.mcap");
    let mut trace = Trace::from_bytes(Path::new("whole.mcap"), whole, &Limits::default())
        .expect("a trace of the corpus");
    trace.steps.truncate(2);
    for step in &mut trace.steps {
        step.input.policy = Some(PolicyOutput {
            raw: "raw".to_owned(),
            reasoning: "reasoning".to_owned(),
            tokens: Some([7, 2]),
            latency_ns: Some(5),
            logprobs: TokenLogprobs::sampled(
                vec!["a".to_owned(), " b".to_owned()],
                vec![-0.5, 0.0],
            )
            .ok(),
            ..PolicyOutput::default()
        });
        step.input.user_reply = Some(UserReply {
            text: "the red one".to_owned(),
            source: UserSource::Human,
        });
        step.input.lookup = Some(Lookup {
            categories: vec!["mug".to_owned()],
            source: "e5".to_owned(),
        });
        step.reply.clone_from(&step.input.user_reply);
    }
    let folder = folder();
    let path = folder.path().join("trace.mcap");
    let record = || -> Result<(), TraceError> {
        let Trace {
            header,
            task,
            scene,
            ..
        } = &trace;
        let mut recorder = Recorder::create(&path, header, task, scene, Images::Full)?;
        recorder.start(&trace.start, None)?;
        for record in &trace.steps {
            let step = Some(record.step);
            recorder.input(record.step, &record.input)?;
            recorder.timing(
                record.step,
                &Timing {
                    called_unix_ns: 1,
                    took_ns: 2,
                },
            )?;
            recorder.robot(step, &measured(step))?;
            recorder.original(
                step,
                &CameraImage {
                    format: "png".to_owned(),
                    data: PNG.to_vec(),
                },
            )?;
            recorder.step(record, None)?;
        }
        Ok(())
    };
    record().expect("a recording");
    fs::read(path.with_extension("mcap.part")).expect("it was not finished")
}

const PNG: &[u8] = include_bytes!("../corpus/image/frame.png");

fn measured(step: Option<u32>) -> RobotLog {
    RobotLog {
        odometry: vec![Odometry {
            step,
            ..Odometry::default()
        }],
        primitives: vec![PrimitiveOutcome {
            step,
            ..PrimitiveOutcome::default()
        }],
        vla: vec![VlaLatency {
            step,
            ..VlaLatency::default()
        }],
        alignments: vec![Alignment {
            step,
            ..Alignment::default()
        }],
    }
}
