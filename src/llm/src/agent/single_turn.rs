//! The agent of REAL's rollouts: one user message a decision, made from the prompt template;
//! the answer is reasoning and one JSON object. What it is asked equals what it is trained on,
//! byte for byte (`reel_prompt`).

use std::sync::Arc;

use crate::client::{Client, Message, Part, Request, Role};
use reel_agents::{Policy, PolicyContext, ResponderError};
use reel_prompt::{CallOutcome, EpisodePrompt, Prompt};
use reel_world::{
    ToolCall,
    answer::AssistantTurn,
    record::{PolicyInfo, StepInput},
};
use serde_json::json;

use crate::agent::style::{AgentStyle, decision_seed, image, image_part, info, no_call, output};

/// A model that is asked anew for every decision.
pub struct SingleTurn {
    client: Arc<Client>,
    prompt: Arc<Prompt>,
    seed: u64,
    /// What it remembers; `None` before the first decision.
    turn: Option<reel_prompt::SingleTurn>,
    last: Option<Last>,
    /// The latest one, kept if the prompt keeps views.
    latest_image: Option<Vec<u8>>,
}

/// The last call, whose outcome is not known yet.
struct Last {
    call: ToolCall,
    /// The answer that made it; `None` if somebody else decided.
    answer: Option<String>,
}

impl SingleTurn {
    /// An agent at the start of an episode.
    pub fn new(client: Arc<Client>, prompt: Arc<Prompt>, seed: u64) -> Self {
        Self {
            client,
            prompt,
            seed,
            turn: None,
            last: None,
            latest_image: None,
        }
    }

    /// Takes in what came of the last call, and asks for the next.
    fn request(&mut self, context: &PolicyContext<'_>) -> Request {
        let prompt = &self.prompt;
        let kept = self
            .latest_image
            .take()
            .filter(|_| prompt.memory().keep_view);
        self.latest_image = image_part(context).or(kept);
        let turn = self.turn.get_or_insert_with(|| {
            let receptacles = context
                .briefing
                .receptacles
                .iter()
                .map(|(id, _, room)| (id.as_str(), room.as_str()));
            let episode = EpisodePrompt::new(
                Arc::clone(prompt),
                &context.briefing.instruction,
                receptacles,
            );
            reel_prompt::SingleTurn::new(Arc::new(episode))
        });
        // REAL's first prompt holds no observation yet, and so no image.
        let mut shown = None;
        if let Some(Last { call, answer }) = self.last.take() {
            shown.clone_from(&self.latest_image);
            let outcome = CallOutcome {
                tool: &call.name,
                text: &context.observation.text,
                images: usize::from(shown.is_some()),
                held: context.observation.held.as_deref(),
            };
            match answer {
                Some(answer) => turn.update(&answer, &outcome),
                None => turn.watch(&call, &outcome),
            }
        }
        let parts = [Part::Text(turn.prompt())]
            .into_iter()
            .chain(shown.map(image))
            .collect();
        Request {
            messages: vec![Message::new(Role::User, parts)],
            seed: Some(decision_seed(self.seed, context.step)),
            ..Request::default()
        }
    }
}

impl Policy for SingleTurn {
    fn info(&self) -> PolicyInfo {
        let mut info = info(
            AgentStyle::SingleTurn,
            &self.client,
            self.seed,
            self.prompt.digest(),
        );
        let enabled = self.prompt.memory().enabled();
        info.parameters
            .extend(enabled.map(|option| (option.to_owned(), json!(true))));
        info
    }

    fn needs_privileged(&self) -> bool {
        false
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let request = self.request(context);
        let reply = self
            .client
            .complete(&request)
            .map_err(ResponderError::new)?;
        let answer = AssistantTurn::parse(&reply.text);
        let call = answer
            .action
            .clone()
            .map_or_else(no_call, |call| ToolCall::new(call.name, call.arguments));
        let input = StepInput::with_policy_output(
            call.clone(),
            output(&answer, reply.text.clone(), &reply),
        );
        self.last = Some(Last {
            call,
            answer: Some(reply.text),
        });
        Ok(input)
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.request(context);
        self.last = Some(Last {
            call: input.call.clone(),
            answer: None,
        });
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crate::client::{Clock, Endpoint};
    use reel_dataset::{
        Episode, ExampleOptions, PrivilegedFacts, PublicReceptacle, Source, Split, Step,
        TaskBriefing, examples,
    };
    use reel_episode::{Briefing, Observation};
    use reel_prompt::MemoryOptions;
    use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, NameSet};
    use serde_json::Value;

