//! The quantities of GSPO (paper, GSPO Objective; Zheng et al., Group Sequence Policy Optimization,
//! arXiv 2507.18071) from log-probabilities of sampled tokens. Never holds a model; every result is
//! a function of its arguments.
//!
//! Log-probabilities are natural logarithms, one for each token that the model wrote in a sequence,
//! in one order for all policies. A sequence is a rollout with all its decisions, or one decision.
//! The exponential is `libm`'s, so that the bits are equal on every machine.

use serde::Serialize;

use crate::{advantage::mean, error::RewardError};

/// How far the sequence ratio may leave 1 before the objective stops following it: the ratio is
/// clipped to `1 - low ..= 1 + high`. The paper names no radius, so there is no default.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct ClipRange {
    low: f64,
    high: f64,
}

/// How the KL divergence is estimated from the log-probabilities of sampled tokens alone (J.
/// Schulman, "Approximating KL divergence", 2020). With `d = log pi_ref - log pi` of a token drawn
/// from `pi`, and `KL = KL(pi || pi_ref)`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum KlEstimator {
    /// `-d`: unbiased, of high variance, may be negative.
    K1,
    /// `d^2 / 2`: biased, of low variance, never negative.
    K2,
    /// `exp(d) - 1 - d`: unbiased, of low variance, never negative. The one of GRPO and of TRL.
    K3,
}

/// Which ratios are outside of the range, as shares of their number.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize)]
pub struct ClipShare {
    /// Below it with a negative advantage: the objective is clipped.
    pub low: f64,
    /// Above it with a positive advantage: the objective is clipped.
    pub high: f64,
}

/// On which side of the range a ratio is clipped.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ClipSide {
    /// The ratio was below the range and was clipped.
    Low,
    /// The ratio was above the range and was clipped.
    High,
}

/// The objective of sequences.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Objective {
    /// `L = -(mean of the clipped terms) + beta * mean KL`, to be minimised.
    pub loss: f64,
    /// Mean of the clipped terms.
    pub surrogate: f64,
    /// Mean of the rollouts' KL.
    pub kl: f64,
    /// Share of the rollouts that were clipped.
    pub clipped: ClipShare,
}

impl ClipRange {
    /// The same radius on both sides (paper).
    ///
    /// # Errors
    /// When the radius is negative or not finite.
    pub fn symmetric(epsilon: f64) -> Result<Self, RewardError> {
        Self::new(epsilon, epsilon)
    }

    /// A radius for each side (`epsilon` and `epsilon_high` of TRL).
    ///
    /// # Errors
    /// When one of them is negative or not finite.
    pub fn new(low: f64, high: f64) -> Result<Self, RewardError> {
        match [low, high]
            .into_iter()
            .find(|radius| !(radius.is_finite() && *radius >= 0.0))
        {
            Some(found) => Err(RewardError::ClipRadius { found }),
            None => Ok(Self { low, high }),
        }
    }

    fn clip(self, ratio: f64) -> f64 {
        ratio.clamp(1.0 - self.low, 1.0 + self.high)
    }
}

impl KlEstimator {
    /// All three KL estimators in ascending order.
    pub const ALL: [KlEstimator; 3] = [KlEstimator::K1, KlEstimator::K2, KlEstimator::K3];

    /// As it is named on the command line and in tables.
    pub fn as_str(self) -> &'static str {
        match self {
            KlEstimator::K1 => "k1",
            KlEstimator::K2 => "k2",
            KlEstimator::K3 => "k3",
        }
    }

    /// Reads what [`KlEstimator::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|estimator| estimator.as_str() == text)
    }

    /// The estimate from one token.
    fn of(self, d: f64) -> f64 {
        match self {
            KlEstimator::K1 => -d,
            KlEstimator::K2 => d * d / 2.0,
            KlEstimator::K3 => libm::exp(d) - 1.0 - d,
        }
    }
}

/// `s = exp(mean of log pi_new - log pi_old)` over the tokens of a rollout: the length-normalized
/// sequence ratio (paper, GSPO Objective).
///
/// # Errors
/// Fails if there is no token, the lengths differ, a log-probability is not finite, or the ratio is
/// too large for a number.
pub fn sequence_ratio(new: &[f64], old: &[f64]) -> Result<f64, RewardError> {
    let log_ratio = mean(&log_ratios(new, old)?);
    finite(libm::exp(log_ratio), log_ratio)
}

/// `exp(log pi_new - log pi_old)` of each token: what GRPO clips and GSPO averages.
///
/// # Errors
/// As [`sequence_ratio`].
pub fn token_ratios(new: &[f64], old: &[f64]) -> Result<Vec<f64>, RewardError> {
    Ok(log_ratios(new, old)?.into_iter().map(libm::exp).collect())
}

