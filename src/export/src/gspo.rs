//! The objective of GSPO over a store: two recorded policies over the same tokens, the returns and
//! groups of the rollout export, and what the objective makes of them. Owns which sequences there
//! are; the mathematics is `reel-reward`'s.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use reel_reward::gspo::{
    ClipRange, ClipShare, ClipSide, KlEstimator, Objective, clip_share, clip_side, kl, objective,
    sequence_ratio, token_ratios,
};
use reel_tables::{Store, Table};
use reel_world::OLD_POLICY;
use serde::{Deserialize, Serialize};

use crate::{
    AnnotationSource, ExportError, RolloutOptions, Selection,
    episode::PolicyLogprobs,
    rollouts::{self, GroupReturn},
    select::{self, SkipCounts, count},
};

/// What one sequence is: its ratio is normalised by its tokens.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SequenceUnit {
    /// A rollout with all its decisions (paper, and the published trainer).
    #[default]
    Episode,
    /// One decision, as the rows of `reel export rl`; it has the advantage of its episode.
    Decision,
}

/// Which policies are compared, and by which objective.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct GspoOptions {
    /// The policy that sampled the tokens.
    pub old: String,
    /// The policy that is trained.
    pub new: String,
    /// The policy that it shall stay close to; `None`: no KL.
    pub reference: Option<String>,
    /// How far a ratio may leave 1.
    pub clip: ClipRange,
    /// Weight of the KL.
    pub beta: f64,
    /// The estimate of the KL that the objective takes.
    pub kl: KlEstimator,
    /// What a sequence is.
    pub unit: SequenceUnit,
    /// Groups, returns and advantages.
    pub rollouts: RolloutOptions,
    /// Only these episodes; `None`: all.
    pub episodes: Option<BTreeSet<String>>,
    /// Of the draws from groups that are too large.
    pub seed: u64,
}

impl Default for GspoOptions {
    /// Policies `old` and `new`, no reference; radius 0.2, as the published trainer has it.
    fn default() -> Self {
        Self {
            old: OLD_POLICY.to_owned(),
            new: "new".to_owned(),
            reference: None,
            clip: ClipRange::symmetric(0.2).expect("0.2 is a radius"),
            beta: 0.0,
            kl: KlEstimator::K3,
            unit: SequenceUnit::Episode,
            rollouts: RolloutOptions::default(),
            episodes: None,
            seed: 0,
        }
    }
}

/// What the objective makes of a sequence.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Sequence {
    /// The prompt group that the sequence was rolled out in.
    pub group: Arc<str>,
    /// Id of the episode that the sequence is from.
    pub episode_id: String,
    /// The decision; `None` if the sequence is the episode.
    pub step: Option<u32>,
    /// How many tokens it has.
    pub tokens: usize,
    /// Return of the episode.
    #[serde(rename = "return")]
    pub episode_return: f64,
    /// Advantage of the episode in its group.
    pub advantage: f64,
    /// Importance ratio of the sequence, `exp(mean(new - old))` over its tokens.
    pub ratio: f64,
    /// On which side it is clipped; `None` if it is not.
    pub clipped: Option<ClipSide>,
    /// KL from the reference by `k1`, `k2` and `k3`; empty if there is none.
    pub kl: BTreeMap<&'static str, f64>,
}

/// The objective of a prompt group.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct GroupObjective {
    /// Name of the prompt group, as in the rows of `reel export rl`.
    pub group: Arc<str>,
    /// How many sequences it has.
    pub sequences: usize,
    /// Loss, surrogate, KL and clip shares.
    #[serde(flatten)]
    pub objective: Objective,
}

