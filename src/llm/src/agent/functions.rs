//! The zero-shot baseline: one conversation an episode, the tools as functions of the endpoint's
//! protocol. Outcomes come back as messages of role `tool`, images in a user's message behind
//! them (few endpoints take images in the former).

use std::sync::Arc;

use crate::client::{Client, Message, Part, Reply, Request, Role};
use reel_agents::{Policy, PolicyContext, ResponderError};
use reel_prompt::{SYSTEM_MULTI_TURN, VIEW, briefing, functions};
use reel_world::{
    Digest, NameSet, ToolCall,
    answer::{AssistantTurn, Call},
    record::{PolicyInfo, StepInput},
};
use serde_json::{Value, json};

use crate::agent::style::{
    AgentStyle, decision_seed, image, image_part, info, no_call, output, receptacles,
};

/// What a call is answered that came with others.
const ONE_AT_A_TIME: &str =
    "Not executed: call one tool at a time. Only the first call of an answer is carried out.";

/// A model in one conversation an episode.
pub struct FunctionCalling {
    client: Arc<Client>,
    names: NameSet,
    seed: u64,
    messages: Vec<Message>,
    /// The ids of the calls in its last answer.
    pending: Vec<String>,
    begun: bool,
}

impl FunctionCalling {
    /// An agent at the start of an episode.
    pub fn new(client: Arc<Client>, names: NameSet, seed: u64) -> Self {
        let system = Message::text(Role::System, SYSTEM_MULTI_TURN.trim_end());
        Self {
            client,
            names,
            seed,
            messages: vec![system],
            pending: Vec::new(),
            begun: false,
        }
    }

    /// Adds what it is told: at first the task, later what came of its last answer.
    fn learn(&mut self, context: &PolicyContext<'_>) {
        let told = context.observation.text.clone();
        let mut text = match self.begun {
            false => briefing(&context.briefing.instruction, receptacles(context)),
            true => String::new(),
        };
        let mut pending = self.pending.drain(..);
        match pending.next() {
            Some(first) => self.messages.push(Message::outcome(first, told)),
            // It said something that holds no call.
            None if self.begun => text.push_str(&told),
            None => {}
        }
        self.messages
            .extend(pending.map(|call| Message::outcome(call, ONE_AT_A_TIME)));
        self.begun = true;
        let frame = image_part(context);
        if frame.is_some() {
            text.push_str(VIEW);
        }
        if !text.is_empty() {
            let text = Part::Text(text.trim_start().to_owned());
            let parts = [text].into_iter().chain(frame.map(image)).collect();
            self.messages.push(Message::new(Role::User, parts));
        }
    }

    /// Takes a call into the conversation as the model's own.
    fn remember(&mut self, text: &str, calls: Vec<Value>) {
        let parts = if text.is_empty() {
            Vec::new()
        } else {
            vec![Part::Text(text.to_owned())]
        };
        self.pending = calls.iter().map(id_of).collect();
        self.messages.push(Message {
            calls,
            ..Message::new(Role::Assistant, parts)
        });
    }
}

impl Policy for FunctionCalling {
    fn info(&self) -> PolicyInfo {
        info(
            AgentStyle::Functions,
            &self.client,
            self.seed,
            Digest::of(SYSTEM_MULTI_TURN.as_bytes()),
        )
    }

    fn needs_privileged(&self) -> bool {
        false
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        self.learn(context);
        let request = Request {
            messages: self.messages.clone(),
            tools: functions(self.names),
            seed: Some(decision_seed(self.seed, context.step)),
        };
        let reply = self
            .client
            .complete(&request)
            .map_err(ResponderError::new)?;
        let answer = AssistantTurn::parse(&reply.text);
        // Models that were not taught functions write the call into their text.
        let call = reply
            .calls
            .first()
            .and_then(Call::of_value)
            .or_else(|| answer.action.clone());
        let call = call.map_or_else(no_call, |call| ToolCall::new(call.name, call.arguments));
        let calls = with_ids(reply.calls.clone(), context.step);
        self.remember(&reply.text, calls);
        Ok(StepInput::with_policy_output(
            call,
            output(&answer, raw(&reply), &reply),
        ))
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.learn(context);
        let arguments = reel_prompt::arguments(&input.call.arguments);
        let call = json!({"type": "function", "function": {"name": input.call.name, "arguments": arguments}});
        self.remember("", with_ids(vec![call], context.step));
    }
}

/// The assistant's message as it came.
fn raw(reply: &Reply) -> String {
    let mut message = json!({"role": "assistant", "content": reply.text});
    if !reply.calls.is_empty() {
        message["tool_calls"] = reply.calls.iter().cloned().collect();
    }
    message.to_string()
}

/// Some endpoints give no ids, and none the outcome could name.
fn with_ids(mut calls: Vec<Value>, step: u32) -> Vec<Value> {
    for (index, call) in calls.iter_mut().enumerate() {
        if id_of(call).is_empty()
            && let Some(call) = call.as_object_mut()
        {
            call.insert("id".to_owned(), json!(format!("call_{step}_{index}")));
        }
    }
    calls
}

fn id_of(call: &Value) -> String {
    call.get("id")
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned()
}
