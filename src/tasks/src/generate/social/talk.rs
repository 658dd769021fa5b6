//! The conversation of a plan, played with the simulated user: whether every question has to be
//! asked, and is settled by its answer. Pure predicates; what the robot sees when it asks is taken
//! to be all that stands where it looks.

use std::{collections::BTreeMap, sync::Arc};

use reel_episode::user::{RuleUser, clarifying_question, spoken_id};
use reel_sim::{PreparedTask, Simulator, render::Detail};
use reel_world::{InstanceId, ObjectInstance, PlanStep, Profile, Scene, Task, language};
use serde_json::Value;

use super::{
    Annotation, QuestionTopic, Strategy,
    words::{self, place_of_step},
};

/// What speaks against questions in a plan.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum Objection {
    /// The list of questions for the plan is empty.
    #[error("there is no question")]
    Nothing,
    /// The strategy does not ask about that.
    #[error("strategy {strategy} does not ask about the {about}")]
    Strategy {
        /// Name of the strategy, `A` or `B`.
        strategy: &'static str,
        about: &'static str,
    },
    /// Strategy A in less than a dialogue.
    #[error("strategy A is a dialogue: at least two questions come before the first step")]
    OneTurn,
    /// Strategy A about what the instruction names.
    #[error("strategy A asks about the {about}, whose kind the instruction names")]
    Named {
        /// Topic whose kind is named: `source` or `destination`.
        about: &'static str,
    },
    /// It comes at the wrong time.
    #[error("the question about the {about} cannot come before step {index}")]
    Place { about: &'static str, index: usize },
    /// Not a question, or of more than one line, or far too long.
    #[error("the text {text:?} cannot be said")]
    Unspeakable { text: String },
    /// It speaks an identifier.
    #[error("the text {text:?} speaks the identifier {id}")]
    Identifier { text: String, id: String },
    /// What was told before leaves fewer than two possible, or not the right one.
    #[error("before the question about the {about} {possible:?} are possible")]
    Unneeded {
        about: &'static str,
        possible: Vec<String>,
    },
    /// The answer does not leave the right one alone.
    #[error("after {reply:?} about the {about} {possible:?} are possible")]
    Unsettled {
        about: &'static str,
        reply: String,
        possible: Vec<String>,
    },
    /// It was left open before, and nothing asks about it.
    #[error("the instruction leaves the {about} open, and nothing asks about it")]
    LeftVague {
        /// Topic that is left open: `object`, `source` or `destination`.
        about: &'static str,
    },
    /// The instruction does not even say what kind of thing it is.
    #[error("the instruction does not say what the {about} is")]
    Unnamed {
        /// Topic whose kind is not named: `object`, `source` or `destination`.
        about: &'static str,
    },
    /// What nobody asks about is told otherwise than before.
    #[error("the instruction tells the {about} otherwise than before, and nothing asks about it")]
    Rest {
        /// Topic that is worded differently: `object`, `source` or `destination`.
        about: &'static str,
    },
}

impl Objection {
    /// The kind of it, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            Objection::Nothing => "there is no question",
            Objection::Strategy { .. } => "a strategy does not ask about that",
            Objection::OneTurn => "strategy A is less than a dialogue",
            Objection::Named { .. } => "strategy A asks about what the instruction names",
            Objection::Place { .. } => "a question is at a step where it cannot be asked",
            Objection::Unspeakable { .. } => "a text cannot be said",
            Objection::Identifier { .. } => "a text speaks an identifier",
            Objection::Unneeded { .. } => "a question does not have to be asked",
            Objection::Unsettled { .. } => "the answer does not settle a question",
            Objection::LeftVague { .. } => "something is left open that nothing asks about",
            Objection::Unnamed { .. } => "the instruction does not say what is asked about",
            Objection::Rest { .. } => "something is told otherwise that nothing asks about",
        }
    }
}

/// Longest text in bytes that is said.
const TEXT_MAX: usize = 600;

