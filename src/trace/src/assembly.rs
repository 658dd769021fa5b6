//! Puts the messages of a trace together to records, in the one order they may have.

mod draft;
mod messages;

use std::{collections::BTreeMap, path::Path, sync::Arc};

use reel_world::{
    Digest, Scene, Task, ToolCall,
    record::{EndRecord, EpisodeHeader, Graphs, Reported, StartRecord, StepInput, StepRecord},
};
use serde::de::DeserializeOwned;

use crate::{
    McpAnswers, Redactions, Timing, Trace, TraceError,
    chain::{Covered, MessageChain},
    container::Item,
    journal::{
        HEADER_METADATA, RECOVERY_METADATA, SCENE_ATTACHMENT, TASK_ATTACHMENT, check_attachment,
    },
    reader::{DocumentCache, Parsed},
    robot::{CameraImage, RobotLog},
    schema::reel,
    sensors::SensorReader,
};
use draft::{Draft, Unlinked};
use messages::Refusal;

/// Records so far, and the moment that is being put together.
pub(crate) struct Assembly<'a> {
    path: &'a Path,
    /// Where images are of no use: tasks and scenes that were parsed before.
    records_only: Option<&'a DocumentCache>,
    attachments: BTreeMap<String, Vec<u8>>,
    metadata: Option<BTreeMap<String, String>>,
    recoveries: Vec<BTreeMap<String, String>>,
    log_time: u64,
    header: Option<EpisodeHeader>,
    settled: Option<reel::EpisodeSettled>,
    start_graphs: Option<Graphs>,
    start: Option<StartRecord>,
    draft: Option<Draft>,
    steps: Vec<StepRecord>,
    end_graphs: Option<Graphs>,
    end: Option<EndRecord>,
    image: Option<Vec<u8>>,
    images: BTreeMap<Option<u32>, Vec<u8>>,
    depth: Option<Vec<u8>>,
    depths: BTreeMap<Option<u32>, Vec<u8>>,
    mask: Option<Vec<u8>>,
    masks: BTreeMap<Option<u32>, Vec<u8>>,
    offsets: Vec<u64>,
    links: Vec<Digest>,
    covered: Covered,
    /// Whether a message holds what only old traces have in it.
    old_fields: bool,
    chain: MessageChain,
    /// The moment, or the end, whose link has not come yet.
    unlinked: Option<Unlinked>,
    timings: BTreeMap<u32, Timing>,
    mcp_answers: McpAnswers,
    redactions: Redactions,
    /// What was said of the result, until the end comes.
    reported: Option<Reported>,
    robot: RobotLog,
    sensors: SensorReader,
    original: Option<CameraImage>,
    originals: BTreeMap<Option<u32>, CameraImage>,
}

impl<'a> Assembly<'a> {
    pub(crate) fn new(path: &'a Path) -> Self {
        Self {
            path,
            records_only: None,
            attachments: BTreeMap::new(),
            metadata: None,
            recoveries: Vec::new(),
            log_time: 0,
            header: None,
            settled: None,
            start_graphs: None,
            start: None,
            draft: None,
            steps: Vec::new(),
            end_graphs: None,
            end: None,
            image: None,
            images: BTreeMap::new(),
            depth: None,
            depths: BTreeMap::new(),
            mask: None,
            masks: BTreeMap::new(),
            offsets: Vec::new(),
            links: Vec::new(),
            covered: Covered::Messages,
            old_fields: false,
            chain: MessageChain::new(),
            unlinked: None,
            timings: BTreeMap::new(),
            mcp_answers: McpAnswers::new(),
            redactions: Redactions::new(),
            reported: None,
            robot: RobotLog::default(),
            sensors: SensorReader::default(),
            original: None,
            originals: BTreeMap::new(),
        }
    }

    /// Leaves out the images.
    pub(crate) fn records_only(path: &'a Path, known: &'a DocumentCache) -> Self {
        Self {
            records_only: Some(known),
            ..Self::new(path)
        }
    }

    /// How many steps are whole.
    pub(crate) fn step_count(&self) -> u32 {
        self.steps.len() as u32
    }

    /// Takes the next thing of the file.
    pub(crate) fn item(&mut self, offset: u64, item: Item) -> Result<(), TraceError> {
        match item {
            Item::Metadata(metadata) if metadata.name == HEADER_METADATA => {
                self.metadata = Some(metadata.metadata.clone());
            }
            Item::Metadata(metadata) if metadata.name == RECOVERY_METADATA => {
                self.recoveries.push(metadata.metadata.clone())
            }
            Item::Attachment { header, data } => {
                let twice = self
                    .attachments
                    .insert(header.name.clone(), data.to_vec())
                    .is_some();
                let what = format!("the attachment {} stands there twice", header.name);
                let damaged = TraceError::Damaged {
                    path: self.path.to_owned(),
                    offset,
                    problem: what,
                };
                return if twice { Err(damaged) } else { Ok(()) };
            }
            Item::Schema { header, data } => self.sensors.schema(header, data),
            Item::Channel(channel) => self.sensors.channel(channel),
            Item::Message {
                header,
                topic,
                data,
            } => {
                return self.message(offset, header, topic, data).map_err(
                    |refusal| match refusal {
                        Refusal::Error(error) => error,
                        Refusal::What(what) => TraceError::Message {
                            path: self.path.to_owned(),
                            offset,
                            topic: topic.to_owned(),
                            problem: what,
                        },
                    },
                );
            }
            // Metadata of others, and what the container is made of.
            _ => {}
        }
        Ok(())
    }

