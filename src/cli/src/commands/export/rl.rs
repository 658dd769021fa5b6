//! `reel export rl`: rollout groups out of a store.

use std::path::PathBuf;

use reel_dataset::{Format, Style};
use reel_export::{RolloutOptions, Selection};

use super::shared::{Shared, format, style};
use crate::{Answer, commands::reward::Named};

/// Rollout groups from the episodes of a store, for GRPO and GSPO: every decision of every rollout, failed ones too, with its
/// reward, the return of its episode and the advantage in its group, `(J - mean) / (std + eps)`. A group is the prompt group
/// that was recorded; else the episodes of a task by the same policy. Only episodes that replay bit for bit become rows. The
/// tasks are listed in tasks.json, as a trainer asks for them.
///
/// Example:
///   reel export rl --store store --out rl --group-size 8
///   reel export rl --store store --out rl --preset real-trainer
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the dataset
    #[arg(long, value_name = "DIR", default_value = "rl")]
    out: PathBuf,
    /// What loads it: trl, ms-swift
    #[arg(long, value_name = "NAME", default_value = "trl", value_parser = rollout_format)]
    format: Format,
    /// How a decision is put: single-turn (the paper's) or multi-turn-prefix (native tool calls)
    #[arg(long, value_name = "STYLE", default_value = "single-turn", value_parser = rollout_style)]
    style: Style,
    /// Rollouts a group (G): smaller groups are left out, of larger ones so many are drawn
    #[arg(long, value_name = "G", value_parser = clap::value_parser!(u32).range(2..))]
    group_size: Option<u32>,
    /// Where no prompt group was recorded: only episodes of equal seed are one
    #[arg(long)]
    same_seed: bool,
    /// Keeps groups of equal returns from dividing by nothing
    #[arg(long, value_name = "EPS", default_value_t = 1e-6)]
    eps: f64,
    /// Score the episodes under this preset instead of taking the recorded rewards: paper, real-repo, real-trainer or a TOML
    /// file. Decisions after the preset is done with an episode are left out
    #[arg(long, value_name = "PRESET")]
    preset: Option<String>,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-rl")]
    name: String,
    #[command(flatten)]
    shared: Shared,
}

fn rollout_format(name: &str) -> Result<Format, String> {
    match format(name)? {
        format @ (Format::Trl | Format::MsSwift) => Ok(format),
        _ => Err("rollouts are written for trl and ms-swift".into()),
    }
}

fn rollout_style(name: &str) -> Result<Style, String> {
    match style(name)? {
        Style::MultiTurn => Err("a row is one decision: single-turn or multi-turn-prefix".into()),
        style => Ok(style),
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let mut options = arguments.shared.options(arguments.format, arguments.style, &arguments.name)?;
    let Arguments { same_seed, eps, .. } = *arguments;
    let preset = arguments.preset.as_deref().map(Named::find).transpose()?.map(|named| named.preset);
    let group_size = arguments.group_size.map(|size| size as usize);
    options.rollouts = Some(RolloutOptions { same_seed, eps, group_size, preset });
    options.selection =
        Selection { failed: true, mistakes: true, after_decisive: true, contradictions: true, ..options.selection };
    arguments.shared.export(&arguments.out, &options)
}