/// Whether questions may come where they shall: about the object once it was looked for and before
/// it is picked, about a receptacle before anything is done there or at one like it. Strategy A needs
/// two turns before the first step, unless it only asks about an object that was vague before.
pub(super) fn admits(
    task: &Task,
    scene: &Scene,
    annotations: &[Annotation],
) -> Result<(), Objection> {
    if annotations.is_empty() {
        return Err(Objection::Nothing);
    }
    for annotation in annotations {
        let (about, index) = (annotation.about, annotation.insert_before);
        let by_a = annotation.strategy == Strategy::A;
        if about == QuestionTopic::Object && !by_a {
            return Err(Objection::Strategy {
                strategy: annotation.strategy.as_str(),
                about: about.as_str(),
            });
        }
        let twice = annotations
            .iter()
            .filter(|other| other.about == about)
            .count()
            > 1;
        let before = task.plan.get(..index);
        let is = |step: &PlanStep, actions: &[&str]| actions.contains(&step.action.as_str());
        let at = |step: &PlanStep, id: &str| place_of_step(step) == Some(id);
        let fits = before.is_some_and(|before| match about {
            QuestionTopic::Object => {
                before.iter().any(|step| is(step, &["find"]))
                    && !before.iter().any(|step| is(step, &["pick", "gaze_at"]))
            }
            QuestionTopic::Source => before.is_empty(),
            QuestionTopic::Destination if by_a => before.is_empty(),
            QuestionTopic::Destination => !before.iter().any(|step| at(step, task.dest.as_str())),
        });
        if twice || !fits {
            return Err(Objection::Place {
                about: about.as_str(),
                index,
            });
        }
    }
    let turns = annotations
        .iter()
        .filter(|annotation| annotation.insert_before == 0);
    let mut by_a = annotations
        .iter()
        .filter(|annotation| annotation.strategy == Strategy::A);
    let was_vague = words::is_vague(task, scene, QuestionTopic::Object);
    let needs_dialogue =
        by_a.any(|annotation| annotation.about != QuestionTopic::Object || !was_vague);
    if needs_dialogue && turns.count() < 2 {
        return Err(Objection::OneTurn);
    }
    Ok(())
}

