//! A row of the store as an episode in plain text: with the words of its policy, or with words
//! written for it, by rules or in the file beside its trace.

use std::{borrow::Cow, path::Path};

use reel_annotate::{
    AnnotateError, Annotation, MarkedItem, ObservedObject, Step as Decision, notes_path, read_notes,
};
use reel_dataset::{Rollout, Step};
use reel_history::{Checker, EpisodeFacts, StepFacts, repair_history};
use reel_trace::Trace;
use reel_world::{Digest, ErrorCode, TokenLogprobs, answer::AssistantTurn};
use serde::Deserialize;

use crate::{
    AnnotationSource, HistoryRepairs, rollouts::GroupReturn, select::has_own_tools,
    task_index::TaskEntry,
};

/// Columns of `episodes` that an example is made of, in words of a kind.
pub(crate) fn columns(words: AnnotationSource, rollouts: bool) -> Vec<&'static str> {
    let annotator: &[&str] = match words {
        AnnotationSource::Auto | AnnotationSource::Rules => ANNOTATOR_COLUMNS,
        AnnotationSource::Recorded | AnnotationSource::Notes => &[],
    };
    let rollouts: &[&str] = if rollouts { ROLLOUT_COLUMNS } else { &[] };
    [COLUMNS, annotator, rollouts].concat()
}

const COLUMNS: &[&str] = &reel_world::words! {
    episode_id task_id task_digest scene_digest scene_id family policy profile preset trace
    trace_digest seed success "steps.list.element.step" "steps.list.element.tool"
    "steps.list.element.call_name" "steps.list.element.arguments" "steps.list.element.text"
    "steps.list.element.error_code" "steps.list.element.error_class" "steps.list.element.reasoning"
    "steps.list.element.history" "steps.list.element.plan" "steps.list.element.held"
    "steps.list.element.raw" target
};

/// What rollouts are besides: what the policies gave the tokens of their answers.
const ROLLOUT_COLUMNS: &[&str] =
    &reel_world::words! { "steps.list.element.tokens" "steps.list.element.logprobs" };

/// What only the annotator looks at.
const ANNOTATOR_COLUMNS: &[&str] = &reel_world::words! {
    "steps.list.element.argument" "steps.list.element.receptacle" "steps.list.element.reply" "steps.list.element.listed" "steps.list.element.marker_map"
    "steps.list.element.visible_objects.list.element.object"
};

/// An episode as the store has it.
#[derive(Deserialize)]
pub(crate) struct EpisodeRow<'a> {
    pub episode_id: &'a str,
    pub task_id: &'a str,
    pub task_digest: &'a str,
    pub scene_digest: &'a str,
    pub scene_id: &'a str,
    pub family: &'a str,
    pub policy: &'a str,
    pub profile: &'a str,
    pub preset: &'a str,
    pub trace: &'a str,
    pub trace_digest: &'a str,
    /// A column of numbers without a sign, which come as text.
    seed: String,
    success: Option<bool>,
    target: &'a str,
    pub steps: Vec<StepRow<'a>>,
}

#[derive(Deserialize)]
pub(crate) struct StepRow<'a> {
    pub step: u32,
    tool: &'a str,
    call_name: &'a str,
    arguments: &'a str,
    text: &'a str,
    error_code: Option<&'a str>,
    error_class: Option<&'a str>,
    reasoning: Option<&'a str>,
    history: Option<&'a str>,
    plan: Option<&'a str>,
    held: Option<&'a str>,
    // of rollouts and of the annotator
    raw: Option<&'a str>,
    // of rollouts
    tokens: Option<Vec<String>>,
    #[serde(default)]
    logprobs: Vec<PolicyLogprobs>,
    // of the annotator
    argument: Option<&'a str>,
    receptacle: Option<&'a str>,
    reply: Option<&'a str>,
    #[serde(default)]
    listed: Vec<&'a str>,
    #[serde(default)]
    marker_map: Vec<MarkerRow<'a>>,
    #[serde(default)]
    visible_objects: Vec<VisibleRow<'a>>,
}

