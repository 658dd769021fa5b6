//! A model's opinion on why an episode failed, through any OpenAI-compatible endpoint. Optional:
//! no rule needs it.
//!
//! Owns what the model is shown, how its answer is read, and what its word counts. The judge is
//! blind: it sees what the agent did and was told, never what the rules concluded, so that its
//! agreement with them means something. It can never overturn what the simulator proved. What is in
//! an episode is data to it: recorded words stand as JSON strings between lines that they cannot
//! forge. Never reads tables, never writes files: replies are kept and calls logged by the client.

mod answer;
mod error;
mod prompt;
mod reading;
mod vocabulary;

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;
use reel_llm::client::{Client, Message, ModelError, Reply, Request, Role};
use reel_world::{Digest, FailureClass};
use serde::{Deserialize, Serialize};

#[doc(hidden)]
pub use answer::parse as parse_answer;
pub use error::JudgeError;
pub use prompt::version as prompt_version;

/// After so many calls in a row that found nobody at the endpoint, it is not called again.
pub const REFUSED_MAX: u32 = 5;

/// A failed episode as the judge gets it.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Case {
    /// The episode; not shown to the model.
    pub episode_id: String,
    /// What the agent was told to do.
    pub instruction: String,
    /// What the task wanted and where things stood; `None` if the judge shall see only what the
    /// agent saw.
    pub truth: Option<CaseTruth>,
    /// Its steps in their order.
    pub transcript: Vec<CaseStep>,
    /// Images in the order of their steps.
    pub frames: Vec<CaseImage>,
    /// What the rules found in the simulator's record, if anything; not shown to the model. Of a
    /// reduced trace it is binding all the same: leave it out where words alone are not enough.
    pub rule_finding: Option<RuleFinding>,
    /// Whether the trace has no simulator behind it, so that evidence is words alone.
    pub reduced: bool,
}

/// What only the simulator knows, for a judge that is shown it.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct CaseTruth {
    /// What the goal moves: object, where it stood, where it belongs.
    pub goal: Vec<CaseObject>,
    /// The other objects of the task.
    pub others: Vec<CaseObject>,
}

/// An object of a task in words.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct CaseObject {
    /// How it looks: its caption, else its category.
    pub object: String,
    /// Receptacle on which it stood at the start.
    pub stood_on: String,
    /// Receptacle on which the goal wants it; empty if the goal does not move it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub belongs_on: String,
}

/// A step as the judge sees it. Empty texts are left out.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct CaseStep {
    /// Its number in the episode.
    pub step: u32,
    /// The call as text.
    pub call: String,
    /// What the agent was answered.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub outcome: String,
    /// Code of the error, if the call failed.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub error: String,
    /// What the call acted on in truth: object and receptacle; only with [`Case::truth`].
    #[serde(skip_serializing_if = "String::is_empty")]
    pub acted_on: String,
    /// What the agent thought.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub reasoning: String,
    /// What the agent believed to have done.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub history: String,
    /// What it asked the user.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub question: String,
    /// What the user said.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub answer: String,
}

/// An image that the agent saw.
#[derive(Clone, PartialEq, Debug)]
pub struct CaseImage {
    /// Number of the step after which the frame was taken.
    pub step: u32,
    /// Media type of the image, e.g. `image/png`.
    pub media_type: String,
    /// The encoded image file, in the format that `media_type` names.
    pub bytes: Vec<u8>,
}

/// What the simulator's record shows, by the rules.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct RuleFinding {
    /// One of the four classes.
    pub class: String,
    /// Sub-class within the class; `None` if the rules name none.
    pub sub_class: Option<String>,
    /// The decisive step, by its number in the episode.
    pub step: u32,
    /// What the rules rely on, in words for people.
    pub evidence: String,
}

impl RuleFinding {
    /// Whether it says why. `Other` does so only where something was seen to happen: that the
    /// budget ended does not.
    pub fn explains(&self) -> bool {
        let seen = ["invalid_output", "physical_failure", "primitive_failure"];
        self.class != FailureClass::Other.as_str()
            || self
                .sub_class
                .as_deref()
                .is_some_and(|sub_class| seen.contains(&sub_class))
    }
}

