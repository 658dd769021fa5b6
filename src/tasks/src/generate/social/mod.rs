//! Social annotation (paper, Social Interaction Annotation): what an expert has to ask before it
//! can know what is meant. The instruction is rewritten to leave something open, and questions
//! about it are put into the plan; whoever follows the plan asks them, so that an annotated
//! trajectory is an episode like any other.
//!
//! Strategy A is a dialogue of several turns before the execution (`dialogue`), and asks which object
//! is meant once the candidates are in view; strategy B asks which of several receptacles alike.
//! Nothing is asked that was told, and each reply narrows what is possible: [`settles`] plays the
//! conversation with the simulated user before a task is let through. Knows no file and no model;
//! what a model proposes (`proposal`) is judged by the same rules.

mod dialogue;
pub mod proposal;
mod talk;
mod words;

use std::fmt;

use crate::{Stream, wording::indefinite};
use reel_world::{PlanStep, ReceptacleId, Scene, Task};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::generate::task::describe;
pub use talk::{Objection, settles};
use words::{is_vague, moves_one, phrase_in, place_of_step, places, pool};

/// So many receptacles a question names; of more it only says that there are several.
const NAMED_MAX: usize = 4;

/// How the expert comes to speak (paper, Annotation Strategies).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
pub enum Strategy {
    /// Proactive clarification: the instruction is underspecified, and the robot asks before it begins.
    A,
    /// Disambiguation: several receptacles of a kind.
    B,
}

impl Strategy {
    /// Both strategies, in the order of their letters.
    pub const ALL: [Strategy; 2] = [Strategy::A, Strategy::B];

    /// As it stands in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Strategy::A => "A",
            Strategy::B => "B",
        }
    }

    /// Reads what [`Strategy::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|strategy| strategy.as_str() == text)
    }
}

/// What a question is about.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QuestionTopic {
    /// Which object is meant.
    Object,
    /// Which receptacle the object is to be taken from.
    Source,
    /// Where it shall go.
    Destination,
}

impl QuestionTopic {
    /// All, in the order in which they are asked.
    pub const ALL: [QuestionTopic; 3] = [
        QuestionTopic::Object,
        QuestionTopic::Source,
        QuestionTopic::Destination,
    ];

    /// As it stands in files.
    pub fn as_str(self) -> &'static str {
        match self {
            QuestionTopic::Object => "object",
            QuestionTopic::Source => "source",
            QuestionTopic::Destination => "destination",
        }
    }
}

/// A question in a plan.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Annotation {
    /// Strategy that calls for the question, A or B.
    pub strategy: Strategy,
    /// What it asks about.
    pub about: QuestionTopic,
    /// The step of the plan, as it was before, that it comes before.
    pub insert_before: usize,
    /// What is said; none where that depends on what is seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question: Option<String>,
}

/// What may be done.
#[derive(Clone, Copy, Debug)]
pub struct AnnotateOptions<'a> {
    /// The strategies that may be used.
    pub strategies: &'a [Strategy],
    /// Seed of all choices.
    pub seed: u64,
}

/// A task with questions in its plan.
#[derive(Clone, PartialEq, Debug)]
pub struct AnnotatedTask {
    /// The task; its field `social` says what was done.
    pub task: Task,
    /// What was done, in the order of the plan.
    pub annotations: Vec<Annotation>,
}

/// Why a task was left as it was.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// No plan to put questions into.
    NoPlan,
    /// There are questions in the plan.
    AsksAlready,
    /// It is vague about something that the strategies do not ask about.
    LeftVague,
    /// Nothing in the scene is like what is meant.
    NothingAlike,
    /// The instruction does not say it in words that could be left out.
    NotWorded,
    /// The user's answer would not settle it.
    NotSettled,
}

impl fmt::Display for SkipReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            SkipReason::NoPlan => "it has no plan",
            SkipReason::AsksAlready => "its plan asks already",
            SkipReason::LeftVague => "it is vague about what the strategies do not ask",
            SkipReason::NothingAlike => "nothing is like what is meant",
            SkipReason::NotWorded => "the instruction has no words for it that could be left out",
            SkipReason::NotSettled => "the user's answer would not settle it",
        })
    }
}