/// What a policy gives the tokens of a decision.
#[derive(Deserialize)]
pub(crate) struct PolicyLogprobs {
    pub policy: String,
    pub logprobs: Vec<f64>,
}

#[derive(Deserialize)]
struct MarkerRow<'a> {
    marker: u32,
    kind: &'a str,
    id: &'a str,
}

#[derive(Deserialize)]
struct VisibleRow<'a> {
    object: &'a str,
}

impl EpisodeRow<'_> {
    /// Whether its agent acted outside of homes, with tools of its own.
    pub fn has_own_tools(&self) -> bool {
        has_own_tools(
            self.target,
            self.steps.iter().map(|step| (step.tool, step.call_name)),
        )
    }

    /// What an agent with tools of its own said beside a call that its answer does not spell.
    pub fn message_of(&self, call: u32) -> Option<&str> {
        let step = self.steps.iter().find(|step| step.step == call)?;
        step.raw.filter(|raw| {
            !raw.contains(&format!("\"{}\"", step.call_name))
                && step.reasoning.is_none_or(|reasoning| reasoning != *raw)
        })
    }

    /// Whether a model spoke for itself. What built-in policies note of themselves are no
    /// words of a model.
    pub fn has_policy_text(&self) -> bool {
        self.steps.iter().any(|step| step.raw.is_some())
    }

    /// The words of every decision, and whose they are.
    ///
    /// # Errors
    /// When they shall be those of a file that is none.
    pub fn notes(
        &self,
        words: AnnotationSource,
        known: &TaskEntry,
        seed: u64,
    ) -> Result<(Vec<Annotation>, String), AnnotateError> {
        match words {
            AnnotationSource::Recorded => Ok((self.recorded(), self.policy.to_owned())),
            AnnotationSource::Notes => {
                let trace = Digest::from_hex(self.trace_digest).unwrap_or_default();
                let (provenance, entries) = read_notes(&notes_path(Path::new(self.trace)), &trace)?;
                let notes = entries.into_iter().map(|entry| entry.note).collect();
                Ok((
                    notes,
                    format!("{}-{}", provenance.annotator, provenance.version.short()),
                ))
            }
            AnnotationSource::Auto | AnnotationSource::Rules => {
                let steps: Vec<Decision<'_>> =
                    self.steps.iter().map(|step| step.decision(known)).collect();
                let trace = Digest::from_hex(self.trace_digest).unwrap_or_default();
                let notes = reel_annotate::annotate(
                    known.public(),
                    &steps,
                    reel_annotate::episode_seed(seed, &trace),
                );
                Ok((notes, format!("rules-{}", reel_annotate::version().short())))
            }
        }
    }

    /// Whether its answers are texts that hold their calls, as those to single turns are: no call came beside the text, as
    /// a function's does.
    pub fn answers_hold_calls(&self) -> bool {
        let beside = |step: &StepRow<'_>| {
            let raw = step.raw.filter(|_| !step.call_name.is_empty());
            raw.is_some_and(|raw| AssistantTurn::parse(raw).action.is_none())
        };
        !self.steps.iter().any(beside)
    }

    /// The answer to the prompt of a call, as it came.
    pub fn answer(&self, call: u32) -> Option<&str> {
        self.steps.iter().find(|step| step.step == call)?.raw
    }

    /// What the gripper holds after a call, by its instance.
    pub fn held_after(&self, call: u32) -> Option<&str> {
        self.steps.iter().find(|step| step.step == call)?.held
    }

    /// What a decision was worth.
    pub fn rollout(&self, worth: &GroupReturn, call: u32) -> Option<Rollout> {
        let (index, step) = self
            .steps
            .iter()
            .enumerate()
            .find(|(_, step)| step.step == call)?;
        Some(Rollout {
            group: worth.group.to_string(),
            group_size: worth.group_size,
            rollout: worth.rollout,
            seed: self.seed.parse().unwrap_or_default(),
            step: call,
            steps: self.steps.len() as u32,
            reward: *worth.rewards.get(index)?,
            episode_return: worth.episode_return,
            advantage: worth.advantage,
            success: self.success == Some(true),
            logprobs: step.logprobs(),
        })
    }

    /// The decisions, without words, images, or anything to learn.
    pub fn decisions(&self) -> Vec<Step> {
        let decision = |step: &StepRow<'_>| Step {
            call: step.step,
            tool: step.tool.to_owned(),
            call_name: step.call_name.to_owned(),
            // what was called may be anything: as text, where it is no JSON
            arguments: serde_json::from_str(step.arguments)
                .unwrap_or_else(|_| step.arguments.into()),
            outcome: step.text.to_owned(),
            error: step
                .error_class
                .zip(step.error_code)
                .map(|(class, code)| format!("{class}: {code}")),
            ..Step::default()
        };
        self.steps.iter().map(decision).collect()
    }

    /// The policy's own words.
    fn recorded(&self) -> Vec<Annotation> {
        let words = |step: &StepRow<'_>| {
            let plan = step.plan.unwrap_or_default();
            let (schedule, subtask) = plan.split_once(SUBTASK).unwrap_or((plan, ""));
            let part = |text: &str| text.trim().trim_start_matches(SCHEDULE).trim().to_owned();
            Annotation {
                reasoning: step.reasoning.unwrap_or_default().to_owned(),
                history: step.history.unwrap_or_default().to_owned(),
                schedule: part(schedule),
                subtask: part(subtask),
            }
        };
        self.steps.iter().map(words).collect()
    }
}

