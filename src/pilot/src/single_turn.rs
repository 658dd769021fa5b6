//! The paper's agent: every decision is one user turn with the task, the tools, what it wrote last, the last action and outcome
//! and the latest picture; the answer is reasoning and one JSON object. What it is asked equals what it is trained on, byte for
//! byte (`reel_prompt`).

use std::sync::Arc;

use reel_agents::{Context, NoAnswer, Policy};
use reel_model::{Client, Message, Part, Request, Role};
use reel_prompt::{Decision, SYSTEM_SINGLE_TURN, VIEW, digest, setting, situation};
use reel_world::{
    NameSet, ToolCall,
    answer::Answer,
    record::{PolicyInfo, StepInput},
};

use crate::agent::{AgentStyle, image, info, no_call, output, picture, receptacles};

/// A model that is asked anew for every decision.
pub struct SingleTurn {
    client: Arc<Client>,
    names: NameSet,
    seed: u64,
    made: Vec<Made>,
    /// The latest one; a call without a picture leaves it.
    picture: Option<Vec<u8>>,
}

/// A decision it made.
struct Made {
    call: ToolCall,
    answer: Answer,
    outcome: String,
}

impl SingleTurn {
    /// An agent at the start of an episode.
    pub fn new(client: Arc<Client>, names: NameSet, seed: u64) -> Self {
        Self { client, names, seed, made: Vec::new(), picture: None }
    }

    /// Takes in what came of the last call.
    fn learn(&mut self, context: &Context<'_>) {
        if let Some(last) = self.made.last_mut() {
            last.outcome.clone_from(&context.observation.text);
        }
        self.picture = picture(context).or(self.picture.take());
    }

    fn request(&self, context: &Context<'_>) -> Request {
        let decisions: Vec<Decision<'_>> = (0..).zip(&self.made).map(|(call, made)| made.decision(call)).collect();
        let mut text = setting(&context.briefing.instruction, Some(self.names), receptacles(context)) + &situation(&decisions);
        if self.picture.is_some() {
            text.push_str(VIEW);
        }
        let parts = [Part::Text(text)].into_iter().chain(self.picture.clone().map(image)).collect();
        let system = Message::text(Role::System, SYSTEM_SINGLE_TURN.trim_end());
        Request { messages: vec![system, Message::new(Role::User, parts)], ..Request::default() }
    }
}

impl Made {
    fn decision(&self, call: u32) -> Decision<'_> {
        Decision {
            call,
            name: &self.call.name,
            arguments: &self.call.arguments,
            outcome: &self.outcome,
            reasoning: &self.answer.reasoning,
            history: self.answer.history.as_deref().unwrap_or_default(),
            schedule: self.answer.schedule.as_deref().unwrap_or_default(),
            subtask: self.answer.subtask.as_deref().unwrap_or_default(),
        }
    }
}

impl Policy for SingleTurn {
    fn info(&self) -> PolicyInfo {
        info(AgentStyle::SingleTurn, &self.client, self.seed, digest())
    }

    fn wants_truth(&self) -> bool {
        false
    }

    fn act(&mut self, context: &Context<'_>) -> Result<StepInput, NoAnswer> {
        self.learn(context);
        let reply = self.client.complete(&self.request(context)).map_err(NoAnswer::new)?;
        let answer = Answer::parse(&reply.text);
        let call = answer.action.clone().map_or_else(no_call, |call| ToolCall::new(call.name, call.arguments));
        let input = StepInput::said(call.clone(), output(&answer, reply.text.clone(), &reply));
        self.made.push(Made { call, answer, outcome: String::new() });
        Ok(input)
    }

    fn watch(&mut self, context: &Context<'_>, input: &StepInput) {
        self.learn(context);
        self.made.push(Made { call: input.call.clone(), answer: Answer::default(), outcome: String::new() });
    }
}