    /// The call that was received, but of which nothing came that is whole.
    pub(crate) fn under_way(&self) -> Option<(u32, StepInput)> {
        let input = match (&self.draft, &self.unlinked) {
            (Some(draft), _) => draft.input(),
            (None, Some(Unlinked::Step { record, .. })) => record.input.clone(),
            _ => return None,
        };
        Some((self.step_count(), input))
    }

    /// Whether it is a trace with links as they were before they covered messages.
    pub(crate) fn linked_over_records(&self) -> bool {
        self.covered == Covered::Records
    }

    /// Whether the start is whole.
    pub(crate) fn has_start(&self) -> bool {
        self.start.is_some()
    }

    /// The names of the recordings that were recovered, where nothing of an episode was.
    pub(crate) fn nothing_restored(&self) -> Option<TraceError> {
        let last = self.recoveries.last().filter(|_| self.start.is_none())?;
        let of = |key: &str| last.get(key).cloned().unwrap_or_default();
        Some(TraceError::NothingRestored {
            path: self.path.to_owned(),
            source_name: of("source"),
            lost: of("lost"),
        })
    }

    /// What is known before the first call, if all of it can be read.
    pub(crate) fn head(&self) -> Result<(EpisodeHeader, Arc<Task>, Arc<Scene>), TraceError> {
        let Some(header) = self.header.clone() else {
            return Err(self.missing("header of an episode"));
        };
        let task = self.attachment(TASK_ATTACHMENT, header.task_digest, |known| &known.tasks)?;
        let scene =
            self.attachment(SCENE_ATTACHMENT, header.scene_digest, |known| &known.scenes)?;
        Ok((header, task, scene))
    }

    /// What a finished file must hold besides.
    pub(crate) fn check_finished(&self) -> Result<(), TraceError> {
        if self.end.is_some() {
            Ok(())
        } else {
            Err(self.missing("end of the episode"))
        }
    }

    /// Whether an unfinished recording ends with a whole step.
    pub(crate) fn check_open(&self, bytes: u64) -> Result<(), TraceError> {
        let received = |offset: u64, call: &ToolCall| {
            let number = self.steps.len();
            (
                offset,
                format!("call {number} was received, {call}, but not what came of it"),
            )
        };
        let (offset, lost) = match (&self.draft, &self.unlinked) {
            (Some(draft), _) => received(draft.offset, &draft.call),
            (None, Some(Unlinked::Step { record, offset })) => {
                received(*offset, &record.input.call)
            }
            _ if self.start.is_none() => (bytes, "the state after settling".to_owned()),
            _ if self.end_graphs.is_some() && self.end.is_none() => {
                (bytes, "the end of the episode".to_owned())
            }
            _ => return Ok(()),
        };
        Err(TraceError::Torn {
            path: self.path.to_owned(),
            offset,
            steps_readable: self.step_count(),
            lost,
        })
    }

    /// The trace up to here.
    ///
    /// # Errors
    /// When there is no state after settling.
    pub(crate) fn into_trace(mut self, bytes: u64) -> Result<Trace, TraceError> {
        let (header, task, scene) = self.head()?;
        let Some(start) = self.start.take() else {
            return Err(self.missing("state after settling"));
        };
        Ok(Trace {
            path: self.path.to_owned(),
            header,
            task,
            scene,
            meshes: reel_world::Meshes::default(),
            start,
            steps: self.steps,
            end: self.end,
            bytes,
            recoveries: self.recoveries,
            images: self.images,
            depths: self.depths,
            masks: self.masks,
            offsets: self.offsets,
            links: self.links,
            covered: self.covered,
            timings: self.timings,
            mcp_answers: self.mcp_answers,
            redactions: self.redactions,
            robot: self.robot,
            sensors: self.sensors.into_channels(),
            originals: self.originals,
        })
    }

    fn attachment<T: DeserializeOwned>(
        &self,
        name: &'static str,
        expected: Digest,
        parsed: fn(&DocumentCache) -> &Parsed<T>,
    ) -> Result<Arc<T>, TraceError> {
        let Some(json) = self.attachments.get(name) else {
            return Err(self.missing(name));
        };
        let parsed = self.records_only.map(parsed);
        if let Some(value) = parsed.and_then(|parsed| parsed.get(&expected, json)) {
            return Ok(value);
        }
        check_attachment(self.path, name, expected, json)?;
        let value = serde_json::from_slice(json)
            .map(Arc::new)
            .map_err(|error| TraceError::Damaged {
                path: self.path.to_owned(),
                offset: 0,
                problem: format!("the attachment {name} is not what it should be ({error})"),
            })?;
        if let Some(parsed) = parsed {
            parsed.keep(expected, json, &value);
        }
        Ok(value)
    }

    fn missing(&self, what: &'static str) -> TraceError {
        TraceError::Missing {
            path: self.path.to_owned(),
            part: what,
        }
    }
}
