//! What a model may propose: the words it is asked in, and its answer, judged by the rules of every
//! other annotation. Never speaks to a model.

use reel_world::{Digest, Scene, Task};
use serde::Deserialize;
use serde_json::{Deserializer, Map, Value, json};

use super::{AnnotatedTask, Annotation, Objection, QuestionTopic, Strategy, apply};

/// What the model is told before it gets a task.
pub const PROMPT: &str = include_str!("../../../prompts/social.md");

/// What stands before the floor plan of the scene, where the model gets it.
pub const IMAGE_CAPTION: &str = "The scene from above, with rooms by name and receptacles by id:";

/// Places in an answer that are tried as the beginning of a JSON object.
const TRIES_MAX: usize = 200;

/// Why a proposal is not taken.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum ProposalError {
    /// No proposal in the answer.
    #[error("the answer holds no proposal that can be read")]
    Unreadable,
    /// A strategy that was not asked for.
    #[error("strategy {0} was not asked for")]
    Strategy(&'static str),
    /// A question about a receptacle has no words.
    #[error("the question about the {0} has no words")]
    NoWords(&'static str),
    /// It breaks a rule.
    #[error(transparent)]
    Rule(#[from] Objection),
}

impl ProposalError {
    /// The kind of it, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            ProposalError::Unreadable => "the answer holds no proposal that can be read",
            ProposalError::Strategy(_) => "a strategy was not asked for",
            ProposalError::NoWords(_) => "a question about a receptacle has no words",
            ProposalError::Rule(objection) => objection.kind(),
        }
    }
}

/// An answer as it is wanted.
#[derive(Deserialize)]
struct Proposed {
    instruction: String,
    actions: Vec<Action>,
}

#[derive(Deserialize)]
struct Action {
    strategy: Strategy,
    about: QuestionTopic,
    insert_before: usize,
    question: Option<String>,
}

/// The version of the prompt.
pub fn prompt_version() -> Digest {
    Digest::of(PROMPT.as_bytes())
}

/// A task in its scene, as the model gets it.
pub fn summary(task: &Task, scene: &Scene, strategies: &[Strategy]) -> String {
    let receptacles = scene.receptacles.iter().map(|one| {
        let names: Vec<&String> = one.captions.keys().collect();
        json!({ "id": one.id, "category": one.category, "room": one.room, "called": names, "door": one.door.exists() })
    });
    let objects = task.objects.iter().map(|object| {
        json!({ "category": object.category, "looks": object.caption, "on": object.receptacle, "is_target": object.instance == task.target })
    });
    let plan = task.plan.iter().enumerate().map(|(index, step)| {
        let args: Map<String, Value> = step
            .args
            .iter()
            .filter(|(key, _)| *key != "instance")
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        json!({ "step": index, "action": step.action, "args": args })
    });
    let lines = |title: &str, lines: &mut dyn Iterator<Item = Value>| {
        let lines: Vec<String> = lines.map(|line| line.to_string()).collect();
        format!("{title}:\n{}\n", lines.join("\n"))
    };
    let strategies: Vec<&str> = strategies
        .iter()
        .map(|strategy| strategy.as_str())
        .collect();
    [
        format!("Strategies: {}\n", strategies.join(", ")),
        format!(
            "Instruction: {}\nPrecise instruction: {}\n",
            task.instruction, task.precise_instruction
        ),
        format!("From {} to {}\n", task.src, task.dest),
        lines("Plan", &mut plan.into_iter()),
        lines("Receptacles", &mut receptacles.into_iter()),
        lines("Objects", &mut objects.into_iter()),
    ]
    .concat()
}

/// Does what a model answered, if nothing speaks against it.
///
/// # Errors
/// What does.
pub fn judge(
    task: &Task,
    scene: &Scene,
    strategies: &[Strategy],
    answer: &str,
) -> Result<AnnotatedTask, ProposalError> {
    let proposed = parse(answer).ok_or(ProposalError::Unreadable)?;
    let mut annotations = Vec::new();
    for Action {
        strategy,
        about,
        insert_before,
        question,
    } in proposed.actions
    {
        if !strategies.contains(&strategy) {
            return Err(ProposalError::Strategy(strategy.as_str()));
        }
        // What is seen when it is asked which object is meant, nobody knows yet.
        let question = question.filter(|_| about != QuestionTopic::Object);
        if question.is_none() && about != QuestionTopic::Object {
            return Err(ProposalError::NoWords(about.as_str()));
        }
        annotations.push(Annotation {
            strategy,
            about,
            insert_before,
            question,
        });
    }
    Ok(apply(task, scene, proposed.instruction, annotations)?)
}

/// The last proposal of an answer: thoughts before it and fences around it do not matter.
fn parse(text: &str) -> Option<Proposed> {
    let answer = text
        .rsplit_once("</think>")
        .map_or(text, |(_, answer)| answer);
    let starts = answer.match_indices('{').take(TRIES_MAX);
    let read = |at: usize| {
        Deserializer::from_str(&answer[at..])
            .into_iter::<Proposed>()
            .next()?
            .ok()
    };
    starts.filter_map(|(at, _)| read(at)).last()
}
