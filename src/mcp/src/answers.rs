//! Answers from outside that a call waits for, before it is executed: what a query means, and what
//! the user says where a model or a person plays the user. Never how a protocol asks.

use std::{collections::BTreeSet, error::Error, sync::Arc};

use reel_live::{EpisodePosition, LiveError, Owner, Session, SessionPool, Situation};
use reel_world::{
    Tool,
    record::{StepInput, UserReply, UserSource},
};
use tokio::task::spawn_blocking;

use crate::{AskResponder, Questions, ToolServerOptions, Withdrawn, waiting::WaitingTurn};

/// The inputs of a call, and the position of the episode for which somebody outside answered, if
/// anybody did.
#[derive(Clone, Debug)]
pub struct AnsweredInput {
    /// The call with the answers to it.
    pub step: StepInput,
    /// The step that the answers are for; `None` if nobody outside was asked.
    pub position: Option<EpisodePosition>,
}

impl AnsweredInput {
    /// Makes the call, unless the episode went on while somebody answered.
    ///
    /// # Errors
    /// When the answers are of another step, and as [`Session::call`].
    pub fn call(self, session: &mut Session) -> Result<reel_live::CallResult, LiveError> {
        // Calls of one session that are sent at once may overtake an answer.
        if self.position.is_some() && self.position != session.position() {
            return Err(LiveError::Overtaken);
        }
        session.call(self.step)
    }
}

/// Who answers the calls of one session from outside.
#[derive(Clone, Copy)]
pub struct OutsideAnswers<'a> {
    /// The sessions of the server.
    pub pool: &'a Arc<SessionPool>,
    /// Questions that wait for a person.
    pub questions: &'a Questions,
    /// Who is to be asked.
    pub options: &'a ToolServerOptions,
    /// Name of the session.
    pub session: &'a str,
    /// Whose the session is.
    pub owner: &'a Owner,
}

impl OutsideAnswers<'_> {
    /// Adds to a call what is decided outside of the simulator, if anything of it is.
    ///
    /// # Errors
    /// When whoever is to answer does not, or the session is somebody else's.
    pub async fn complete(
        self,
        tool: Option<&Tool>,
        input: AnsweredInput,
    ) -> Result<AnsweredInput, LiveError> {
        match tool {
            Some(Tool::ShowObjectByCategory { category }) => self.look_up(category, input).await,
            Some(Tool::Ask { question }) => self.ask_model(question, input).await,
            _ => Ok(input),
        }
    }

    /// Asks a person who answers through [`Questions`], where one is to be asked; the rule-based
    /// user answers where it is the client's person, whom only MCP can ask.
    ///
    /// # Errors
    /// When another question, or another call, came first.
    pub async fn ask_person(
        self,
        tool: Option<&Tool>,
        step: StepInput,
    ) -> Result<AnsweredInput, LiveError> {
        let mut answered = AnsweredInput {
            step,
            position: None,
        };
        if let Some(Tool::Ask { question }) = tool
            && self.options.ask == AskResponder::Rest
            && self.is_running()
        {
            let situation = self.situation().await?;
            answered.position = Some(situation.position.clone());
            let patience = self.options.ask_patience;
            let waited = self
                .questions
                .ask(self.session, question, situation, patience);
            let answer = waited.await.map_err(|Withdrawn| LiveError::Overtaken)?;
            answered.step.user_reply = Some(persons(answer));
        }
        Ok(answered)
    }

    /// What there is to know of the episode of the session now.
    pub(crate) async fn situation(self) -> Result<Situation, LiveError> {
        let situation = |session: &mut Session| session.situation();
        self.pool
            .with_own_session(self.session, self.owner, situation)
            .await?
    }

    /// Whether an episode runs.
    pub(crate) fn is_running(self) -> bool {
        self.pool
            .entry(self.session)
            .is_ok_and(|entry| matches!(entry.state.state, "playing" | "suspended"))
    }

    /// Lets the session wait for an answer from outside.
    async fn waiting_turn(self) -> Result<WaitingTurn, LiveError> {
        let patience = self.pool.limits().worker_timeout;
        let waiting = self.options.sources.waiting.clone();
        waiting.wait(self.session, patience).await
    }

    /// Asks the model that plays the user, where one does and nobody else answered.
    async fn ask_model(
        self,
        question: &str,
        input: AnsweredInput,
    ) -> Result<AnsweredInput, LiveError> {
        let user = self.options.sources.user.clone();
        let asks = self.options.ask == AskResponder::Model && input.step.user_reply.is_none();
        let Some(user) = user.filter(|_| asks && self.is_running()) else {
            return Ok(input);
        };
        // Whose session it is not is told so here.
        let situation = self.situation().await?;
        let turn = self.waiting_turn().await?;
        let (mut step, question) = (input.step, question.to_owned());
        let answered = spawn_blocking(move || {
            // Until the endpoint is done, whoever stops waiting.
            let _turn = turn;
            let position = Some(situation.position.clone());
            user(&situation, &question, &mut step).map(|()| AnsweredInput { step, position })
        });
        answered
            .await
            .map_err(Into::into)
            .flatten()
            .map_err(|error| {
                tracing::error!(session = self.session, %error, "the user model does not answer");
                LiveError::NoUser
            })
    }

    /// Looks up what a query means, where that is decided outside of the simulator.
    async fn look_up(self, query: &str, input: AnsweredInput) -> Result<AnsweredInput, LiveError> {
        let matcher = self.options.sources.matcher.clone();
        let Some(matcher) = matcher.filter(|_| self.is_running()) else {
            return Ok(input);
        };
        let profile = self.pool.setup().profile;
        let facts = |session: &mut Session| {
            let task = session.task().cloned();
            task.map(|task| (task, session.position()))
        };
        let facts = self
            .pool
            .with_own_session(self.session, self.owner, facts)
            .await?;
        let (task, position) = facts?;
        let turn = self.waiting_turn().await?;
        let (mut step, query) = (input.step, query.to_owned());
        let looked_up = spawn_blocking(move || {
            let _turn = turn;
            let objects = task.objects.iter();
            let categories: BTreeSet<&str> = objects.map(|it| it.category.as_str()).collect();
            let categories: Vec<&str> = categories.into_iter().collect();
            if !profile.takes_literally(&query, &categories) {
                step.lookup = Some(matcher(&query, &categories)?);
            }
            Ok(AnsweredInput { step, position })
        });
        looked_up.await.map_err(Into::into).flatten().map_err(
            |error: Box<dyn Error + Send + Sync>| {
                tracing::error!(session = self.session, %error, "a category could not be looked up");
                LiveError::NoLookUp
            },
        )
    }
}

/// What a person said, who may not have answered.
pub(crate) fn persons(answer: Option<String>) -> UserReply {
    UserReply {
        text: answer.unwrap_or_else(|| "Nobody answers.".to_owned()),
        source: UserSource::Human,
    }
}