/// What the model said.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Opinion {
    /// One of the four classes.
    pub class: String,
    /// A sub-class of that class, where one fits.
    pub sub_class: Option<String>,
    /// The model's own name for what no sub-class says.
    pub proposed_sub_class: Option<String>,
    /// The decisive step, one of the transcript.
    pub step: u32,
    /// The model's explanation of its choice, in words.
    pub comment: String,
    /// How probable it thinks the class is right, from 0 to 1.
    pub confidence: f64,
    /// Whether it spoke against what is proven, and so counts nothing.
    pub overruled: bool,
}

/// Whose word a class is.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// The rules', on what the simulator recorded.
    #[serde(alias = "proven")]
    Rules,
    /// The judge's: a proposal.
    Judge,
}

/// A case with the judge's opinion beside what is proven.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct JudgedCase {
    /// Id of the episode that was judged.
    pub episode_id: String,
    /// The class that counts: the proven one wherever one is.
    pub class: String,
    /// Sub-class of the class that counts; `None` if none is named.
    pub sub_class: Option<String>,
    /// The decisive step that goes with the class that counts.
    pub step: u32,
    /// Whose word the three are.
    pub source: Source,
    /// What the rules found, unchanged.
    #[serde(alias = "proven")]
    pub rule_finding: Option<RuleFinding>,
    /// What the judge said.
    pub opinion: Opinion,
    /// Whether it names the proven class; absent where nothing is proven.
    pub agrees: Option<bool>,
    /// Whether the evidence was words alone.
    pub reduced: bool,
    /// Name of the model that gave the opinion.
    pub model: String,
    /// Version of the prompts that were used: their digest.
    pub prompt: Digest,
    /// Of the request that was answered; leads to the client's log and cache.
    pub request: Digest,
}

/// How the judge reads an episode (Zhang et al. 2025, Which Agent Causes Task Failures and When).
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum JudgeReading {
    /// The whole record at once: one question an episode.
    #[default]
    Whole,
    /// Step by step: after each step, without what comes after it, whether it is the decisive one;
    /// at the first that is, why. As many questions as there are steps up to it, and one.
    Steps,
}

/// How much of an episode is shown, and how.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct JudgeOptions {
    /// How the record is read.
    pub reading: JudgeReading,
    /// Most bytes of the record, images apart; what is over it is left out in the middle. At
    /// least [`JudgeOptions::TRANSCRIPT_BYTES_MIN`] are used.
    pub transcript_bytes: usize,
    /// Most images, spread evenly over the episode; 0 for a model without eyes.
    pub frames: usize,
}

impl JudgeOptions {
    /// Less than this shows nothing worth a judgement.
    pub const TRANSCRIPT_BYTES_MIN: usize = 2_000;
}

impl Default for JudgeOptions {
    /// 60,000 bytes, which is about 15,000 tokens, and 8 images.
    fn default() -> Self {
        Self {
            reading: JudgeReading::Whole,
            transcript_bytes: 60_000,
            frames: 8,
        }
    }
}

/// Asks for an opinion on one case; a second time, with what is wrong, if the
/// answer cannot be read.
///
/// # Errors
/// When the case has no steps, the model cannot be asked, or what it says is no answer twice.
pub fn judge(
    case: &Case,
    client: &Client,
    options: &JudgeOptions,
) -> Result<JudgedCase, JudgeError> {
    judged(case, client, options, &EndpointState::default())
}

/// Asks for an opinion on every case, several at a time. Results stand in the order of the
/// cases; one that fails leaves the others alone. When [`REFUSED_MAX`] calls in a row find
/// nobody at the endpoint, what is left gets kept replies or fails without a call. `progress` is
/// told how many are done.
pub fn judge_all(
    cases: &[Case],
    client: &Client,
    options: &JudgeOptions,
    threads: usize,
    progress: impl Fn(usize) + Sync,
) -> Vec<Result<JudgedCase, JudgeError>> {
    let pool = match rayon::ThreadPoolBuilder::new()
        .num_threads(threads.max(1))
        .build()
    {
        Ok(pool) => pool,
        Err(error) => {
            let failed = |_| {
                Err(JudgeError::Workers {
                    threads,
                    message: error.to_string(),
                })
            };
            return cases.iter().map(failed).collect();
        }
    };
    let reached = EndpointState::default();
    let done = AtomicUsize::new(0);
    let each = |case: &Case| {
        let result = judged(case, client, options, &reached);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        result
    };
    pool.install(|| cases.par_iter().with_max_len(1).map(each).collect())
}

