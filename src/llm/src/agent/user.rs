//! A simulated user that is a model: it knows the profile (where everything was, what was wanted,
//! the instruction), what the robot saw last and what was said before; four rules bind it
//! (docs/spec.md#simulated-user). Whether it kept them is checked by `reel_agents::ask_user` before
//! the robot hears a reply, and by `reel_episode::user::violations`, apart from it.

use std::{fmt::Write as _, sync::Arc};

use crate::client::{Client, Message, Request, Role};
use reel_agents::{ResponderError, User};
use reel_episode::user::UserQuestion;
use reel_world::{
    Digest, InstanceId, Receptacle, Scene, Task,
    record::{UserReply, UserSource},
};

/// System prompt that tells the model how to act as the user.
const PROMPT: &str = include_str!("../../texts/user.txt");
/// Longest reply that is passed on, in characters.
const REPLY_LENGTH_MAX: usize = 600;

/// A model as the user.
pub struct ModelUser {
    client: Arc<Client>,
}

impl ModelUser {
    /// One that nothing was asked yet.
    pub fn new(client: Arc<Client>) -> Self {
        Self { client }
    }

    /// Names the wording it is asked in.
    pub fn prompt_digest() -> Digest {
        Digest::of(PROMPT.as_bytes())
    }
}

impl User for ModelUser {
    fn answer(&mut self, asked: &UserQuestion<'_>) -> Result<UserReply, ResponderError> {
        let messages = vec![
            Message::text(Role::System, PROMPT.trim_end()),
            Message::text(Role::User, situation(asked)),
        ];
        let reply = self
            .client
            .complete(&Request {
                messages,
                ..Request::default()
            })
            .map_err(ResponderError::new)?;
        let text = if reply.truncated {
            // Half a sentence may mean the opposite.
            String::new()
        } else {
            spoken(&reply.text)
        };
        Ok(UserReply {
            text,
            source: UserSource::Model,
        })
    }
}

/// What is said of an answer: models that reason show it, and people do not.
fn spoken(answer: &str) -> String {
    let said = answer
        .rsplit_once("</think>")
        .map_or(answer, |(_, said)| said);
    let said = said.split_once("<think>").map_or(said, |(said, _)| said);
    let said = said.trim().trim_matches('"').trim();
    said.chars().take(REPLY_LENGTH_MAX).collect()
}

/// The profile, the auxiliary observation, the dialogue and the question.
fn situation(asked: &UserQuestion<'_>) -> String {
    let UserQuestion {
        task,
        scene,
        initial,
        steps,
        question,
        refused,
        ..
    } = asked;
    let mut text = format!(
        "What you told the robot: {}\n\nWhere things were at the start:\n",
        task.instruction
    );
    for receptacle in &scene.receptacles {
        let here = initial.objects_on(&receptacle.id);
        if !here.is_empty() {
            let things: Vec<String> = here.iter().map(|object| described(task, object)).collect();
            let _ = writeln!(text, "- {}: {}", called(receptacle), things.join("; "));
        }
    }
    let place = |id| {
        scene
            .receptacle(id)
            .map_or_else(|| "its place".to_owned(), called)
    };
    let target = described(task, &task.target);
    let _ = write!(
        text,
        "\nWhat you want: {target}, from {}, shall be at {}.\n",
        place(&task.src),
        place(&task.dest)
    );
    let seen: Vec<String> = asked
        .sees()
        .into_iter()
        .map(|object| described(task, object))
        .collect();
    let action = steps.last().map_or_else(
        || "none yet".to_owned(),
        |step| without_ids(scene, &step.input.call.to_string()),
    );
    let seen = if seen.is_empty() {
        "nothing".to_owned()
    } else {
        seen.join("; ")
    };
    let reported = if asked.reported_target() {
        "has reported"
    } else {
        "has not reported"
    };
    let _ = write!(
        text,
        "\nThe robot's last action: {action}\nIt sees: {seen}\nIt {reported} that it sees the thing you mean.\n\nSaid before:\n"
    );
    let said: Vec<String> = steps.iter().filter_map(said).collect();
    text.push_str(if said.is_empty() { "(nothing)\n" } else { "" });
    text.extend(said);
    let _ = write!(text, "\nThe robot asks: {question}\n");
    for reply in *refused {
        let _ = write!(
            text,
            "\nYou were about to say: {}\nThat breaks a rule: {}. Say it otherwise.\n",
            reply.text,
            reply
                .rules
                .iter()
                .map(|rule| broken(rule))
                .collect::<Vec<_>>()
                .join("; ")
        );
    }
    text
}

/// What a broken rule means.
fn broken(rule: &str) -> &str {
    match rule {
        "exact_position" => "it says where the thing stands",
        "raw_id" => "it uses an identifier of a computer",
        "empty" => "it says nothing",
        other => other,
    }
}

fn said(step: &reel_world::record::StepRecord) -> Option<String> {
    let question = step
        .input
        .call
        .arguments
        .get("question")
        .and_then(|text| text.as_str())
        .unwrap_or_default();
    Some(format!(
        "Robot: {question}\nYou: {}\n",
        step.reply.as_ref()?.text
    ))
}

/// Category and caption, as one sees them.
fn described(task: &Task, object: &InstanceId) -> String {
    let Some(object) = task.object(object) else {
        return "a thing".to_owned();
    };
    match &object.caption {
        Some(caption) => format!("{} ({})", object.category, caption.trim_end_matches('.')),
        None => object.category.clone(),
    }
}

/// A receptacle in a person's words.
fn called(receptacle: &Receptacle) -> String {
    let caption = receptacle.main_caption().unwrap_or(&receptacle.category);
    format!("{caption} in the {}", receptacle.room_name())
}

/// A call in which furniture goes by the words of people.
fn without_ids(scene: &Scene, call: &str) -> String {
    let mut receptacles: Vec<&Receptacle> = scene.receptacles.iter().collect();
    // Longer ids first: `table_1` is the beginning of `table_10`.
    receptacles.sort_by_key(|receptacle| std::cmp::Reverse(receptacle.id.as_str().len()));
    receptacles
        .iter()
        .fold(call.to_owned(), |call, receptacle| {
            call.replace(receptacle.id.as_str(), &called(receptacle))
        })
}