    use super::*;

    struct NoClock;

    impl Clock for NoClock {
        fn now_ns(&self) -> u64 {
            0
        }

        fn sleep(&self, _: Duration) {}
    }

    #[test]
    fn a_model_is_asked_as_it_was_taught() {
        for keep_view in [false, true] {
            let memory = MemoryOptions {
                keep_view,
                ..MemoryOptions::default()
            };
            asked_as_taught(&prompt(memory), None);
        }
    }

    /// What a policy said is remembered as it came, whether or not a call could be read from it.
    #[test]
    fn a_model_is_asked_as_its_rollouts_say() {
        let unread = "<think>Hm.</think>{\"Action\": <tool_call>none";
        let last = asked_as_taught(&prompt(MemoryOptions::default()), Some(unread));
        for part in [
            "2) Gave an answer that could not be read.",
            r#"{"raw": "<think>Hm.</think>"#,
        ] {
            assert!(last.contains(part), "{part}\n{last}");
        }
    }

    fn prompt(memory: MemoryOptions) -> Arc<Prompt> {
        Arc::new(Prompt::clone(&Prompt::builtin()).with_memory(memory))
    }

    /// Compares all prompts; the last one. The third answer may be one that came so.
    fn asked_as_taught(prompt: &Arc<Prompt>, came: Option<&str>) -> String {
        #[rustfmt::skip]
        let calls = [
            ("nav_to", json!({"receptacle_name": "table_1"}), "Arrived at table_1."),
            ("walk_around", Value::Null, "I found the following object(s): \n\t0: a(an) mug.\n"),
            ("pick", json!({"marker_id": 0}), "Picked up the object with marker 0."),
        ];
        let briefing = Briefing {
            instruction: "Bring the \"red\" mug to the desk.".to_owned(),
            receptacles: vec![("table_1".into(), "table".to_owned(), "kitchen/0".to_owned())],
        };
        let client = Client::new(
            Endpoint::new("http://localhost:9/v1", "m"),
            Arc::new(NoClock),
        )
        .unwrap();
        let table = PublicReceptacle {
            id: "table_1".into(),
            category: "table".into(),
            room: "kitchen/0".into(),
        };
        let step = |(index, (name, arguments, outcome)): (usize, &(&str, Value, &str))| Step {
            call: index as u32,
            tool: (*name).to_owned(),
            call_name: (*name).to_owned(),
            arguments: arguments.clone(),
            outcome: (*outcome).to_owned(),
            history: format!("I made {index} calls."),
            answer: came.filter(|_| index == 2).map(str::to_owned),
            held: (index == 2).then(|| "mug".to_owned()),
            // The second call gives no image.
            images: (index != 2 || prompt.memory().keep_view)
                .then(|| reel_world::Digest::of(b"view"))
                .into_iter()
                .collect(),
            learn: true,
            ..Step::default()
        };
        let finish = ("finish", Value::Null, "");
        let episode = Episode {
            episode_id: "e".to_owned(),
            task_id: "FDP/t".to_owned(),
            family: "FDP".to_owned(),
            scene_id: "home".to_owned(),
            policy: "oracle".to_owned(),
            split: Split::default(),
            briefing: TaskBriefing::new(
                &briefing.instruction,
                vec![table],
                PrivilegedFacts::none(),
            )
            .with_prompt(Arc::clone(prompt))
            .into(),
            names: NameSet::Paper,
            agent: None,
            steps: calls
                .iter()
                .chain([&finish])
                .enumerate()
                .map(step)
                .collect(),
            source: Source::default(),
        };
        let taught = examples(&episode, &ExampleOptions::default()).examples;
        let answers: Vec<String> = taught
            .iter()
            .map(|example| example.messages()[1].1.to_string())
            .collect();

        let mut agent = SingleTurn::new(Arc::new(client), Arc::clone(prompt), 0);
        let pixels = vec![0; FRAME_WIDTH * FRAME_HEIGHT * 3];
        for (step, taught) in taught.iter().enumerate() {
            let text = step
                .checked_sub(1)
                .map_or(String::new(), |before| calls[before].2.to_owned());
            let frame = (step != 2).then(|| Frame::of_rgb(pixels.clone()));
            let observation = Observation {
                text,
                error: None,
                frame,
                held: (step == 3).then(|| "mug".to_owned()),
            };
            let context = PolicyContext {
                briefing: &briefing,
                observation: &observation,
                perceived: &[],
                truth: None,
                step: step as u32,
            };
            let asked = agent.request(&context);
            let [(role, user), _] = taught.messages().try_into().unwrap();
            assert_eq!((role, asked.messages.len()), ("user", 1));
            let [Part::Text(text), images @ ..] = &asked.messages[0].parts[..] else {
                panic!("no text comes first")
            };
            assert_eq!(*text, user, "{}", taught.id);
            assert_eq!(images.len(), taught.images().count(), "{}", taught.id);
            assert_eq!(
                user.matches("<image>").count(),
                images.len(),
                "{}",
                taught.id
            );
            if let Some((name, arguments, _)) = calls.get(step) {
                let call = ToolCall::new(*name, arguments.clone());
                agent.last = Some(Last {
                    call,
                    answer: Some(answers[step].clone()),
                });
            }
        }
        let last = taught.last().unwrap().messages()[0].1.to_string();
        if came.is_some() {
            return last;
        }
        for part in [
            "Hand: holding: mug",
            "{'History': '0) I made 0 calls.\n1) I made 1 calls.",
            r#"{"tool_name": "pick", "args": {"marker_id": "0"}}"#,
        ] {
            assert!(last.contains(part), "{part}\n{last}");
        }
        last
    }