/// Length-normalized KL of a rollout from a reference policy: the mean of the estimator over its
/// tokens, which were drawn from (nearly) `policy`. The paper's is over full distributions; this is
/// an estimate of it, so name the estimator.
///
/// # Errors
/// As [`sequence_ratio`].
pub fn kl(estimator: KlEstimator, policy: &[f64], reference: &[f64]) -> Result<f64, RewardError> {
    Ok(mean(&token_kl(estimator, policy, reference)?))
}

/// The estimate of the KL from each token: what [`kl`] averages.
///
/// # Errors
/// As [`sequence_ratio`].
pub fn token_kl(
    estimator: KlEstimator,
    policy: &[f64],
    reference: &[f64],
) -> Result<Vec<f64>, RewardError> {
    log_ratios(reference, policy)?
        .into_iter()
        .map(|d| finite(estimator.of(d), d))
        .collect()
}

/// On which side the objective stops following a ratio: below the range where the advantage is
/// negative, above it where it is positive. `None` where it follows.
pub fn clip_side(ratio: f64, advantage: f64, range: ClipRange) -> Option<ClipSide> {
    if ratio < 1.0 - range.low && advantage < 0.0 {
        Some(ClipSide::Low)
    } else if ratio > 1.0 + range.high && advantage > 0.0 {
        Some(ClipSide::High)
    } else {
        None
    }
}

/// `min(s A, clip(s, 1 - low, 1 + high) A)`: what a rollout adds to the
/// surrogate (paper, GSPO Objective).
pub fn clipped_term(ratio: f64, advantage: f64, range: ClipRange) -> f64 {
    (ratio * advantage).min(range.clip(ratio) * advantage)
}

/// Which share of ratios is clipped, by side: below the range with a negative advantage, above it
/// with a positive one (the clip ratios that TRL logs). For sequences give a ratio and an advantage
/// a rollout; for tokens, the token's ratio and the advantage of its rollout. No ratios give zero.
///
/// # Errors
/// When the lengths differ.
pub fn clip_share(
    ratios: &[f64],
    advantages: &[f64],
    range: ClipRange,
) -> Result<ClipShare, RewardError> {
    same_length(ratios, advantages)?;
    let share = |side: ClipSide| {
        let clipped = |(ratio, advantage): &(&f64, &f64)| {
            clip_side(**ratio, **advantage, range) == Some(side)
        };
        let count = ratios.iter().zip(advantages).filter(clipped).count();
        if ratios.is_empty() {
            0.0
        } else {
            count as f64 / ratios.len() as f64
        }
    };
    Ok(ClipShare {
        low: share(ClipSide::Low),
        high: share(ClipSide::High),
    })
}

/// The loss of a group: `-(1/G) sum min(s_i A_i, clip(s_i) A_i) + (beta/G) sum kappa_i` (paper,
/// GSPO Objective), with a sequence ratio, an advantage and a KL for each rollout.
///
/// # Errors
/// When there is no rollout or the lengths differ.
pub fn objective(
    ratios: &[f64],
    advantages: &[f64],
    kl: &[f64],
    range: ClipRange,
    beta: f64,
) -> Result<Objective, RewardError> {
    if ratios.is_empty() {
        return Err(RewardError::Empty);
    }
    same_length(ratios, kl)?;
    let clipped = clip_share(ratios, advantages, range)?;
    let terms: Vec<f64> = ratios
        .iter()
        .zip(advantages)
        .map(|(ratio, advantage)| clipped_term(*ratio, *advantage, range))
        .collect();
    let (surrogate, kl) = (mean(&terms), mean(kl));
    Ok(Objective {
        loss: -surrogate + beta * kl,
        surrogate,
        kl,
        clipped,
    })
}

fn log_ratios(new: &[f64], old: &[f64]) -> Result<Vec<f64>, RewardError> {
    same_length(new, old)?;
    if new.is_empty() {
        return Err(RewardError::Empty);
    }
    if let Some(token) = new
        .iter()
        .zip(old)
        .position(|(new, old)| !new.is_finite() || !old.is_finite())
    {
        return Err(RewardError::LogProbability {
            token,
            new: new[token],
            old: old[token],
        });
    }
    Ok(new.iter().zip(old).map(|(new, old)| new - old).collect())
}

fn same_length(expected: &[f64], found: &[f64]) -> Result<(), RewardError> {
    if expected.len() == found.len() {
        return Ok(());
    }
    Err(RewardError::Lengths {
        expected: expected.len(),
        found: found.len(),
    })
}

/// A result, unless the exponential of `log_ratio` was too large for it.
fn finite(value: f64, log_ratio: f64) -> Result<f64, RewardError> {
    if value.is_finite() {
        Ok(value)
    } else {
        Err(RewardError::Overflow { log_ratio })
    }
}