/// The objective over all sequences, by group and by sequence.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct GspoReport {
    /// The same figures over the sequences of all groups.
    #[serde(flatten)]
    pub objective: Objective,
    /// Mean of the sequences' KL by each estimator; empty if there is no reference.
    pub kl_means: BTreeMap<&'static str, f64>,
    /// Least, mean and greatest ratio of a sequence.
    pub ratio: [f64; 3],
    /// Shares of tokens whose own ratio lies outside: what an objective over tokens would clip.
    pub clipped_tokens: ClipShare,
    /// How many tokens there are.
    pub tokens: usize,
    /// By group, in the order of their names.
    pub groups: Vec<GroupObjective>,
    /// In the order of groups, rollouts and decisions.
    pub sequences: Vec<Sequence>,
    /// Episodes and decisions that are in no sequence, by the reason.
    pub excluded: BTreeMap<&'static str, u64>,
}

/// Computes the objective from the log-probabilities that a store holds.
///
/// # Errors
/// Fails if the store cannot be read, a policy scored an episode in part, no episode has
/// log-probabilities of the policies, or a return, ratio or KL is no number.
pub fn gspo(store: &Store, options: &GspoOptions) -> Result<GspoReport, ExportError> {
    let mut left_out = SkipCounts::default();
    let mut rollouts = grouped(store, options, &mut left_out)?;
    store.read(Table::Episodes, COLUMNS, |batch| {
        for row in reel_tables::rows_from::<SequenceRow>(&batch)? {
            if let Some(rollout) = rollouts.get_mut(&row.episode_id) {
                rollout.decisions = row.steps;
            }
        }
        Ok(())
    })?;
    // in the order of groups and rollouts
    let mut scored = BTreeMap::new();
    for (episode_id, rollout) in rollouts {
        let Rollout {
            worth,
            last,
            mut decisions,
        } = rollout;
        decisions.retain(|decision| last.is_none_or(|last| decision.step <= last));
        match tokens(&episode_id, decisions, options, &mut left_out)? {
            Some(tokens) => {
                scored.insert(
                    (Arc::clone(&worth.group), worth.rollout),
                    (episode_id, worth, tokens),
                );
            }
            None => count(
                &mut left_out,
                "episodes without log-probabilities of these policies",
                1,
            ),
        }
    }
    let mut sums = Sums::default();
    let mut sequences = Vec::new();
    for (episode_id, worth, decisions) in scored.into_values() {
        let units = match options.unit {
            SequenceUnit::Episode => vec![(None, joined(decisions))],
            SequenceUnit::Decision => decisions
                .into_iter()
                .map(|tokens| (Some(tokens.step), tokens))
                .collect(),
        };
        for (step, tokens) in units {
            let refuse = |error: reel_reward::RewardError| ExportError::Logprobs {
                episode_id: episode_id.clone(),
                step,
                reason: error.to_string(),
            };
            sequences.push(sequence(&worth, &episode_id, step, &tokens, options).map_err(refuse)?);
            sums.tokens(&tokens, worth.advantage).map_err(refuse)?;
        }
    }
    if sequences.is_empty() {
        return Err(ExportError::NoSequences {
            policies: [
                Some(&options.old),
                Some(&options.new),
                options.reference.as_ref(),
            ]
            .into_iter()
            .flatten()
            .map(|policy| format!("'{policy}'"))
            .collect::<Vec<_>>()
            .join(", "),
        });
    }
    report(sequences, &sums, options, left_out)
}

const COLUMNS: &[&str] = &reel_world::words! {
    episode_id "steps.list.element.step" "steps.list.element.tokens" "steps.list.element.logprobs"
};

#[derive(Deserialize)]
struct SequenceRow {
    episode_id: String,
    steps: Vec<StepRow>,
}

#[derive(Deserialize)]
struct StepRow {
    step: u32,
    tokens: Option<Vec<String>>,
    #[serde(default)]
    logprobs: Vec<PolicyLogprobs>,
}

/// An episode that is in a group.
struct Rollout {
    worth: GroupReturn,
    /// The decision with which the preset is done with the episode; `None` if it goes on to the
    /// end of the record.
    last: Option<u32>,
    decisions: Vec<StepRow>,
}

