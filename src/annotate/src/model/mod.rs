//! The writer that asks a model through an OpenAI-compatible endpoint. Optional:
//! the rules need none.
//!
//! An episode is written in batches from its beginning, because a History only grows. After
//! each batch everything so far is in the checkpoint, so that a run that broke off goes on
//! where it stopped. What a model writes is believed only if it is complete, says nothing that
//! an agent could not know, and passes the check of its History; else the rules' note stands,
//! and it is said why.

mod answer;
mod prompt;

use std::{fs, io, path::Path, sync::Arc};

use reel_llm::client::{Client, Message, Reply, Role};
use reel_prompt::Prompt;
use reel_world::Digest;

#[doc(hidden)]
pub use answer::parse as parse_answer;
pub use prompt::version as prompt_version;

use crate::{
    AnnotateError, Annotation, Entry, PrivilegedFacts, Provenance, PublicTask, RequestForm, Step,
    annotate,
    sidecar::{read_some, write_notes},
};

/// Maximum number of decisions in one model request.
pub const BATCH: usize = 10;

/// Looks at the History of a decision, given by its index, and says what in it is not so; none if
/// all of it may be true.
pub type HistoryCheck<'a> = dyn Fn(usize, &str) -> Option<String> + 'a;

/// The image, as a PNG file, that the robot had before it a decision, given by its index; `None` where its
/// last result had none.
pub type FrameBefore<'a> = dyn Fn(usize) -> Option<Vec<u8>> + 'a;

/// Writes notes by asking a model.
pub struct ModelAnnotator<'a> {
    /// Whom to ask. Give it a log, and every request and reply is kept.
    pub client: &'a Client,
    /// Of the rules' words, where they stand in.
    pub seed: u64,
    /// What a History has to pass.
    pub check: &'a HistoryCheck<'a>,
    /// The prompt that the annotated robot acts on, so that the notes fit it.
    pub prompt: Arc<Prompt>,
    /// Number of decisions in one request, from 1 to [`BATCH`]. With 1 the model writes step by step, as
    /// the robot decided: of what was before it gets the last result and the history alone.
    pub decisions: usize,
    /// Images that the model gets with the record; `None` if it gets the record alone.
    pub frames: Option<&'a FrameBefore<'a>>,
}

/// What came of an episode.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct AnnotatedEpisode {
    /// Whose notes they are.
    pub provenance: Provenance,
    /// One for each decision.
    pub entries: Vec<Entry>,
    /// How many were there already from a run that broke off.
    pub resumed: usize,
}

impl AnnotatedEpisode {
    /// How many notes the rules wrote in the model's place.
    pub fn fallbacks(&self) -> usize {
        self.entries
            .iter()
            .filter(|entry| entry.fallback.is_some())
            .count()
    }
}

impl ModelAnnotator<'_> {
    /// Writes the notes of an episode and keeps them in the file `path`, which is also
    /// the checkpoint: what stands there of the same trace, model, prompt and seed is
    /// not asked for again.
    ///
    /// # Errors
    /// When the model cannot be asked, or the file not be read or written. What
    /// was written before stays.
    pub fn annotate(
        &self,
        task: &PublicTask,
        steps: &[Step<'_>],
        secrets: &PrivilegedFacts,
        trace: Digest,
        path: &Path,
    ) -> Result<AnnotatedEpisode, AnnotateError> {
        let annotator = self.client.endpoint().model.clone();
        let provenance = Provenance {
            trace,
            steps: steps.len(),
            annotator,
            version: prompt_version(&self.prompt),
            seed: self.seed,
            request: Some(RequestForm {
                decisions: self.decisions,
                frames: self.frames.is_some(),
            }),
        };
        let mut entries = kept(path, &provenance)?;
        let resumed = entries.len();
        let rules = annotate(task, steps, self.seed);
        while entries.len() < steps.len() {
            let from = entries.len();
            let to = steps.len().min(from + self.decisions.clamp(1, BATCH));
            let answered = self.ask(task, steps, secrets, &entries, from..to)?;
            for (index, rules) in rules.iter().enumerate().take(to).skip(from) {
                let note = answered
                    .iter()
                    .find(|(step, _)| *step == index)
                    .map(|(_, note)| note);
                entries.push(self.judged(index, note, rules, secrets, steps));
            }
            write_notes(path, &provenance, &entries)?;
        }
        if steps.is_empty() {
            write_notes(path, &provenance, &entries)?;
        }
        Ok(AnnotatedEpisode {
            provenance,
            entries,
            resumed,
        })
    }

    /// Asks for the notes of a batch; a second time, if nothing in the answer can be read.
    fn ask(
        &self,
        task: &PublicTask,
        steps: &[Step<'_>],
        secrets: &PrivilegedFacts,
        entries: &[Entry],
        batch: std::ops::Range<usize>,
    ) -> Result<Vec<(usize, Annotation)>, AnnotateError> {
        let complete = |request: &_| -> Result<Reply, AnnotateError> {
            let error = |source| AnnotateError::Model {
                from: batch.start,
                to: batch.end - 1,
                source,
            };
            self.client.complete(request).map_err(error)
        };
        let before = entries.last().map(|entry| entry.note.history.as_str());
        // Step by step the history is all that is left of what was before the last result.
        let shown = if self.decisions == 1 { 1 } else { steps.len() };
        let part = (shown, batch.clone());
        let mut request = prompt::request(&self.prompt, task, steps, secrets, before, part);
        if let Some(frames) = self.frames {
            prompt::add_frames(&mut request, batch.clone(), frames);
        }
        let first = complete(&request)?;
        let notes = answer::parse(&first.text);
        if !notes.is_empty() {
            return Ok(notes);
        }
        request
            .messages
            .push(Message::text(Role::Assistant, first.text));
        request
            .messages
            .push(Message::text(Role::User, prompt::RETRY_PROMPT));
        Ok(answer::parse(&complete(&request)?.text))
    }

    /// The model's note, if there is nothing against it.
    fn judged(
        &self,
        index: usize,
        note: Option<&Annotation>,
        rules: &Annotation,
        secrets: &PrivilegedFacts,
        steps: &[Step<'_>],
    ) -> Entry {
        let Some(note) = note else {
            return Entry {
                note: rules.clone(),
                fallback: Some("the model wrote no complete note".to_owned()),
            };
        };
        let against = secrets
            .leak(note, &steps[..index])
            .or_else(|| (self.check)(index, &note.history));
        match against {
            None => note.clone().into(),
            why => Entry {
                note: rules.clone(),
                fallback: why,
            },
        }
    }
}

/// What an earlier run left, if it was asked for the same.
fn kept(path: &Path, provenance: &Provenance) -> Result<Vec<Entry>, AnnotateError> {
    match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        _ => {}
    }
    let (found, entries) = read_some(path, &provenance.trace)?;
    Ok(
        if found == *provenance && entries.len() <= provenance.steps {
            entries
        } else {
            Vec::new()
        },
    )
}
