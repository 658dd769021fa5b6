//! REAL's published clients, as far as texts go: what each reads out of an answer, what it
//! remembers, what it puts into a prompt. There are four: the evaluation agent of the main branch
//! (Qwen), the trainer of the gspo branch, its single environment (gym) and the scheduler of its
//! rollouts. Every function agrees with the published code on the vector files.

mod answer;
mod memory;
mod observation;
mod scene;
mod training;
mod vlm_agent;

pub(crate) use answer::published_call;
pub use answer::{
    ActionError, AgentAnswer, AgentError, GymAnswer, LEGACY_TOOLS, TrainerAction, agent_answer,
    answer_text, canonical_tool, gym_answer, scheduler_action, trainer_action,
};
pub use memory::{AgentMemory, GymMemory, SchedulerMemory};
pub use observation::{Hand, Item, Observation};
pub use scene::{agent_scene, openai_tools, prompt_tools, tools_description, trainer_scene};
pub use training::{
    Compression, MAX_CONTEXT_CHARS, MAX_TURNS, TrainingTurn, ask_limit, keep_last_user_message,
    training_messages,
};
pub use vlm_agent::{VlmConversation, VlmDecision};
