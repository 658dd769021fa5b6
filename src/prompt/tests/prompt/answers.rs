//! `answers.json`: what each parser takes out of 352 answers.

mod real_contract {
    use reel_prompt::published::{
        ActionError, AgentError, SchedulerMemory, agent_answer, gym_answer, scheduler_action,
        trainer_action,
    };
    use reel_vectors::{Report, items, load, text};
    use serde_json::{Value, json};

    use super::super::tokens;

    fn compare(column: &str, ours: fn(&str) -> Value) {
        let Some(document) = load("answers.json") else {
            return;
        };
        let mut report = Report::new("answers.json", column);
        for case in items(&document["cases"]) {
            report.compare_ordered(text(&case["id"]), &case[column], &ours(text(&case["text"])));
        }
        report.finish();
    }

    #[test]
    fn agent() {
        compare("agent", |answer| match agent_answer(answer) {
            Ok(read) => {
                json!({"summary": read.summary, "tool_name": read.tool_name, "arguments": read.arguments})
            }
            Err(AgentError::NoJson) => json!({"error": "no_json"}),
            Err(AgentError::NoActionObject) => json!({"error": "no_action_object"}),
            Err(AgentError::NoToolName) => json!({"error": "no_tool_name"}),
            Err(AgentError::ArgumentsNotObject) => json!({"error": "args_not_object"}),
        });
    }

    #[test]
    fn trainer() {
        compare("trainer", |answer| match trainer_action(answer) {
            Ok(read) => json!({
                "requested_tool_name": read.requested_tool_name,
                "tool_name": read.tool_name,
                "arguments": read.arguments,
            }),
            Err(ActionError::Empty) => json!({"error": "empty"}),
            Err(ActionError::NoAction { .. }) => json!({"error": "no_action"}),
        });
    }

    #[test]
    fn gym() {
        compare("gym", |answer| {
            let read = gym_answer(answer);
            let shown = |value: Option<Value>| value.unwrap_or_else(|| "⟦unchanged⟧".into());
            json!({"task_progress": shown(read.task_progress), "last_action": shown(read.last_action)})
        });
    }

    #[test]
    fn scheduler() {
        compare("scheduler", |answer| {
            let action = trainer_action(answer);
            if action == Err(ActionError::Empty) {
                return json!({"ended": "empty_completion"});
            }
            if action.is_ok_and(|action| action.tool_name == "finish") {
                return json!({"ended": true});
            }
            let mut memory = SchedulerMemory::default();
            memory.update(answer, &tokens());
            json!({"task_progress": memory.task_progress(), "last_action": memory.last_action()})
        });
    }

    #[test]
    fn a_history_is_read_only_out_of_strict_json() {
        // Not in the file: what Python's `in` finds in a list or a text raises, a History that
        // counts as false is none.
        assert_eq!(scheduler_action(r#"["summary"]"#), None);
        assert_eq!(
            scheduler_action(r#"{"summary": {"History": 0}}"#),
            Some((None, None))
        );
    }
}
