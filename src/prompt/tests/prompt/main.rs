//! The published clients' parsers, memories and prompts beside what their code gave.

mod answers;
mod history;
mod memory;
mod prompts;

use reel_prompt::PromptWording;
use serde_json::Value;

/// The tokens that stand for fixed wording in the vector files.
fn tokens() -> PromptWording {
    let token = |text: &str| text.to_owned();
    PromptWording {
        scene_heading: token("⟦scene header⟧"),
        observed_text: token("⟦obs: text⟧"),
        observed_image_and_text: token("⟦obs: image <image> and text⟧"),
        image_mark: token("⟦image⟧"),
        no_text: token("⟦no text: {}⟧"),
        invalid_answer: token("⟦invalid⟧"),
        unreadable_answer: token("⟦parse failed⟧"),
        hand_empty: token("⟦hand empty⟧"),
        hand_holding: token("⟦hand holds: {}⟧"),
        text_graph: token("⟦graph text⟧"),
        cut: token("⟦cut⟧"),
        shortened_prompt: String::new(),
        gym_image: token("⟦obs: image <image>⟧"),
        gym_text: token("⟦obs: text beside image⟧"),
        gym_and_image: token("⟦obs: and image <image>⟧"),
        gym_marker: token("⟦reminder: marker {}⟧"),
        no_tools: token("⟦none⟧"),
        agent_no_observation: token("⟦no observation⟧"),
        agent_nothing: token("⟦nothing⟧"),
        vlm_system: token("⟦system text⟧"),
        vlm_scene_heading: token("⟦scene header⟧"),
        vlm_task: token("⟦task prefix⟧"),
        vlm_call_a_tool: token("⟦ask for a tool⟧"),
        vlm_image_follows: token("⟦image follows⟧"),
        vlm_empty_result: token("⟦empty⟧"),
    }
}

/// The rooms of a task payload with their receptacles; a plain text stands for a list of one.
fn rooms(value: &Value) -> Vec<(&str, Vec<&str>)> {
    let mut found = Vec::new();
    for (room, receptacles) in value.as_object().into_iter().flatten() {
        let receptacles = match receptacles {
            Value::String(one) => vec![one.as_str()],
            many => reel_vectors::items(many)
                .iter()
                .map(reel_vectors::text)
                .collect(),
        };
        found.push((room.as_str(), receptacles));
    }
    found
}
