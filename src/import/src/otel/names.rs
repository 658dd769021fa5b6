//! Names of attributes: those of the semantic conventions for generative AI, and Reel's own.

pub(super) const OPERATION: &str = "gen_ai.operation.name";
pub(super) const PROVIDER: &str = "gen_ai.provider.name";
pub(super) const CONVERSATION: &str = "gen_ai.conversation.id";
pub(super) const AGENT_NAME: &str = "gen_ai.agent.name";
pub(super) const AGENT_VERSION: &str = "gen_ai.agent.version";
pub(super) const REQUEST_MODEL: &str = "gen_ai.request.model";
pub(super) const INPUT_TOKENS: &str = "gen_ai.usage.input_tokens";
pub(super) const OUTPUT_TOKENS: &str = "gen_ai.usage.output_tokens";
pub(super) const SYSTEM_INSTRUCTIONS: &str = "gen_ai.system_instructions";
pub(super) const INPUT_MESSAGES: &str = "gen_ai.input.messages";
pub(super) const OUTPUT_MESSAGES: &str = "gen_ai.output.messages";
pub(super) const TOOL_DEFINITIONS: &str = "gen_ai.tool.definitions";
pub(super) const TOOL_NAME: &str = "gen_ai.tool.name";
pub(super) const TOOL_TYPE: &str = "gen_ai.tool.type";
pub(super) const CALL_ID: &str = "gen_ai.tool.call.id";
pub(super) const CALL_ARGUMENTS: &str = "gen_ai.tool.call.arguments";
pub(super) const CALL_RESULT: &str = "gen_ai.tool.call.result";
pub(super) const ERROR_TYPE: &str = "error.type";

/// Name of the event that holds a score.
pub(super) const EVALUATION: &str = "gen_ai.evaluation.result";
pub(super) const EVALUATION_NAME: &str = "gen_ai.evaluation.name";
pub(super) const SCORE_VALUE: &str = "gen_ai.evaluation.score.value";
pub(super) const SCORE_LABEL: &str = "gen_ai.evaluation.score.label";
pub(super) const EXPLANATION: &str = "gen_ai.evaluation.explanation";

/// On `invoke_agent`, in JSON: header, task, world graphs and end of the episode.
pub(super) const EPISODE: &str = "reel.episode";
/// On `execute_tool` and `chat`: index of the step.
pub(super) const STEP: &str = "reel.step";
/// On `execute_tool`, or `chat` where nothing was called, in JSON: the record of the step.
pub(super) const RECORD: &str = "reel.record";
/// On `chat` where nothing was called: what came after it.
pub(super) const RESULT: &str = "reel.result";
