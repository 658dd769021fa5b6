//! `reel export rl`: rollout groups out of a store.

use std::path::PathBuf;

use anyhow::bail;
use reel_dataset::{Format, Style};
use reel_export::{RolloutOptions, Selection};
use reel_reward::{Estimator, PAPER_EPS, Returns, Scale};

use super::shared::{CommonArguments, format, style};
use crate::{ExitStatus, commands::store::reward::PresetSource};

/// Rollout groups from the episodes of a store, for GRPO and GSPO: every decision of every rollout,
/// failed ones too, with its reward, the return of its episode, the advantage in its group and,
/// where they were recorded, the tokens with their log-probabilities. A group is the prompt group
/// that was recorded; else the episodes of a task by the same policy. Only episodes that replay bit
/// for bit become rows. The tasks are listed in tasks.json, as a trainer asks for them.
///
/// Examples:
///   reel export rl --store store --out rl --group-size 8
///   reel export rl --store store --out rl --group-size 8 --returns published    # plain sum, 50 decisions, NGRPO
///   reel export rl --store store --out rl --group-size 8 --advantage rloo --scale none
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
    #[command(flatten)]
    grouping: Grouping,
    /// What the dataset is called
    #[arg(long, value_name = "NAME", default_value = "reel-rl")]
    name: String,
    #[command(flatten)]
    shared: CommonArguments,
}

/// Which rollouts are a group, and what each was worth in it.
#[derive(clap::Args)]
pub struct Grouping {
    /// Rollouts a group (G): smaller groups are left out, of larger ones so many are drawn
    #[arg(long, value_name = "G", value_parser = clap::value_parser!(u32).range(2..))]
    group_size: Option<u32>,
    /// Where no prompt group was recorded: only episodes of equal seed are one
    #[arg(long)]
    same_seed: bool,
    /// How rewards become a return: paper (gamma 0.99, 30 decisions) or published
    /// (plain sum, 50 decisions)
    #[arg(long, value_name = "NAME", default_value = "paper", value_parser = returns)]
    returns: Returns,
    /// How returns become advantages: paper, ngrpo, grpo, rloo or reinforce++; without it paper, or
    /// ngrpo with --returns published
    #[arg(long, value_name = "NAME", value_parser = clap::builder::PossibleValuesParser::new(Estimator::NAMES))]
    advantage: Option<String>,
    /// Whose deviation divides the advantages of grpo, rloo and reinforce++: group, batch or none
    #[arg(long, value_name = "NAME", value_parser = scale)]
    scale: Option<Scale>,
    /// Keeps groups of equal returns from dividing by nothing (advantage paper) [default: 0.000001]
    #[arg(long, value_name = "EPS")]
    eps: Option<f64>,
    /// The virtual reward that joins each group (advantage ngrpo); without it a little
    /// above the group's best
    #[arg(long, value_name = "REWARD", allow_negative_numbers = true)]
    virtual_max: Option<f64>,
    /// Score the episodes under this preset instead of taking the recorded rewards: paper,
    /// real-repo, real-trainer or a TOML file. Decisions after the preset is done with an
    /// episode are left out
    #[arg(long, value_name = "PRESET")]
    preset: Option<String>,
}

impl Grouping {
    /// The options of a rollout export.
    ///
    /// # Errors
    /// Fails if an option belongs to another estimator.
    pub fn options(&self) -> anyhow::Result<RolloutOptions> {
        let published = if self.returns == Returns::PUBLISHED {
            "ngrpo"
        } else {
            "paper"
        };
        let name = self.advantage.as_deref().unwrap_or(published);
        let Some(mut advantage) = Estimator::named(name, self.scale.unwrap_or_default()) else {
            bail!(
                "no estimator is called '{name}'; there are {}",
                Estimator::NAMES.join(", ")
            );
        };
        let foreign = |option: &str, of: &str| {
            anyhow::anyhow!("--{option} is of {of}, not of --advantage {name}; leave it out")
        };
        match &mut advantage {
            Estimator::Paper { eps } => *eps = self.eps.unwrap_or(PAPER_EPS),
            _ if self.eps.is_some() => return Err(foreign("eps", "--advantage paper")),
            _ => {}
        }
        match &mut advantage {
            Estimator::Ngrpo { virtual_max } => *virtual_max = self.virtual_max,
            _ if self.virtual_max.is_some() => {
                return Err(foreign("virtual-max", "--advantage ngrpo"));
            }
            _ => {}
        }
        if self.scale.is_some()
            && matches!(advantage, Estimator::Paper { .. } | Estimator::Ngrpo { .. })
        {
            return Err(foreign("scale", "grpo, rloo and reinforce++"));
        }
        let group_size = self.group_size.map(|size| size as usize);
        let preset = self.preset.as_deref().map(PresetSource::find).transpose()?;
        let preset = preset.map(|named| named.preset);
        Ok(RolloutOptions {
            same_seed: self.same_seed,
            group_size,
            returns: self.returns,
            advantage,
            preset,
        })
    }
}

fn returns(name: &str) -> Result<Returns, String> {
    Returns::parse(name).ok_or_else(|| {
        format!(
            "there are {}",
            Returns::ALL.map(|returns| returns.name).join(" and ")
        )
    })
}

fn scale(name: &str) -> Result<Scale, String> {
    Scale::parse(name).ok_or_else(|| "there are group, batch and none".to_owned())
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

/// Exports the episodes of a store as rollout groups for reinforcement learning.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut options =
        arguments
            .shared
            .options(arguments.format, arguments.style, &arguments.name)?;
    options.rollouts = Some(arguments.grouping.options()?);
    options.selection = Selection {
        failed: true,
        mistakes: true,
        after_decisive: true,
        contradictions: true,
        unread_answers: options.style == Style::SingleTurn,
        ..options.selection
    };
    arguments.shared.export(&arguments.out, &options)
}
