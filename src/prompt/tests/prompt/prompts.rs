//! `prompts.json`: which piece lands where.

mod real_contract {
    use reel_prompt::{
        PromptWording, Slots, Template, check,
        published::{
            ActionError, AgentMemory, Compression, GymMemory, Hand, Item, MAX_CONTEXT_CHARS,
            MAX_TURNS, Observation, SchedulerMemory, TrainingTurn, VlmConversation, agent_answer,
            agent_scene, answer_text, ask_limit, keep_last_user_message, openai_tools,
            prompt_tools, tools_description, trainer_action, trainer_scene, training_messages,
        },
        python::{self, Ascii},
    };
    use reel_vectors::{Report, items, load, text};
    use serde_json::{Map, Value, json};

    use super::super::{rooms, tokens};

    fn wording(document: &Value) -> PromptWording {
        PromptWording {
            shortened_prompt: text(&document["compressed_template"]).to_owned(),
            ..tokens()
        }
    }

    /// A case of the trainer: its payload and what the mock server gives.
    struct Rollout<'c> {
        case: &'c Value,
        wording: &'c PromptWording,
        template: Template,
        scene: String,
        hand: Hand,
        held: Option<String>,
        markers: Map<String, Value>,
        asked: u32,
        calls: usize,
    }

    impl<'c> Rollout<'c> {
        fn new(case: &'c Value, template: &str, wording: &'c PromptWording) -> Self {
            let payload = &case["payload"];
            let described = payload["rooms_and_furniture"]
                .as_object()
                .is_some_and(|rooms| !rooms.is_empty());
            let scene = match described {
                true => trainer_scene(rooms(&payload["rooms_and_furniture"]), wording),
                false => text(&payload["scene_description"]).to_owned(),
            };
            let template = Template::parse(template).expect("the neutral template");
            let (hand, markers) = (Hand::default(), Map::new());
            Self {
                case,
                wording,
                template,
                scene,
                hand,
                held: None,
                markers,
                asked: 0,
                calls: 0,
            }
        }

        fn task(&self) -> &'c str {
            text(&self.case["payload"]["task_description"])
        }

        fn prompt(&self, progress: &str, action: &str, observation: &str) -> String {
            let max_turns = self.case["max_turns"]
                .as_u64()
                .map_or(MAX_TURNS, |turns| turns as u32);
            self.template.render(&Slots {
                scene: &self.scene,
                task: self.task(),
                task_progress: progress,
                last_action: action,
                last_observation: observation,
                max_ask_limit: ask_limit(max_turns),
                ask_count: self.asked,
                hand: &self.hand(),
            })
        }

        fn hand(&self) -> String {
            self.hand.describe(self.held.as_deref(), self.wording)
        }

        /// What the server answers; `None` where the episode ends. And the text graph.
        fn call(&mut self, answer: &str) -> Option<(String, Observation, String)> {
            let action = match trainer_action(answer) {
                Err(error @ ActionError::NoAction { .. }) => {
                    return Some((
                        String::new(),
                        Observation::of_invalid_answer(&error, self.wording),
                        String::new(),
                    ));
                }
                Ok(action) if action.tool_name != "finish" => action,
                _ => return None,
            };
            let result = &self.case["results"][self.calls];
            self.calls += 1;
            let texts = result["text"]
                .as_array()
                .into_iter()
                .flatten()
                .map(|it| Item::Text(text(it)));
            let images =
                std::iter::repeat_n(Item::Image, result["images"].as_u64().unwrap_or(0) as usize);
            let contents: Vec<Item<'_>> = texts
                .chain(images)
                .chain([Item::Text("Debug Info:\n{}")])
                .collect();
            let observation = Observation::of_result(&action.tool_name, &contents, self.wording);
            self.asked += u32::from(action.tool_name == "ask");
            self.hand.update(&action.tool_name, &observation.text);
            self.held = result["inv"].as_str().map(|name| {
                let asset = name.split("_on_").next().unwrap_or(name);
                let target = &self.case["payload"]["target_object"];
                if target["id"] == asset {
                    text(&target["category"]).to_owned()
                } else {
                    name.to_owned()
                }
            });
            self.markers = result["markers"].as_object().cloned().unwrap_or_default();
            Some((
                action.tool_name,
                observation,
                result["WORLD_GRAPH"]
                    .as_str()
                    .unwrap_or_default()
                    .to_owned(),
            ))
        }
    }

    #[test]
    fn scheduler_turns_and_training_messages() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let wording = as_long_as_published(wording(&document));
        let (mut turns_report, mut messages_report, mut rewards_report) = (
            Report::new("prompts.json", "scheduler turns"),
            Report::new("prompts.json", "scheduler training messages"),
            Report::new("prompts.json", "scheduler zeroed rewards"),
        );
        for case in items(&document["scheduler"]) {
            let id = text(&case["id"]);
            let mut rollout = Rollout::new(case, text(&document["template"]), &wording);
            let mut memory = SchedulerMemory::default();
            let (mut observation, mut graph, mut images) = (String::new(), String::new(), 0);
            let (mut prompts, mut turns) = (Vec::new(), Vec::new());
            for (index, answer) in items(&case["completions"]).iter().map(text).enumerate() {
                let prompt = rollout.prompt(
                    &memory.task_progress(),
                    &memory.last_action_text(),
                    &observation,
                );
                let shown: Vec<String> = (0..images)
                    .map(|image| format!("data:image/png;base64,IMG{image}"))
                    .collect();
                prompts.push(json!({"prompt": prompt, "images": shown, "roles": ["user"]}));
                turns.push(TrainingTurn {
                    prompt,
                    answer: answer.to_owned(),
                    task: rollout.task().to_owned(),
                    latest_progress: memory
                        .lines()
                        .last()
                        .cloned()
                        .unwrap_or_else(|| "{}".to_owned()),
                    last_action: memory.last_action().clone(),
                    observation: observation.clone(),
                    text_graph: graph.clone(),
                    ask_count: rollout.asked,
                    hand: rollout.hand(),
                });
                let Some((_, seen, text_graph)) = rollout.call(answer) else {
                    break;
                };
                if case["finish_reasons"][index.to_string()] == "length" {
                    break;
                }
                memory.update(answer, &wording);
                (observation, graph, images) = (seen.in_rollout(&wording), text_graph, seen.images);
            }
            turns_report.compare(id, &case["turns"], &without_padding(&prompts.into()));
            let on =
                ["1", "true", "\"1\"", "\"true\""].contains(&case["compress"].to_string().as_str());
            let default = Compression::default();
            let keep_last = case["keep_last"]
                .as_u64()
                .map_or(default.keep_last, |count| count as usize);
            // The file does not say where a case cuts observations; those that do cut
            // at the least length.
            let cuts = case["messages"].to_string().contains("⟦cut⟧");
            let observation_chars = if cuts { 0 } else { default.observation_chars };
            let compression = on.then_some(Compression {
                keep_last,
                observation_chars,
            });
            let max_chars = case["max_context_chars"]
                .as_u64()
                .map_or(MAX_CONTEXT_CHARS, |chars| chars as usize);
            let (messages, zeroed) = training_messages(&turns, compression, max_chars, &wording);
            messages_report.compare(id, &case["messages"], &without_padding(&messages.into()));
            let paid: f64 = items(&case["rollout"]["step_rewards"])
                .iter()
                .filter_map(Value::as_f64)
                .sum();
            let total = if zeroed { 0.0 } else { paid };
            rewards_report.compare(id, &case["rollout"]["total_reward"], &total.into());
        }
        turns_report.finish();
        messages_report.finish();
        rewards_report.finish();
    }

    /// What fills up a token to the length of the sentence that it stands for: limits
    /// are counted in characters.
    const PADDING: char = '~';

    fn as_long_as_published(wording: PromptWording) -> PromptWording {
        let pad = |token: String, length: usize| {
            let missing = length - token.chars().count();
            token + &PADDING.to_string().repeat(missing)
        };
        PromptWording {
            scene_heading: pad(wording.scene_heading, 72),
            hand_empty: pad(wording.hand_empty, 30),
            observed_text: pad(wording.observed_text, 57),
            observed_image_and_text: pad(wording.observed_image_and_text, 79),
            ..wording
        }
    }

    fn without_padding(value: &Value) -> Value {
        serde_json::from_str(&value.to_string().replace(PADDING, ""))
            .expect("no JSON is made of it")
    }

    #[test]
    fn gym_turns() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let wording = wording(&document);
        let mut report = Report::new("prompts.json", "gym turns");
        for case in items(&document["gym"]) {
            let mut rollout = Rollout::new(case, text(&document["template"]), &wording);
            let mut memory = GymMemory::default();
            let mut observation = String::new();
            let mut completions = items(&case["completions"]).iter().map(text);
            for (index, turn) in items(&case["turns"])
                .iter()
                .enumerate()
                .filter(|(_, turn)| turn["done"] != true)
            {
                let prompt = rollout.prompt(
                    &memory.task_progress_text(),
                    &memory.last_action_text(),
                    &observation,
                );
                report.compare(
                    &format!("{} turn {index}", text(&case["id"])),
                    &turn["prompt"],
                    &prompt.into(),
                );
                let answer = completions.next().expect("an answer for each turn");
                memory.update(answer);
                let Some((tool, seen, _)) = rollout.call(answer) else {
                    break;
                };
                observation = seen.in_gym(&wording);
                if tool == "ask" {
                    let markers: Vec<&str> = rollout.markers.keys().map(String::as_str).collect();
                    if let Some(marker) =
                        reel_reward::trainer::marker_in_answer(&seen.text, &markers)
                    {
                        observation.push_str(&wording.gym_marker.replace("{}", &marker));
                    }
                }
            }
        }
        report.finish();
    }

    #[test]
    fn context_and_answer_text() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let mut report = Report::new("prompts.json", "context");
        for (index, case) in items(&document["context"]).iter().enumerate() {
            report.compare(
                &index.to_string(),
                &case["kept"],
                &keep_last_user_message(items(&case["history"])).into(),
            );
        }
        report.finish();
        let mut report = Report::new("prompts.json", "extract");
        for (index, case) in items(&document["extract"]).iter().enumerate() {
            report.compare(
                &index.to_string(),
                &case["text"],
                &answer_text(&case["input"]).into(),
            );
        }
        report.finish();
    }

    #[test]
    fn qwen_agent() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let (case, wording) = (&document["qwen"], tokens());
        let (task, tools) = (&case["task"], items(&case["tools"]));
        let mut memory = AgentMemory::default();
        let (mut observation, mut images, mut steps) =
            (wording.agent_no_observation.clone(), Vec::new(), 0);
        let mut report = Report::new("prompts.json", "qwen agent");
        for (index, step) in items(&case["steps"]).iter().enumerate() {
            let scene = agent_scene(rooms(&task["rooms_and_furniture"]));
            let slots =
                memory.prompt_slots(text(&task["task_description"]), &scene, tools, &observation);
            let slots: Vec<Value> = slots
                .iter()
                .map(|(slot, value)| json!({"slot": slot, "value": value}))
                .collect();
            let mut expected = step["prompt_slots"].clone();
            // The last step's prompt holds the fixed sentence itself, which the step before
            // gives as a token.
            let before = index
                .checked_sub(1)
                .map(|before| &case["steps"][before]["after"]["observation"]);
            if before.is_some_and(|before| *before == wording.agent_nothing) {
                expected[5]["value"] = wording.agent_nothing.clone().into();
            }
            report.compare(&format!("step {index} prompt"), &expected, &slots.into());
            report.compare(
                &format!("step {index} images"),
                &step["prompt_images"],
                &json!(images),
            );
            let read = agent_answer(text(&step["answer"])).expect("an answer that reads");
            let decision = json!({"tool_name": read.tool_name, "arguments": read.arguments});
            report.compare(
                &format!("step {index} decision"),
                &step["decision"],
                &decision,
            );
            let called = read.tool_name != "finish";
            let action = memory.last_action.clone();
            memory.update(&read);
            if called {
                let texts: Vec<&str> = step["result"]["text"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .map(text)
                    .collect();
                let count = step["result"]["images"].as_u64().unwrap_or(0) as usize;
                observation = AgentMemory::observation(&texts, count, &wording);
                let names: Vec<String> = (steps..steps + count)
                    .map(|image| format!("image_observation_{}.png", image - steps))
                    .collect();
                steps += count;
                images = names[names.len().saturating_sub(2)..].to_vec();
            } else {
                memory.last_action = action;
            }
            let after = json!({
                "task_progress": memory.task_progress,
                "last_action": memory.last_action,
                "observation": observation,
                "images": images,
            });
            report.compare(&format!("step {index} after"), &step["after"], &after);
        }
        report.finish();
    }

    #[test]
    fn vlm_agent() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let (wording, task) = (tokens(), &document["qwen"]["task"]);
        let scene = agent_scene(rooms(&task["rooms_and_furniture"]));
        let mut conversation =
            VlmConversation::new(text(&task["task_description"]), &scene, &wording);
        let mut report = Report::new("prompts.json", "vlm agent");
        for (index, step) in items(&document["vlm"]).iter().enumerate() {
            let sent = &step["sent"]["messages"];
            report.compare(
                &format!("step {index} sent"),
                sent,
                &conversation.request().into(),
            );
            let answer = &step["answer"];
            let call = |call: &Value| json!({"id": call[0], "function": {"name": call[1], "arguments": call[2]}});
            let calls: Vec<Value> = items(&answer["calls"]).iter().map(call).collect();
            let decision = conversation.answer(answer["content"].clone(), &calls);
            report.compare(
                &format!("step {index} raw"),
                &step["raw_response"],
                &decision.raw_response,
            );
            let result = &answer["result"];
            let made = json!({
                "tool_name": decision.tool_name,
                "arguments": decision.arguments,
                "tool_call_id": decision.tool_call_id,
            });
            report.compare(&format!("step {index} decision"), &step["decision"], &made);
            if let Some(id) = decision.tool_call_id.filter(|_| !result.is_null()) {
                let texts: Vec<&str> = result["text"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .map(text)
                    .collect();
                let images =
                    vec!["PNG".to_owned(); result["images"].as_u64().unwrap_or(0) as usize];
                let said = texts.join("\n");
                let shown = (images.is_empty() || !texts.is_empty()).then(|| python::strip(&said));
                conversation.observe(&id, shown, &images);
            }
            report.compare(
                &format!("step {index} images"),
                &step["images_kept"],
                &conversation.images().into(),
            );
        }
        report.finish();
    }

    #[test]
    fn template_rules() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let good = text(&document["template"]);
        let mut report = Report::new("prompts.json", "template rules");
        for case in items(&document["template_rules"]) {
            let (id, given) = (text(&case["id"]), text(&case["template"]));
            let template = match id {
                "missing_field" => good.replace("{TASK}", ""),
                "missing_tool" => good.replace("\"name\": \"pick\"", ""),
                "spacing" => good.replace("\"name\": \"pick\"", "\"name\":\"pick\""),
                "doubled" => good.replace("[end]", "{{}} {TASK} [end]"),
                _ => given.replace("⟦the template below⟧", good),
            };
            report.compare(id, &case["ok"], &check(&template).is_ok().into());
        }
        report.finish();
    }

    #[test]
    fn rendering() {
        let Some(document) = load("prompts.json") else {
            return;
        };
        let (case, wording) = (&document["rendering"], tokens());
        let tools = items(&case["tools_input"]);
        let mut report = Report::new("prompts.json", "rendering");
        let lines: Vec<Value> = prompt_tools(tools).lines().map(Value::from).collect();
        report.compare("tools_for_prompt", &case["tools_for_prompt"], &lines.into());
        report.compare_ordered(
            "tools_openai",
            &case["tools_openai"],
            &openai_tools(tools).into(),
        );
        for (index, scene) in items(&case["scene_agent"]).iter().enumerate() {
            report.compare(
                &format!("scene {index}"),
                &scene["text"],
                &agent_scene(rooms(&scene["rooms"])).into(),
            );
        }
        let optional = json!({"properties": {"a": {"type": "string"}, "b": {"type": "string"}}, "required": ["b"]});
        let long = json!({"name": "long", "description": "d".repeat(100), "inputSchema": optional});
        let described = tools_description(&[tools, &[long]].concat(), &wording);
        let described: Vec<Value> = described.lines().map(Value::from).collect();
        report.compare(
            "tools_description",
            &case["tools_description"],
            &described.into(),
        );
        report.compare(
            "no tools",
            &case["tools_description_empty"],
            &tools_description(&[], &wording).into(),
        );
        report.finish();
        assert_eq!(
            python::dumps(&json!({"a": "é"}), Ascii::Plain),
            "{\"a\": \"é\"}"
        );
    }
}
