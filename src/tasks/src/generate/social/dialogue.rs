//! Strategy A (paper, Annotation Strategies): a dialogue of several turns before the first step of
//! the execution. The instruction says neither where the object is nor where it shall go; the robot
//! asks, and the user tells as much as its rules allow. Proposes turns; `talk` judges them.

use reel_world::{Scene, Task};

use super::{
    Annotation, Proposal, QuestionTopic, SkipReason, Strategy, object,
    words::{self, is_silent, is_vague, moves_one, phrase_in, pool},
};
use crate::Stream;

/// Stands in an instruction for the receptacle that an object is on.
const SOMEWHERE: &str = "somewhere in the home";
/// Stands in an instruction for the destination.
const ITS_PLACE: &str = "its place";

/// The turns of a task's dialogue, in their order, and the question that follows once the robot has
/// seen the candidates, where the object is left open too. With `kind`, the destination is what
/// strategy B proposed: the instruction says its kind, and the turn asks which one.
///
/// # Errors
/// The reason why there is no dialogue of two turns.
pub(super) fn propose(
    task: &Task,
    scene: &Scene,
    kind: Option<&Proposal>,
    stream: &mut Stream,
) -> Result<Vec<Proposal>, SkipReason> {
    if !moves_one(task) {
        return Err(SkipReason::NothingAlike);
    }
    let by_sight = object(task, scene).ok().filter(|proposal| {
        let is_open_already = proposal.instead.is_none();
        stream.below(2) == 0 || is_open_already
    });
    let source = turn(task, scene, QuestionTopic::Source, SOMEWHERE)?;
    let wanted = wanted(task, scene, by_sight.is_some()).ok_or(SkipReason::NotWorded)?;
    let ask_source = if by_sight.is_some() && stream.below(2) == 0 {
        format!("Which {wanted} do you mean, and where should I look for it?")
    } else {
        format!("Where should I look for the {wanted}?")
    };
    let destination = match kind {
        Some(kind) => {
            let mut kind = kind.clone();
            kind.annotation.insert_before = 0;
            kind
        }
        None => {
            let ask = ["Where should I put it?", "Where should I bring it to?"][stream.below(2)];
            let turn = turn(task, scene, QuestionTopic::Destination, ITS_PLACE)?;
            with_question(turn, ask.to_owned())
        }
    };
    let mut turns = vec![with_question(source, ask_source), destination];
    turns.extend(by_sight);
    Ok(turns)
}

/// A turn about one end of the way, still without words.
fn turn(
    task: &Task,
    scene: &Scene,
    about: QuestionTopic,
    instead: &str,
) -> Result<Proposal, SkipReason> {
    // "A table" is what strategy B asks about.
    if is_vague(task, scene, about) {
        return Err(SkipReason::NotWorded);
    }
    if pool(task, scene, about).is_empty() {
        return Err(SkipReason::NothingAlike);
    }
    let id = if about == QuestionTopic::Source {
        &task.src
    } else {
        &task.dest
    };
    let right = scene.receptacle(id).ok_or(SkipReason::NotWorded)?;
    let instead = if is_silent(task, scene, about) {
        None
    } else {
        let at = phrase_in(&task.instruction, &words::names(right, scene));
        Some((at.ok_or(SkipReason::NotWorded)?, instead.to_owned()))
    };
    Ok(Proposal {
        annotation: Annotation {
            strategy: Strategy::A,
            about,
            insert_before: 0,
            question: None,
        },
        instead,
    })
}

fn with_question(mut turn: Proposal, question: String) -> Proposal {
    turn.annotation.question = Some(question);
    turn
}

/// What the robot calls the object before it has seen anything: as the instruction does. `None` if
/// the instruction does not speak of it.
fn wanted(task: &Task, scene: &Scene, is_open: bool) -> Option<String> {
    let target = task.target_object();
    if is_open {
        let kind = task.purpose.as_ref().unwrap_or(&target.category);
        return Some(kind.clone());
    }
    let told = words::told(task, scene, QuestionTopic::Object);
    told.into_iter().next().map(without_article)
}

fn without_article(name: String) -> String {
    let bare = ["the ", "a ", "an "]
        .iter()
        .find_map(|article| name.strip_prefix(article));
    bare.map(str::to_owned).unwrap_or(name)
}