/// A question that may be asked, and the words that make it necessary.
#[derive(Clone)]
struct Proposal {
    annotation: Annotation,
    /// Words of the instruction, and what stands for them; none where it is vague already.
    instead: Option<(std::ops::Range<usize>, String)>,
}

/// Puts a dialogue, or one or two questions, into the plan of a task, by strategies drawn from those
/// that apply, and rewrites its instruction so that they have to be asked. What is vague already
/// is always asked about.
///
/// # Errors
/// The reason why nothing can be asked.
pub fn annotate(
    task: &Task,
    scene: &Scene,
    options: &AnnotateOptions<'_>,
) -> Result<AnnotatedTask, SkipReason> {
    if task.plan.is_empty() {
        return Err(SkipReason::NoPlan);
    }
    if task.plan.iter().any(|step| step.action == "ask") {
        return Err(SkipReason::AsksAlready);
    }
    let mut stream = Stream::new(
        options.seed,
        &format!("social/{}/{}", task.scene_id, task.task_id),
        0,
    );
    let allows = |strategy| options.strategies.contains(&strategy);
    let (mut needed, mut possible, mut why) = (Vec::new(), Vec::new(), SkipReason::NothingAlike);
    for about in QuestionTopic::ALL {
        let of_object = about == QuestionTopic::Object;
        let allowed = allows(if of_object { Strategy::A } else { Strategy::B });
        match propose(task, scene, about, &mut stream) {
            Ok(proposal) if proposal.instead.is_none() && !allowed => {
                return Err(SkipReason::LeftVague);
            }
            Ok(proposal) if proposal.instead.is_none() => needed.push(proposal),
            // An object is left open only as a part of a dialogue.
            Ok(proposal) if allowed && !of_object => possible.push(proposal),
            Ok(_) => {}
            Err(reason) => why = why.max(reason),
        }
    }
    let mut dialogues = Vec::new();
    let is_object = |proposal: &Proposal| proposal.annotation.about == QuestionTopic::Object;
    if allows(Strategy::A) && needed.iter().all(is_object) {
        let is_destination = |one: &&Proposal| one.annotation.about == QuestionTopic::Destination;
        let kinds = [None, possible.iter().find(is_destination)];
        for (index, kind) in kinds.into_iter().enumerate() {
            if index > 0 && kind.is_none() {
                continue;
            }
            match dialogue::propose(task, scene, kind, &mut stream) {
                Ok(turns) => dialogues.push(turns),
                Err(reason) => why = why.max(reason),
            }
        }
    }
    let questions = sets_of_questions(needed, &possible, &mut stream);
    if dialogues.len() > 1 && stream.below(2) == 0 {
        dialogues.reverse();
    }
    let sets = if allows(Strategy::B) && stream.below(2) == 0 {
        [questions, dialogues]
    } else {
        [dialogues, questions]
    };
    for chosen in sets.concat() {
        if names_one_kind_twice(task, scene, &chosen) {
            continue;
        }
        let annotations = chosen
            .iter()
            .map(|proposal| proposal.annotation.clone())
            .collect();
        match apply(
            task,
            scene,
            reworded(&task.instruction, &chosen),
            annotations,
        ) {
            Ok(annotated) => return Ok(annotated),
            Err(_) => why = why.max(SkipReason::NotSettled),
        }
    }
    Err(why)
}

/// What is needed with up to two of the possible questions, in the order in which to try them.
fn sets_of_questions(
    needed: Vec<Proposal>,
    possible: &[Proposal],
    stream: &mut Stream,
) -> Vec<Vec<Proposal>> {
    let wanted = 1 + stream.below(2);
    let order = stream.pick_some(&(0..possible.len()).collect::<Vec<_>>(), possible.len());
    let mut choices: Vec<Vec<usize>> = Vec::new();
    if needed.is_empty() && wanted == 2 {
        choices.extend(
            order
                .iter()
                .enumerate()
                .flat_map(|(at, one)| order[at + 1..].iter().map(|other| vec![*one, *other])),
        );
    }
    if needed.len() < wanted {
        choices.extend(order.iter().map(|one| vec![*one]));
    }
    if !needed.is_empty() {
        choices.push(Vec::new());
    }
    let with = |choice: Vec<usize>| {
        let chosen = choice.iter().map(|index| possible[*index].clone());
        needed.iter().cloned().chain(chosen).collect()
    };
    choices.into_iter().map(with).collect()
}