/// Whether every question of a plan has to be asked, and its answer settles it: what was told
/// before (the instruction and the answers) leaves at least two possible, among them the right one,
/// and with the answer only that one. Where strategy A asks for the source, the answer leaves fewer:
/// of a source that the instruction is silent about the user tells the room. No text holds an
/// identifier.
///
/// # Errors
/// The first question that is not so.
pub fn settles(task: &Task, scene: &Scene) -> Result<(), Objection> {
    speakable(task, scene, &task.instruction)?;
    let mut user = RuleUser::new(task, scene);
    // Whoever has seen the target is told no more where it is.
    if task
        .plan
        .iter()
        .any(|step| asks_about(step) == Some(QuestionTopic::Source))
    {
        user.observe("", &seen_at_start(task, scene));
    }
    let mut answers: BTreeMap<QuestionTopic, Vec<String>> = BTreeMap::new();
    for step in &task.plan {
        match step.action.as_str() {
            "find" => {
                let place = &meant(task, step).receptacle;
                let seen: Vec<InstanceId> = on(task, place)
                    .map(|object| object.instance.clone())
                    .collect();
                user.observe("find", &seen);
            }
            "pick" => user.observe_held(Some(&meant(task, step).instance)),
            "place" => user.observe_held(None),
            "ask" => {
                let about = asks_about(step).unwrap_or(QuestionTopic::Object);
                let words = step.args.get("question").and_then(Value::as_str);
                let question = words.map_or_else(|| question(task), str::to_owned);
                speakable(task, scene, &question)?;
                let said = answers.entry(about).or_default();
                let possible = possible(task, scene, about, said);
                let right = right(task, about);
                if possible.len() < 2 || !possible.contains(&right) {
                    return Err(Objection::Unneeded {
                        about: about.as_str(),
                        possible,
                    });
                }
                let before = possible.len();
                let reply = user.answer(&question).text;
                said.push(reply.clone());
                let possible = self::possible(task, scene, about, said);
                let narrows = about == QuestionTopic::Source && is_by_a(step);
                let is_settled = if narrows {
                    possible.contains(&right) && possible.len() < before
                } else {
                    possible == [right]
                };
                if !is_settled {
                    return Err(Objection::Unsettled {
                        about: about.as_str(),
                        reply,
                        possible,
                    });
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// Whether an instruction leaves what nobody asks about as it was, and says of the rest what it is.
pub(super) fn leaves_the_rest(
    before: &Task,
    after: &Task,
    scene: &Scene,
    annotations: &[Annotation],
) -> Result<(), Objection> {
    let unasked = |about: &QuestionTopic| {
        !annotations
            .iter()
            .any(|annotation| annotation.about == *about)
    };
    for about in QuestionTopic::ALL.into_iter().filter(unasked) {
        if words::is_vague(before, scene, about) {
            return Err(Objection::LeftVague {
                about: about.as_str(),
            });
        }
        let kept = |name: &String| language::quotes(&after.instruction, name);
        let is_told = words::told(before, scene, about).iter().all(kept);
        if !is_told || possible(before, scene, about, &[]) != possible(after, scene, about, &[]) {
            return Err(Objection::Rest {
                about: about.as_str(),
            });
        }
    }
    for annotation in annotations {
        let about = annotation.about;
        if annotation.strategy == Strategy::A && about != QuestionTopic::Object {
            if !words::is_silent(after, scene, about) {
                return Err(Objection::Named {
                    about: about.as_str(),
                });
            }
            continue;
        }
        let category = |id| {
            scene
                .receptacle(id)
                .map_or("", |receptacle| receptacle.category.as_str())
        };
        let kind = match annotation.about {
            QuestionTopic::Object => after.purpose.as_deref().unwrap_or_default(),
            QuestionTopic::Source => category(&after.src),
            QuestionTopic::Destination => category(&after.dest),
        };
        if !language::quotes(&after.instruction, kind) {
            return Err(Objection::Unnamed {
                about: annotation.about.as_str(),
            });
        }
    }
    Ok(())
}

/// What instruction and answers leave possible, by identifier.
fn possible(task: &Task, scene: &Scene, about: QuestionTopic, answers: &[String]) -> Vec<String> {
    let mut texts = vec![task.instruction.as_str()];
    texts.extend(answers.iter().map(String::as_str));
    match about {
        QuestionTopic::Object => words::objects(task, &texts)
            .iter()
            .map(|object| object.instance.to_string())
            .collect(),
        _ => words::places(task, scene, about, &texts)
            .iter()
            .map(|place| place.id.to_string())
            .collect(),
    }
}

fn right(task: &Task, about: QuestionTopic) -> String {
    match about {
        QuestionTopic::Object => task.target.to_string(),
        QuestionTopic::Source => task.src.to_string(),
        QuestionTopic::Destination => task.dest.to_string(),
    }
}

fn is_by_a(step: &PlanStep) -> bool {
    step.args.get("strategy").and_then(Value::as_str) == Some(Strategy::A.as_str())
}

fn asks_about(step: &PlanStep) -> Option<QuestionTopic> {
    let about = step
        .args
        .get("about")
        .filter(|_| step.action == "ask")?
        .as_str()?;
    QuestionTopic::ALL
        .into_iter()
        .find(|known| known.as_str() == about)
}

/// What is in the first image of an episode.
fn seen_at_start(task: &Task, scene: &Scene) -> Vec<InstanceId> {
    let stage = PreparedTask::new(Arc::new(scene.clone()), Arc::new(task.clone()));
    let mut simulator = Simulator::new(stage, Profile::Paper, 0);
    simulator.set_detail(Detail::Geometry);
    simulator.capture_frame();
    simulator
        .visible()
        .into_iter()
        .map(|seen| seen.object)
        .collect()
}

/// The question in words for what is seen, as one asks who sees all that stands there.
fn question(task: &Task) -> String {
    clarifying_question(
        on(task, &task.src).map(|object| object.caption.as_deref().unwrap_or(&object.category)),
        task.purpose.as_deref(),
    )
}

fn speakable(task: &Task, scene: &Scene, text: &str) -> Result<(), Objection> {
    if text.trim().is_empty() || text.len() > TEXT_MAX || text.chars().any(char::is_control) {
        return Err(Objection::Unspeakable {
            text: text.to_owned(),
        });
    }
    match spoken_id(task, scene, text) {
        Some(id) => Err(Objection::Identifier {
            text: text.to_owned(),
            id: id.to_owned(),
        }),
        None => Ok(()),
    }
}

fn meant<'a>(task: &'a Task, step: &PlanStep) -> &'a ObjectInstance {
    let named = step
        .args
        .get("instance")
        .and_then(Value::as_str)
        .and_then(|instance| task.object(&instance.into()));
    named.unwrap_or_else(|| task.target_object())
}

fn on<'a>(
    task: &'a Task,
    place: &reel_world::ReceptacleId,
) -> impl Iterator<Item = &'a ObjectInstance> {
    task.objects
        .iter()
        .filter(move |object| object.receptacle == *place)
}