/// Log-probabilities of a decision, or of several behind one another.
#[derive(Default)]
struct Tokens {
    step: u32,
    new: Vec<f64>,
    old: Vec<f64>,
    reference: Option<Vec<f64>>,
}

/// The episodes in their groups, by id.
fn grouped(
    store: &Store,
    options: &GspoOptions,
    left_out: &mut SkipCounts,
) -> Result<BTreeMap<String, Rollout>, ExportError> {
    let every = Selection {
        episodes: options.episodes.clone(),
        failed: true,
        mistakes: true,
        recoveries: true,
        after_decisive: true,
        contradictions: true,
        ..Selection::default()
    };
    // what is left out of training sets is in the objective even so: the words
    // of every decision count
    let mut chosen = select::candidates(
        store,
        &every,
        AnnotationSource::Recorded,
        &mut SkipCounts::default(),
    )?;
    let preset = options.rollouts.preset.as_ref();
    if let Some(preset) = preset {
        rollouts::rescore(&mut chosen, store, preset, left_out)?;
    }
    rollouts::group(&mut chosen, &options.rollouts, options.seed, left_out)?;
    let rollout = |candidate: select::Candidate| {
        Some((
            candidate.episode_id,
            Rollout {
                worth: candidate.worth?,
                last: candidate.paid_until,
                decisions: Vec::new(),
            },
        ))
    };
    Ok(chosen.into_iter().filter_map(rollout).collect())
}

/// The log-probabilities of an episode by decision; `None` if a policy gives none
/// of its tokens any.
fn tokens(
    episode_id: &str,
    decisions: Vec<StepRow>,
    options: &GspoOptions,
    left_out: &mut SkipCounts,
) -> Result<Option<Vec<Tokens>>, ExportError> {
    let horizon = options.rollouts.returns.horizon;
    let (recorded, silent): (Vec<StepRow>, Vec<StepRow>) = decisions
        .into_iter()
        .filter(|decision| decision.step < horizon)
        .partition(|decision| decision.tokens.is_some());
    let policies = [
        Some(&options.old),
        Some(&options.new),
        options.reference.as_ref(),
    ];
    let mut by_policy = Vec::new();
    for policy in policies.into_iter().flatten() {
        let of = |decision: &StepRow| {
            decision
                .logprobs
                .iter()
                .find(|of| of.policy == *policy)
                .map(|of| of.logprobs.clone())
        };
        let found: Vec<Option<Vec<f64>>> = recorded.iter().map(of).collect();
        if found.iter().all(Option::is_none) {
            return Ok(None);
        }
        let Some(missing) = found.iter().position(Option::is_none) else {
            by_policy.push(found.into_iter().flatten().collect::<Vec<_>>());
            continue;
        };
        return Err(ExportError::Logprobs {
            episode_id: episode_id.to_owned(),
            step: Some(recorded[missing].step),
            reason: format!(
                "policy '{policy}' scored other decisions of the episode, but not this one; add it with `reel trace logprobs add` and ingest the trace again"
            ),
        });
    }
    count(
        left_out,
        "decisions without log-probabilities",
        silent.len(),
    );
    let mut by_policy = by_policy.into_iter().map(Vec::into_iter);
    let (mut old, mut new, mut reference) = (by_policy.next(), by_policy.next(), by_policy.next());
    let next =
        |list: &mut Option<std::vec::IntoIter<Vec<f64>>>| list.as_mut().and_then(Iterator::next);
    let of = |decision: &StepRow| Tokens {
        step: decision.step,
        old: next(&mut old).unwrap_or_default(),
        new: next(&mut new).unwrap_or_default(),
        reference: next(&mut reference),
    };
    Ok(Some(recorded.iter().map(of).collect()))
}

