//! The fixed sentences that the published clients put around the values of a prompt, in our
//! words. REAL's own are not part of this project: whoever has a checkout writes them into a TOML
//! file with these keys.

use serde::{Deserialize, Serialize};

/// Fixed sentences. `{}` stands for the value that a sentence is about.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PromptWording {
    /// Before the rooms, with the end of its line.
    pub scene_heading: String,
    /// Before the text of an observation without an image.
    pub observed_text: String,
    /// Before the text of an observation with images; holds one `<image>`.
    pub observed_image_and_text: String,
    /// What stands in the text of an observation for an image.
    pub image_mark: String,
    /// The text of an observation that has none; `{}` is the tool.
    pub no_text: String,
    /// Before the reason why an answer holds no usable action.
    pub invalid_answer: String,
    /// The line that the memory gets from an answer that is no strict JSON.
    pub unreadable_answer: String,
    /// The hand that holds nothing.
    pub hand_empty: String,
    /// The hand that holds `{}`.
    pub hand_holding: String,
    /// Before the text graph in a shortened prompt.
    pub text_graph: String,
    /// After an observation that was cut.
    pub cut: String,
    /// A shortened prompt, with `{task}`, `{latest_progress_step}`, `{last_action}`,
    /// `{last_obs}`, `{ask_count}` and `{hand_state_description}`.
    pub shortened_prompt: String,
    /// Gym: an observation that is an image alone.
    pub gym_image: String,
    /// Gym: before the text that came with an image.
    pub gym_text: String,
    /// Gym: after the text that came with an image.
    pub gym_and_image: String,
    /// Gym: after a reply of the user that names marker `{}`.
    pub gym_marker: String,
    /// A server without tools.
    pub no_tools: String,
    /// Qwen agent: no observation yet.
    pub agent_no_observation: String,
    /// Qwen agent: a result without text or image.
    pub agent_nothing: String,
    /// API agent: the system message.
    pub vlm_system: String,
    /// API agent: before the scene, which ends the system message.
    pub vlm_scene_heading: String,
    /// API agent: before the instruction.
    pub vlm_task: String,
    /// API agent: the answer to a message without a call.
    pub vlm_call_a_tool: String,
    /// API agent: the result of a tool that gave images and no text.
    pub vlm_image_follows: String,
    /// API agent: the result of a tool that gave nothing.
    pub vlm_empty_result: String,
}

impl Default for PromptWording {
    fn default() -> Self {
        let own = |text: &str| text.to_owned();
        Self {
            scene_heading: own("Rooms and their receptacles:\n"),
            observed_text: own("Result: "),
            observed_image_and_text: own("View: <image>\nResult: "),
            image_mark: String::new(),
            no_text: own("{} gave no text."),
            invalid_answer: own("The answer was not executed: "),
            unreadable_answer: own("Gave an answer that could not be read."),
            hand_empty: own("empty"),
            hand_holding: own("holding: {}"),
            text_graph: own("Objects by receptacle: "),
            cut: own(" (cut)"),
            shortened_prompt: own(
                "Task: {task}\nProgress: {latest_progress_step}\nLast action: {last_action}\n\
                 Last observation: {last_obs}\nQuestions asked: {ask_count}\nHand: {hand_state_description}",
            ),
            gym_image: own("View: <image>"),
            gym_text: own("Result: "),
            gym_and_image: own("\nView: <image>"),
            gym_marker: own("\nThe user means marker {}."),
            no_tools: own("There are no tools."),
            agent_no_observation: own("none yet"),
            agent_nothing: own("The tool returned neither text nor image."),
            vlm_system: own(
                "You are a household robot. Carry out the task with one tool call at a time.",
            ),
            vlm_scene_heading: own("\n\nRooms and their receptacles:\n"),
            vlm_task: own("Task: "),
            vlm_call_a_tool: own("Call one of the tools."),
            vlm_image_follows: own("The image follows."),
            vlm_empty_result: own("No result."),
        }
    }
}