/// "From a table to a table" is nothing that people say.
fn names_one_kind_twice(task: &Task, scene: &Scene, chosen: &[Proposal]) -> bool {
    let by_kind = |about| {
        chosen
            .iter()
            .any(|one| one.annotation.about == about && one.annotation.strategy == Strategy::B)
    };
    by_kind(QuestionTopic::Source)
        && by_kind(QuestionTopic::Destination)
        && (alike(scene, &task.src, &task.dest) || alike(scene, &task.dest, &task.src))
}

/// Puts these questions under this instruction, if the outcome is as it shall be: see [`settles`].
///
/// # Errors
/// What speaks against it.
pub fn apply(
    task: &Task,
    scene: &Scene,
    instruction: String,
    mut annotations: Vec<Annotation>,
) -> Result<AnnotatedTask, Objection> {
    annotations.sort_by_key(|annotation| {
        (
            annotation.insert_before,
            annotation.about != QuestionTopic::Source,
        )
    });
    let mut next = task.clone();
    let is_told = instruction == task.instruction;
    next.instruction = instruction;
    next.fuzzy = true;
    if annotations
        .iter()
        .any(|annotation| annotation.about == QuestionTopic::Object)
        && next.purpose.is_none()
    {
        next.purpose = Some(task.target_object().category.clone());
    }
    talk::admits(task, scene, &annotations)?;
    insert(&mut next.plan, &annotations);
    talk::settles(&next, scene)?;
    talk::leaves_the_rest(task, &next, scene, &annotations)?;
    // One more question that can pay (docs/spec.md#reward-preset-paper, `B_ask`), if receptacles
    // were told apart before.
    let vaguer = QuestionTopic::ALL[1..].iter().any(|about| {
        places(task, scene, *about, &[&task.instruction]).len() < 2
            && places(&next, scene, *about, &[&next.instruction]).len() > 1
    });
    if let (true, Some(budget)) = (vaguer, next.extra.get_mut("episodes[0].ask_budget")) {
        *budget = json!(budget.as_u64().map_or(1, |asks| (asks + 1).min(3)));
    }
    let mut social = json!({ "annotations": annotations });
    if !is_told {
        social["instruction_before"] = json!(task.instruction);
    }
    next.extra.insert(FIELD.to_owned(), social);
    Ok(AnnotatedTask {
        task: next,
        annotations,
    })
}

/// Where a task file says what was done to it.
pub const FIELD: &str = "episodes[0].social";

