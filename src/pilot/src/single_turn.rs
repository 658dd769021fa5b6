//! The paper's agent: every decision is one user turn with the task, the tools, what it wrote last, the last action and outcome
//! and the latest picture; the answer is reasoning and one JSON object. What it is asked equals what it is trained on, byte for
//! byte (`reel_prompt`).

use std::sync::Arc;

use reel_agents::{Context, NoAnswer, Policy};
use reel_model::{Client, Message, Part, Request, Role};
use reel_prompt::{Decision, SYSTEM_SINGLE_TURN, VIEW, action, arguments, digest, setting, situation};
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
            action: action(&self.call.name, &arguments(&self.call.arguments)).into(),
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use reel_dataset::{Episode, ExampleOptions, Receptacle, Secrets, Source, Split, Step, Told, examples};
    use reel_episode::{Briefing, Observation};
    use reel_model::{Clock, Endpoint};
    use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame};
    use serde_json::{Value, json};

    use super::*;

    struct NoClock;

    impl Clock for NoClock {
        fn now_ns(&self) -> u64 {
            0
        }

        fn sleep(&self, _: Duration) {}
    }

    /// The words of a request, a picture as a tag.
    fn words(message: &Message) -> String {
        let word = |part: &Part| match part {
            Part::Text(text) => text.clone(),
            Part::Image { .. } => "<image>".to_owned(),
        };
        message.parts.iter().map(word).collect()
    }

    #[test]
    fn a_model_is_asked_as_it_was_taught() {
        let calls = [
            ("nav_to", json!({"receptacle_name": "table_1"}), "Arrived at table_1."),
            ("walk_around", Value::Null, "I found the following object(s): \n\t0: a(an) mug.\n"),
            ("pick", json!({"marker_id": 0}), "Picked up the object with marker 0."),
        ];
        let briefing = Briefing {
            instruction: "Bring the \"red\" mug to the desk.".to_owned(),
            receptacles: vec![("table_1".into(), "table".to_owned(), "kitchen/0".to_owned())],
        };
        let client = Client::new(Endpoint::new("http://localhost:9/v1", "m"), Arc::new(NoClock)).unwrap();
        let mut agent = SingleTurn::new(Arc::new(client), NameSet::Paper, 0);
        let pixels = vec![0; FRAME_WIDTH * FRAME_HEIGHT * 3];
        let mut asked = Vec::new();
        for step in 0..=calls.len() {
            let text = step.checked_sub(1).map_or(String::new(), |before| calls[before].2.to_owned());
            // The second call gives no picture: the one before stays.
            let frame = (step != 2).then(|| Frame { rgb: pixels.clone(), ids: Vec::new(), depth_mm: Vec::new() });
            let observation = Observation { text, error: None, frame };
            let context = Context { briefing: &briefing, observation: &observation, seen: &[], truth: None, step: step as u32 };
            match calls.get(step) {
                Some((name, arguments, _)) => {
                    agent.watch(&context, &StepInput::bare(ToolCall::new(*name, arguments.clone())));
                    // What it was asked before this call is what it would be asked without it.
                    let made = agent.made.pop();
                    asked.push(agent.request(&context));
                    agent.made.extend(made);
                }
                None => agent.learn(&context),
            }
        }

        let step = |(index, (name, arguments, outcome)): (usize, &(&str, Value, &str))| Step {
            call: index as u32,
            tool: (*name).to_owned(),
            call_name: (*name).to_owned(),
            arguments: arguments.clone(),
            outcome: (*outcome).to_owned(),
            images: vec![reel_world::Digest::of(b"view")],
            learn: true,
            ..Step::default()
        };
        let table = Receptacle { id: "table_1".into(), category: "table".into(), room: "kitchen/0".into() };
        let episode = Episode {
            episode_id: "e".to_owned(),
            task_id: "FDP/t".to_owned(),
            family: "FDP".to_owned(),
            scene_id: "home".to_owned(),
            policy: "oracle".to_owned(),
            split: Split::default(),
            told: Told::new(&briefing.instruction, vec![table], Secrets::none()).into(),
            names: NameSet::Paper,
            steps: calls.iter().enumerate().map(step).collect(),
            source: Source::default(),
        };
        let taught = examples(&episode, &ExampleOptions::default()).examples;
        assert_eq!(taught.len(), asked.len());
        for (taught, asked) in taught.iter().zip(&asked) {
            let [(_, system), (_, user), _] = taught.messages().try_into().unwrap();
            assert_eq!(words(&asked.messages[0]), system);
            assert_eq!(words(&asked.messages[1]), user, "{}", taught.id);
        }
    }
}
