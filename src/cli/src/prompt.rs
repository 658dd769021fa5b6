//! The prompt template of single turns, from the command line.

use std::{fs, path::PathBuf, sync::Arc};

use anyhow::Context;
use reel_prompt::{MemoryOptions, Prompt, PromptWording, TEMPLATE};

/// What a model is asked with, one user message a decision.
#[derive(clap::Args)]
pub struct PromptArguments {
    /// Template of the prompts, with the placeholders of REAL's trainer: {SCENE_DESCRIPTION} {TASK}
    /// {TASK_PROGRESS} {LAST_ACTION} {LAST_OBS} {max_ask_limit} {ask_count}
    /// {hand_state_description}. From a checkout of REAL it is
    /// training/mcp_gspo/prompts/real_grpo_prompt.txt; without this the one of Reel
    #[arg(long, value_name = "FILE")]
    prompt: Option<PathBuf>,
    /// Fixed sentences around the values of the template, e.g. REAL's own: TOML, one
    /// key a sentence (docs/datasets.md)
    #[arg(long, value_name = "FILE")]
    prompt_sentences: Option<PathBuf>,
}

/// What prompts repeat that the model neither wrote nor saw just now.
#[derive(clap::Args)]
pub struct MemoryArguments {
    /// Where the model wrote no History, put the log of its calls there: this hides lost memory
    #[arg(long)]
    call_log: bool,
    /// After a result of text alone, show the image of an earlier result again as the current view
    #[arg(long)]
    keep_view: bool,
}

impl MemoryArguments {
    /// A prompt with these options.
    pub fn apply(&self, prompt: &Arc<Prompt>) -> Arc<Prompt> {
        let memory = MemoryOptions {
            call_log: self.call_log,
            keep_view: self.keep_view,
        };
        Arc::new(Prompt::clone(prompt).with_memory(memory))
    }
}

impl PromptArguments {
    /// The prompt.
    ///
    /// # Errors
    /// Fails if a file cannot be read or is no usable template.
    pub fn prompt(&self) -> anyhow::Result<Arc<Prompt>> {
        if self.prompt.is_none() && self.prompt_sentences.is_none() {
            return Ok(Prompt::builtin());
        }
        let read = |path: &PathBuf| {
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
        };
        let wording = match &self.prompt_sentences {
            Some(path) => toml::from_str(&read(path)?)
                .with_context(|| format!("--prompt-sentences {}", path.display()))?,
            None => PromptWording::default(),
        };
        let prompt = match &self.prompt {
            Some(path) => {
                let name = path.file_name().map_or_else(
                    || "prompt".into(),
                    |name| name.to_string_lossy().into_owned(),
                );
                Prompt::new(name, &read(path)?, wording)
                    .with_context(|| format!("--prompt {}", path.display()))?
            }
            None => Prompt::new("reel", TEMPLATE, wording)?,
        };
        Ok(Arc::new(prompt))
    }
}