/// All decisions as one sequence.
fn joined(decisions: Vec<Tokens>) -> Tokens {
    let mut all = Tokens::default();
    for Tokens {
        new,
        old,
        reference,
        ..
    } in decisions
    {
        all.new.extend(new);
        all.old.extend(old);
        if let Some(reference) = reference {
            all.reference.get_or_insert_default().extend(reference);
        }
    }
    all
}

fn sequence(
    worth: &GroupReturn,
    episode_id: &str,
    step: Option<u32>,
    tokens: &Tokens,
    options: &GspoOptions,
) -> Result<Sequence, reel_reward::RewardError> {
    let ratio = sequence_ratio(&tokens.new, &tokens.old)?;
    let mut by_estimator = BTreeMap::new();
    if let Some(reference) = &tokens.reference {
        for estimator in KlEstimator::ALL {
            by_estimator.insert(estimator.as_str(), kl(estimator, &tokens.new, reference)?);
        }
    }
    Ok(Sequence {
        group: Arc::clone(&worth.group),
        episode_id: episode_id.to_owned(),
        step,
        tokens: tokens.new.len(),
        episode_return: worth.episode_return,
        advantage: worth.advantage,
        ratio,
        clipped: clip_side(ratio, worth.advantage, options.clip),
        kl: by_estimator,
    })
}

/// The ratio of every token with the advantage of its episode.
#[derive(Default)]
struct Sums {
    ratios: Vec<f64>,
    advantages: Vec<f64>,
}

impl Sums {
    fn tokens(&mut self, tokens: &Tokens, advantage: f64) -> Result<(), reel_reward::RewardError> {
        self.ratios.extend(token_ratios(&tokens.new, &tokens.old)?);
        self.advantages.resize(self.ratios.len(), advantage);
        Ok(())
    }
}

fn report(
    sequences: Vec<Sequence>,
    sums: &Sums,
    options: &GspoOptions,
    left_out: SkipCounts,
) -> Result<GspoReport, ExportError> {
    let of = |sequences: &[&Sequence]| -> Result<Objective, ExportError> {
        let column = |value: &dyn Fn(&Sequence) -> f64| {
            sequences
                .iter()
                .map(|sequence| value(sequence))
                .collect::<Vec<f64>>()
        };
        let kl = column(&|sequence| sequence.kl.get(options.kl.as_str()).copied().unwrap_or(0.0));
        let (ratios, advantages) = (
            column(&|sequence| sequence.ratio),
            column(&|sequence| sequence.advantage),
        );
        Ok(objective(
            &ratios,
            &advantages,
            &kl,
            options.clip,
            options.beta,
        )?)
    };
    let mut by_group: BTreeMap<&Arc<str>, Vec<&Sequence>> = BTreeMap::new();
    for sequence in &sequences {
        by_group.entry(&sequence.group).or_default().push(sequence);
    }
    let group = |(group, members): (&Arc<str>, Vec<&Sequence>)| {
        Ok(GroupObjective {
            group: Arc::clone(group),
            sequences: members.len(),
            objective: of(&members)?,
        })
    };
    let groups = by_group
        .into_iter()
        .map(group)
        .collect::<Result<Vec<_>, ExportError>>()?;
    let count = sequences.len() as f64;
    let mut kl_means = BTreeMap::new();
    for sequence in &sequences {
        for (estimator, kl) in &sequence.kl {
            *kl_means.entry(*estimator).or_insert(0.0) += kl / count;
        }
    }
    let ratios = || sequences.iter().map(|sequence| sequence.ratio);
    Ok(GspoReport {
        objective: of(&sequences.iter().collect::<Vec<_>>())?,
        kl_means,
        ratio: [
            ratios().fold(f64::INFINITY, f64::min),
            ratios().sum::<f64>() / count,
            ratios().fold(0.0, f64::max),
        ],
        clipped_tokens: clip_share(&sums.ratios, &sums.advantages, options.clip)?,
        tokens: sums.ratios.len(),
        groups,
        sequences,
        excluded: left_out,
    })
}
