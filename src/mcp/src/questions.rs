//! Questions of policies that wait for a person, who answers from outside.

use std::{
    collections::BTreeMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use reel_live::Situation;
use reel_world::{InstanceId, ReceptacleId, Scene, record::StepRecord};
use serde::Serialize;
use tokio::{sync::oneshot, time::Instant};

/// Questions that wait for an answer, by session.
#[derive(Debug, Default)]
pub struct Questions(Mutex<BTreeMap<String, Waiting>>);

#[derive(Debug)]
struct Waiting {
    text: String,
    since: Instant,
    situation: Situation,
    answer: oneshot::Sender<String>,
}

/// A question that waits for an answer.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Question {
    /// Name of the session whose policy asked the question.
    pub session: String,
    /// Text of the question, as the policy asked it.
    pub question: String,
    /// For how long it has been waiting, in seconds.
    pub waiting_s: u64,
}

/// A question and what led to it, for the person who answers: the goal included, so never for a
/// policy.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct OpenQuestion {
    /// The question, and for how long it has been waiting.
    #[serde(flatten)]
    pub asked: Question,
    /// Id of the task that the robot was given.
    pub task_id: String,
    /// What the robot was told to do.
    pub instruction: String,
    /// What the user wants, which the robot is not told.
    pub wish: Wish,
    /// What the robot decided so far.
    pub decisions: Vec<Decision>,
}

/// What a session's robot decided so far and has before it; nothing that its policy may not know.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct SessionCalls {
    /// What the robot decided so far in its episode.
    pub decisions: Vec<Decision>,
    /// The objects in its image.
    pub in_view: Vec<InstanceId>,
}

/// What the user wants: which object, from where, to where.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Wish {
    /// Category of the target.
    pub category: String,
    /// What the target looks like.
    pub caption: Option<String>,
    /// Where it stands, in a person's words.
    pub from: String,
    /// Where it shall go, in a person's words.
    pub to: String,
}

/// One decision of the robot and what came of it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Decision {
    /// Index of the step in its episode, from 0.
    pub step: u32,
    /// The tool as the policy called it.
    pub tool: String,
    /// Values of its arguments, as texts.
    pub arguments: Vec<String>,
    /// The reasoning that came with the call (`_meta["reel/policy"]`), if any did.
    pub reasoning: Option<String>,
    /// What the policy got.
    pub text: String,
    /// Code of the error, if the call failed.
    pub error: Option<&'static str>,
}

impl From<&Situation> for SessionCalls {
    fn from(situation: &Situation) -> Self {
        let decisions = situation.steps.iter().map(Decision::of).collect();
        let in_view = match situation.steps.last() {
            Some(step) => step.visible.iter().map(|it| it.object.clone()).collect(),
            None => situation.seen_at_start.clone(),
        };
        Self { decisions, in_view }
    }
}

impl Decision {
    fn of(step: &StepRecord) -> Self {
        let policy = step.input.policy.as_ref();
        let said = |text: &String| (!text.is_empty()).then(|| text.clone());
        Self {
            step: step.step,
            tool: step.input.call.name.clone(),
            arguments: step.input.call.values().map(Into::into).collect(),
            reasoning: policy.and_then(|policy| said(&policy.reasoning)),
            text: step.outcome.text.clone(),
            error: step.outcome.error.map(|code| code.as_str()),
        }
    }
}

impl Waiting {
    fn question(&self, session: &str) -> Question {
        Question {
            session: session.to_owned(),
            question: self.text.clone(),
            waiting_s: self.since.elapsed().as_secs(),
        }
    }
}

/// A receptacle as people call it.
fn called(scene: &Scene, id: &ReceptacleId) -> String {
    scene.receptacle(id).map_or_else(
        || id.to_string(),
        |receptacle| {
            let name = receptacle.main_caption().unwrap_or(&receptacle.category);
            format!("{name} in the {}", receptacle.room_name())
        },
    )
}

impl Questions {
    /// Waits for somebody to answer; `None` when nobody does in time.
    ///
    /// # Errors
    /// When the question was withdrawn, or the session asked another one.
    pub async fn ask(
        &self,
        session: &str,
        text: &str,
        situation: Situation,
        patience: Duration,
    ) -> Result<Option<String>, Withdrawn> {
        let (answer, answered) = oneshot::channel();
        let waiting = Waiting {
            text: text.to_owned(),
            since: Instant::now(),
            situation,
            answer,
        };
        self.lock().insert(session.to_owned(), waiting);
        // Also when the caller stops waiting in the middle.
        let mut asked = Asked {
            questions: self,
            session,
            answered,
        };
        match tokio::time::timeout(patience, &mut asked.answered).await {
            Ok(Ok(answer)) => Ok(Some(answer)),
            Ok(Err(_)) => Err(Withdrawn),
            Err(_) => Ok(None),
        }
    }

    /// Takes the question of a session back, if one waits.
    pub fn withdraw(&self, session: &str) {
        self.lock().remove(session);
    }

    /// Answers the question of a session. Whether there was one.
    pub fn answer(&self, session: &str, text: &str) -> bool {
        let waiting = self.lock().remove(session);
        waiting.is_some_and(|waiting| waiting.answer.send(text.to_owned()).is_ok())
    }

    /// Every question that waits.
    pub fn pending(&self) -> Vec<Question> {
        let waiting = self.lock();
        let question = |(session, waiting): (&String, &Waiting)| waiting.question(session);
        waiting.iter().map(question).collect()
    }

    /// The question of a session with everything that whoever answers has to know; `None` if none
    /// waits.
    pub fn open(&self, session: &str) -> Option<OpenQuestion> {
        let waiting = self.lock();
        let (session, waiting) = waiting.get_key_value(session)?;
        let Situation {
            task, scene, steps, ..
        } = &waiting.situation;
        let target = task.target_object();
        Some(OpenQuestion {
            asked: waiting.question(session),
            task_id: task.task_id.clone(),
            instruction: task.instruction.clone(),
            wish: Wish {
                category: target.category.clone(),
                caption: target.caption.clone(),
                from: called(scene, &task.src),
                to: called(scene, &task.dest),
            },
            decisions: steps.iter().map(Decision::of).collect(),
        })
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Waiting>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A question that is no longer asked.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Withdrawn;

/// A question under way.
struct Asked<'a> {
    questions: &'a Questions,
    session: &'a str,
    answered: oneshot::Receiver<String>,
}

impl Drop for Asked<'_> {
    fn drop(&mut self) {
        // Of a later question of the session the answer is still expected.
        self.answered.close();
        let mut waiting = self.questions.lock();
        if waiting
            .get(self.session)
            .is_some_and(|it| it.answer.is_closed())
        {
            waiting.remove(self.session);
        }
    }
}
