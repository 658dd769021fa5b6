//! `reel export sft`: supervised training sets out of a store.

use std::path::PathBuf;

use reel_dataset::{Format, Style};
use reel_export::Selection;

use super::shared::{CommonArguments, format, style};
use crate::ExitStatus;

/// Training examples from the episodes of a store: what the agent saw before a decision, and what
/// it should do. Only episodes that replay bit for bit become rows; every row names its trace,
/// call, verdict, reward preset and rules. Broken off, the same command goes on where it stopped.
/// Same store version, same options: same bytes.
///
/// Example:
///   reel ingest traces --store store
///   reel export sft --store store --out sft --format trl
///   reel dataset lint sft
///   reel export sft --store store --out real --format ms-swift --prompt REAL/training/mcp_gspo/prompts/real_grpo_prompt.txt
///
/// Style single-turn is that of REAL's trainer, and its answers are what REAL's published agent,
/// trainer, gym and scheduler read: <think>...</think> and {"summary": {...}, "next action":
/// {"tool_name": ..., "args": {...}}}. The multi-turn styles are for other trainers.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the dataset
    #[arg(long, value_name = "DIR", default_value = "sft")]
    out: PathBuf,
    /// What loads it: parquet (Hugging Face), trl, openai, ms-swift, llama-factory, qwen-vl
    #[arg(long, value_name = "NAME", default_value = "parquet", value_parser = format)]
    format: Format,
    /// How a decision is put: single-turn (REAL's trainer), multi-turn (an episode with
    /// native tool calls), multi-turn-prefix
    #[arg(long, value_name = "STYLE", default_value = "single-turn", value_parser = style)]
    style: Style,
    /// Failed and broken-off episodes too, up to their decisive step (run `reel taxonomy` before)
    #[arg(long)]
    failed: bool,
    /// With --failed: decisions from the decisive step on too
    #[arg(long, requires = "failed")]
    after_decisive: bool,
    /// Episodes with a discounted return below this are left out
    #[arg(long, value_name = "RETURN", allow_negative_numbers = true)]
    return_min: Option<f64>,
    /// At most so many episodes a task
    #[arg(long, value_name = "N")]
    per_task: Option<usize>,
    /// Decisions that were mistakes are examples too: failed calls, wrong picks and places
    #[arg(long)]
    mistakes: bool,
    /// Decisions right after a mistake are no examples
    #[arg(long)]
    no_recoveries: bool,
    /// Decisions whose own History contradicts the record are examples too, their History mended
    #[arg(long)]
    contradictions: bool,
    /// Cut to the median size: family, tool
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = ["family", "tool"])]
    balance: Vec<String>,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-sft")]
    name: String,
    #[command(flatten)]
    shared: CommonArguments,
}

/// Exports the decisions of a store's episodes as supervised training examples.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut options =
        arguments
            .shared
            .options(arguments.format, arguments.style, &arguments.name)?;
    let balances = |what: &str| arguments.balance.iter().any(|name| name == what);
    options.selection = Selection {
        failed: arguments.failed,
        return_min: arguments.return_min,
        per_task_max: arguments.per_task,
        mistakes: arguments.mistakes,
        recoveries: !arguments.no_recoveries,
        after_decisive: arguments.after_decisive,
        contradictions: arguments.contradictions,
        own_tools: options.style == Style::MultiTurn,
        balance_families: balances("family"),
        balance_tools: balances("tool"),
        ..options.selection
    };
    arguments.shared.export(&arguments.out, &options)
}