fn judged(
    case: &Case,
    client: &Client,
    options: &JudgeOptions,
    reached: &EndpointState,
) -> Result<JudgedCase, JudgeError> {
    let episode_id = || case.episode_id.clone();
    if case.transcript.is_empty() {
        return Err(JudgeError::NoSteps {
            episode_id: episode_id(),
        });
    }
    let ask = |request: &Request| -> Result<Reply, JudgeError> {
        if reached.is_hopeless() {
            let stopped = || JudgeError::Stopped {
                episode_id: episode_id(),
                refused: REFUSED_MAX,
            };
            return client.cached(request).ok_or_else(stopped);
        }
        let result = client.complete(request);
        reached.note(&result);
        result.map_err(|source| JudgeError::Model {
            episode_id: episode_id(),
            source,
        })
    };
    let found = match options.reading {
        JudgeReading::Whole => None,
        JudgeReading::Steps => reading::decisive(case, options, &ask)?,
    };
    let request = prompt::request(case, options, found.as_ref());
    let (reply, opinion) = answered(case, request, &ask, |text| answer::parse(text, case))?;
    Ok(verdict(
        case,
        opinion,
        &client.endpoint().model,
        (prompt_version(options.reading), reply.request),
    ))
}

/// Asks, and once more, with what is wrong, if the answer cannot be read.
fn answered<T>(
    case: &Case,
    mut request: Request,
    ask: &dyn Fn(&Request) -> Result<Reply, JudgeError>,
    parse: impl Fn(&str) -> Result<T, String>,
) -> Result<(Reply, T), JudgeError> {
    let first = ask(&request)?;
    let problem = match parse(&first.text) {
        Ok(read) => return Ok((first, read)),
        Err(problem) => problem,
    };
    let retry = prompt::retry_prompt(&problem);
    request
        .messages
        .push(Message::text(Role::Assistant, first.text));
    request.messages.push(Message::text(Role::User, retry));
    let second = ask(&request)?;
    match parse(&second.text) {
        Ok(read) => Ok((second, read)),
        Err(problem) => Err(JudgeError::Unreadable {
            episode_id: case.episode_id.clone(),
            problem,
            truncated: second.truncated,
            excerpt: answer::one_line(&second.text, 300),
        }),
    }
}

/// What is proven stays; the opinion stands beside it, or is a proposal where nothing is.
fn verdict(
    case: &Case,
    mut opinion: Opinion,
    model: &str,
    (prompt, request): (Digest, Digest),
) -> JudgedCase {
    let binding = case
        .rule_finding
        .as_ref()
        .filter(|proven| proven.explains());
    let agrees = binding.map(|proven| proven.class == opinion.class);
    opinion.overruled = agrees == Some(false);
    let (class, sub_class, step, source) = match binding {
        Some(proven) => (
            proven.class.clone(),
            proven.sub_class.clone(),
            proven.step,
            Source::Rules,
        ),
        None => (
            opinion.class.clone(),
            opinion.sub_class.clone(),
            opinion.step,
            Source::Judge,
        ),
    };
    JudgedCase {
        episode_id: case.episode_id.clone(),
        class,
        sub_class,
        step,
        source,
        rule_finding: case.rule_finding.clone(),
        opinion,
        agrees,
        reduced: case.reduced,
        model: model.to_owned(),
        prompt,
        request,
    }
}

/// How many calls in a row found nobody at the endpoint.
#[derive(Default)]
struct EndpointState {
    refused: Mutex<u32>,
}

impl EndpointState {
    /// Kept replies say nothing about the endpoint.
    fn note(&self, result: &Result<Reply, ModelError>) {
        let mut refused = self.refused.lock().unwrap_or_else(PoisonError::into_inner);
        match result {
            Ok(reply) if reply.cached => {}
            Err(error) if error.is_unreachable() => *refused = refused.saturating_add(1),
            _ => *refused = 0,
        }
    }

    fn is_hopeless(&self) -> bool {
        *self.refused.lock().unwrap_or_else(PoisonError::into_inner) >= REFUSED_MAX
    }
}
