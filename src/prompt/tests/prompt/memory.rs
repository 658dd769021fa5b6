//! `memory.json`: what each client remembers after each answer of a sequence.

mod real_contract {
    use reel_prompt::published::{
        ActionError, AgentMemory, GymMemory, Item, Observation, SchedulerMemory, agent_answer,
        trainer_action,
    };
    use reel_vectors::{Report, items, load, text};
    use serde_json::{Value, json};

    use super::super::tokens;

    /// The mock server says `seen`, on every second call with an image.
    fn result(call: usize) -> Vec<Item<'static>> {
        let image = (call % 2 == 1).then_some(Item::Image);
        [Item::Text("seen")]
            .into_iter()
            .chain(image)
            .chain([Item::Text("Debug Info:")])
            .collect()
    }

    fn sequences(client: &str, ours: impl Fn(&[&str]) -> Vec<Value>) {
        let Some(document) = load("memory.json") else {
            return;
        };
        let mut report = Report::new("memory.json", client);
        for case in items(&document["cases"]) {
            let answers: Vec<&str> = items(&case["answers"]).iter().map(text).collect();
            report.compare(text(&case["id"]), &case[client], &ours(&answers).into());
        }
        report.finish();
    }

    #[test]
    fn scheduler() {
        let wording = tokens();
        sequences("scheduler", |answers| {
            let (mut memory, mut calls, mut asked, mut states) =
                (SchedulerMemory::default(), 0, 0, Vec::new());
            for answer in answers {
                let observation = match trainer_action(answer) {
                    Err(ActionError::Empty) => break,
                    Err(error) => Observation::of_invalid_answer(&error, &wording),
                    Ok(action) if action.tool_name == "finish" => break,
                    Ok(action) => {
                        calls += 1;
                        asked += u32::from(action.tool_name == "ask");
                        Observation::of_result(&action.tool_name, &result(calls - 1), &wording)
                    }
                };
                memory.update(answer, &wording);
                states.push(json!({
                    "task_progress": memory.task_progress(),
                    "last_action": memory.last_action(),
                    "observation": observation.in_rollout(&wording),
                    "ask_count": asked,
                    "images": observation.images,
                }));
            }
            states
        });
    }

    #[test]
    fn gym() {
        sequences("gym", |answers| {
            let (mut memory, mut asked, mut states) = (GymMemory::default(), 0, Vec::new());
            for answer in answers {
                memory.update(answer);
                asked +=
                    u32::from(trainer_action(answer).is_ok_and(|action| action.tool_name == "ask"));
                states.push(json!({
                    "task_progress": memory.task_progress,
                    "last_action": memory.last_action,
                    "ask_count": asked,
                }));
            }
            states
        });
    }

    #[test]
    fn agent() {
        sequences("agent", |answers| {
            let (mut memory, mut states) = (AgentMemory::default(), Vec::new());
            for answer in answers {
                let Ok(read) = agent_answer(answer) else {
                    states.push(json!({"ends": "inference_error"}));
                    break;
                };
                memory.update(&read);
                states.push(json!({
                    "task_progress": memory.task_progress,
                    "last_action": memory.last_action,
                    "observation": "Text: seen",
                }));
            }
            states
        });
    }
}