/// Puts questions into a plan, the last one first, so that the indices of the others stay valid; of
/// several before one step, the first comes first.
///
/// # Panics
/// When an index is beyond the end of the plan.
pub fn insert(plan: &mut Vec<PlanStep>, annotations: &[Annotation]) {
    let mut order: Vec<&Annotation> = annotations.iter().collect();
    order.sort_by_key(|annotation| annotation.insert_before);
    for annotation in order.into_iter().rev() {
        let text = |text: &str| Value::from(text);
        let mut args = [
            ("strategy", text(annotation.strategy.as_str())),
            ("about", text(annotation.about.as_str())),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .to_vec();
        args.extend(
            annotation
                .question
                .as_deref()
                .map(|question| ("question".to_owned(), text(question))),
        );
        plan.insert(
            annotation.insert_before,
            PlanStep {
                action: "ask".to_owned(),
                args: args.into_iter().collect(),
            },
        );
    }
}

fn propose(
    task: &Task,
    scene: &Scene,
    about: QuestionTopic,
    stream: &mut Stream,
) -> Result<Proposal, SkipReason> {
    match about {
        QuestionTopic::Object => object(task, scene),
        QuestionTopic::Source | QuestionTopic::Destination => place(task, scene, about, stream),
    }
}

/// Proposes a question about the target object, asked in view of the candidates (strategy A).
fn object(task: &Task, scene: &Scene) -> Result<Proposal, SkipReason> {
    if !moves_one(task) {
        return Err(SkipReason::NothingAlike);
    }
    let find = task
        .plan
        .iter()
        .position(|step| step.action == "find")
        .ok_or(SkipReason::NotWorded)?;
    let proposal = |instead| Proposal {
        annotation: Annotation {
            strategy: Strategy::A,
            about: QuestionTopic::Object,
            insert_before: find + 1,
            question: None,
        },
        instead,
    };
    if is_vague(task, scene, QuestionTopic::Object) {
        return Ok(proposal(None));
    }
    let target = task.target_object();
    let alike = task
        .objects
        .iter()
        .filter(|object| object.receptacle == task.src && object.category == target.category)
        .count();
    if alike < 2 {
        return Err(SkipReason::NothingAlike);
    }
    let caption = target.caption.as_deref().unwrap_or_default();
    let phrases = describe::object(&target.category, caption, &target.attributes);
    let at = phrase_in(&task.instruction, &phrases).ok_or(SkipReason::NotWorded)?;
    Ok(proposal(Some((at, indefinite(&target.category)))))
}

/// Proposes a question about the source or the destination (strategy B).
fn place(
    task: &Task,
    scene: &Scene,
    about: QuestionTopic,
    stream: &mut Stream,
) -> Result<Proposal, SkipReason> {
    let is_source = about == QuestionTopic::Source;
    let right = scene
        .receptacle(if is_source { &task.src } else { &task.dest })
        .ok_or(SkipReason::NotWorded)?;
    let likes = pool(task, scene, about);
    if likes.len() < 2 || (is_source && !moves_one(task)) {
        return Err(SkipReason::NothingAlike);
    }
    let vaguely = indefinite(&right.category);
    let instead = if is_vague(task, scene, about) {
        None
    } else {
        let phrases = words::names(right, scene);
        Some((
            phrase_in(&task.instruction, &phrases).ok_or(SkipReason::NotWorded)?,
            vaguely,
        ))
    };
    let category = &right.category;
    let inside = right.door.exists();
    let (ask, names) = if is_source {
        let ways = if inside {
            ["look in", "check"]
        } else {
            ["look on", "check"]
        };
        let mut rooms: Vec<String> = Vec::new();
        for like in &likes {
            let room = format!("the one in the {}", like.room_name());
            if !rooms.contains(&room) {
                rooms.push(room);
            }
        }
        (
            format!("Which {category} should I {}", ways[stream.below(2)]),
            Some(rooms),
        )
    } else {
        let ways = if inside {
            ["put it into", "bring it to"]
        } else {
            ["put it on", "bring it to"]
        };
        let names = likes
            .iter()
            .map(|like| words::name(like, scene))
            .collect::<Option<Vec<String>>>();
        (
            format!("Which {category} should I {}", ways[stream.below(2)]),
            names,
        )
    };
    let question = match names.filter(|names| names.len() <= NAMED_MAX) {
        Some(names) => format!("{ask}: {}?", or(&names)),
        None => format!("There are several. {ask}?"),
    };
    // Before the way to the destination, detours included, or before everything.
    let way = task
        .plan
        .iter()
        .position(|step| place_of_step(step) == Some(task.dest.as_str()))
        .unwrap_or(0);
    let is_visit = |step: &PlanStep| step.action == "nav_to";
    let way = way
        - task.plan[..way]
            .iter()
            .rev()
            .take_while(|step| is_visit(step))
            .count();
    let insert_before = if is_source || stream.below(2) == 0 {
        0
    } else {
        way
    };
    let annotation = Annotation {
        strategy: Strategy::B,
        about,
        insert_before,
        question: Some(question),
    };
    Ok(Proposal {
        annotation,
        instead,
    })
}

/// The instruction with vaguer words in the places of these.
fn reworded(instruction: &str, proposals: &[Proposal]) -> String {
    let mut all: Vec<_> = proposals
        .iter()
        .filter_map(|proposal| proposal.instead.clone())
        .collect();
    all.sort_by_key(|(at, _)| std::cmp::Reverse(at.start));
    let mut text = instruction.to_owned();
    for (at, vaguely) in all {
        text.replace_range(at, &vaguely);
    }
    text
}

fn alike(scene: &Scene, one: &ReceptacleId, other: &ReceptacleId) -> bool {
    let category = |id| {
        scene
            .receptacle(id)
            .map_or("", |receptacle| receptacle.category.as_str())
    };
    words::is_called(category(one), category(other))
}

fn or(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => one.clone(),
        [firsts @ .., last] => format!("{} or {last}", firsts.join(", ")),
    }
}