/// What stands before the parts of a plan.
const SCHEDULE: &str = "New Schedule:";
const SUBTASK: &str = "Current subtask:";

impl<'a> StepRow<'a> {
    /// What policies give the tokens of the decision; `None` if nothing was recorded.
    fn logprobs(&self) -> Option<TokenLogprobs> {
        let by_policy = self
            .logprobs
            .iter()
            .map(|of| (of.policy.clone(), of.logprobs.clone()))
            .collect();
        TokenLogprobs::new(self.tokens.clone()?, by_policy).ok()
    }

    fn decision(&'a self, known: &'a TaskEntry) -> Decision<'a> {
        let thing = |instance: &str| known.object(instance).map(ObservedObject::of);
        let marked = |marker: &MarkerRow<'a>| match marker.kind {
            "object" => thing(marker.id).map(MarkedItem::Object),
            _ => Some(MarkedItem::Receptacle(marker.id)),
        };
        let mut seen: Vec<ObservedObject<'_>> = Vec::new();
        for instance in self
            .listed
            .iter()
            .copied()
            .chain(self.visible_objects.iter().map(|visible| visible.object))
        {
            seen.extend(thing(instance).filter(|thing| !seen.contains(thing)));
        }
        Decision {
            tool: self.tool,
            argument: self.argument.map(Cow::Borrowed),
            error: self.error_code.and_then(ErrorCode::parse),
            outcome: self.text,
            reply: self.reply,
            markers: self
                .marker_map
                .iter()
                .filter_map(|marker| Some((marker.marker, marked(marker)?)))
                .collect(),
            visible: seen,
            receptacle: self.receptacle,
            held: self.held.and_then(thing),
        }
    }
}

/// Takes out of each History what the record refutes.
pub(crate) fn repair_histories(notes: &mut [Annotation], trace: &Trace) -> HistoryRepairs {
    let mut checker = Checker::new(EpisodeFacts::of(
        &trace.task,
        &trace.scene,
        &trace.start.graphs.physics,
    ));
    let mut mending = HistoryRepairs::default();
    for (note, record) in notes.iter_mut().zip(&trace.steps) {
        let result = repair_history(&mut checker, &note.history);
        mending.corrected += result.repaired as u64;
        mending.dropped += result.dropped as u64;
        note.history = result.text;
        checker.push_step(StepFacts::of(record));
    }
    mending
}