    /// The prompt after a call that somebody else made.
    fn prompt_after_a_call_of_others(memory: MemoryOptions) -> String {
        let briefing = Briefing {
            instruction: "Bring it.".to_owned(),
            receptacles: Vec::new(),
        };
        let client = Client::new(
            Endpoint::new("http://localhost:9/v1", "m"),
            Arc::new(NoClock),
        )
        .unwrap();
        let mut agent = SingleTurn::new(Arc::new(client), prompt(memory), 0);
        let observation = |text: &str| Observation {
            text: text.to_owned(),
            error: None,
            frame: None,
            held: None,
        };
        let (start, arrived) = (observation(""), observation("Arrived at table_1."));
        let context = |observation, step| PolicyContext {
            briefing: &briefing,
            observation,
            perceived: &[],
            truth: None,
            step,
        };
        agent.observe(
            &context(&start, 0),
            &StepInput::from_call(ToolCall::new(
                "nav_to",
                json!({"receptacle_name": "table_1"}),
            )),
        );
        let asked = agent.request(&context(&arrived, 1));
        let [Part::Text(text)] = &asked.messages[0].parts[..] else {
            panic!("one text")
        };
        text.clone()
    }

    #[test]
    fn calls_of_others_are_the_last_action_and_with_a_log_the_history() {
        let text = prompt_after_a_call_of_others(MemoryOptions::default());
        assert!(!text.contains("'History'"), "{text}");
        assert!(text.contains(r#"{"tool_name": "navigate_to""#), "{text}");
        let logged = MemoryOptions {
            call_log: true,
            ..MemoryOptions::default()
        };
        let text = prompt_after_a_call_of_others(logged);
        assert!(
            text.contains(
                r#"{'History': '0) {"tool_name":"navigate_to","args":{"receptacle_name":"table_1"}}: Arrived at table_1.'}"#
            ),
            "{text}"
        );
    }
}
