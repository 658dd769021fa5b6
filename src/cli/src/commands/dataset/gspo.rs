//! `reel dataset gspo`: the objective of two recorded policies over the same tokens.

use anyhow::bail;
use reel_export::{GspoOptions, GspoReport, SequenceUnit, gspo};
use reel_reward::gspo::{ClipRange, KlEstimator};

use crate::{
    ExitStatus,
    commands::export::{Grouping, StoreSource},
};

/// Compute the GSPO objective of a policy from the log-probabilities in a store: sequence ratios,
/// clip shares, KL and loss, over the groups, returns and advantages of `reel export rl`. Nothing
/// is trained: a trainer's first step over the same rollouts logs the same numbers.
///
/// Policy `old` sampled the tokens (`reel bench --logprobs` records it); others are added
/// with `reel trace logprobs add`.
///
/// Example:
///   reel dataset gspo --store store --new new --ref ref --beta 0.04 --returns published --advantage ngrpo
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    source: StoreSource,
    /// The policy that sampled the tokens
    #[arg(long, value_name = "POLICY", default_value = reel_world::OLD_POLICY)]
    old: String,
    /// The policy that is trained
    #[arg(long, value_name = "POLICY", default_value = "new")]
    new: String,
    /// The reference policy of the KL; without it there is no KL
    #[arg(long = "ref", value_name = "POLICY")]
    reference: Option<String>,
    /// How far a ratio may fall below 1, and rise above it unless --epsilon-high says otherwise
    #[arg(
        long,
        value_name = "RADIUS",
        default_value_t = 0.2,
        allow_negative_numbers = true
    )]
    epsilon: f64,
    /// How far a ratio may rise above 1
    #[arg(long, value_name = "RADIUS", allow_negative_numbers = true)]
    epsilon_high: Option<f64>,
    /// Weight of the KL; needs --ref
    #[arg(
        long,
        value_name = "WEIGHT",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    beta: f64,
    /// The estimate of the KL in the loss: k1, k2 or k3
    #[arg(long, value_name = "NAME", default_value = "k3", value_parser = kl_estimator)]
    kl: KlEstimator,
    /// What a sequence is: episode (a rollout with all its decisions) or decision
    #[arg(long, value_name = "UNIT", default_value = "episode", value_parser = sequence_unit)]
    sequence: SequenceUnit,
    #[command(flatten)]
    grouping: Grouping,
    /// Seed of draws from groups that are too large
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Print JSON: the objective, by group and by sequence
    #[arg(long)]
    json: bool,
}

fn kl_estimator(name: &str) -> Result<KlEstimator, String> {
    KlEstimator::parse(name).ok_or_else(|| "there are k1, k2 and k3".to_owned())
}

fn sequence_unit(name: &str) -> Result<SequenceUnit, String> {
    match name {
        "episode" => Ok(SequenceUnit::Episode),
        "decision" => Ok(SequenceUnit::Decision),
        _ => Err("there are episode and decision".to_owned()),
    }
}

/// Computes the objective and prints it.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let Arguments {
        source,
        old,
        new,
        reference,
        epsilon,
        epsilon_high,
        beta,
        kl,
        sequence,
        grouping,
        seed,
        ..
    } = arguments;
    if !beta.is_finite() {
        bail!("--beta {beta} is no weight; the published trainer has 0.04");
    }
    if *beta != 0.0 && reference.is_none() {
        bail!("--beta weighs the KL from a reference; name its policy with --ref");
    }
    let options = GspoOptions {
        old: old.clone(),
        new: new.clone(),
        reference: reference.clone(),
        clip: ClipRange::new(*epsilon, epsilon_high.unwrap_or(*epsilon))?,
        beta: *beta,
        kl: *kl,
        unit: *sequence,
        rollouts: grouping.options()?,
        episodes: source.episodes()?,
        seed: *seed,
    };
    let report = gspo(&source.open()?, &options)?;
    if arguments.json {
        println!(
            "{}",
            serde_json::json!({ "options": options, "report": report })
        );
    } else {
        print!("{}", table(&options, &report));
    }
    Ok(ExitStatus::Success)
}

fn table(options: &GspoOptions, report: &GspoReport) -> String {
    let unit = if options.unit == SequenceUnit::Episode {
        "episodes"
    } else {
        "decisions"
    };
    let (of, [least, mean, greatest]) = (&report.objective, report.ratio);
    let mut text = format!(
        "{} of {} tokens in {} groups; policy '{}' over tokens of '{}'; returns {}, advantage {}\n",
        format_args!("{} {unit}", report.sequences.len()),
        report.tokens,
        report.groups.len(),
        options.new,
        options.old,
        options.rollouts.returns.name,
        options.rollouts.advantage.as_str(),
    );
    text += &format!(
        "  loss       {:+.6} = -({:+.6}) + {} * {:.6}\n",
        of.loss, of.surrogate, options.beta, of.kl
    );
    text += &format!("  ratio      {mean:.6} ({least:.6} to {greatest:.6})\n");
    text += &format!(
        "  clipped    low {:.4}, high {:.4}; ",
        of.clipped.low, of.clipped.high
    );
    text += &format!(
        "of tokens low {:.4}, high {:.4}\n",
        report.clipped_tokens.low, report.clipped_tokens.high
    );
    if let Some(reference) = &options.reference {
        let kl: Vec<String> = report
            .kl_means
            .iter()
            .map(|(name, kl)| format!("{name} {kl:.6}"))
            .collect();
        text += &format!("  KL         {} from '{reference}'\n", kl.join(", "));
    }
    text += &format!(
        "  {:40} {:>9} {:>10} {:>10} {:>8} {:>8}\n",
        "group", "sequences", "loss", "KL", "low", "high"
    );
    for group in &report.groups {
        let of = &group.objective;
        text += &format!(
            "  {:40} {:9} {:+10.6} {:10.6} {:8.4} {:8.4}\n",
            group.group, group.sequences, of.loss, of.kl, of.clipped.low, of.clipped.high
        );
    }
    for (reason, count) in &report.excluded {
        text += &format!("  left out: {count} {reason}\n");
    }
    text
}
