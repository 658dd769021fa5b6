//! Advantages of rollouts: how much better each was than the others of its prompt group. Never
//! reads a rollout; every result is a function of the returns.
//!
//! `Paper` is the paper's, `Ngrpo` the published trainer's default (a rollout of a virtual,
//! better reward joins each group), the others are those of the library that the published
//! trainer pins (ms-swift 3.12).

use serde::Serialize;

use crate::error::RewardError;

/// What keeps [`Estimator::Paper`] from dividing by nothing, unless somebody says otherwise.
pub const PAPER_EPS: f64 = 1e-6;
/// Added to the standard deviation by the library's estimators.
const LIBRARY_EPS: f64 = 1e-4;
/// Added to the variance by NGRPO.
const NGRPO_VARIANCE_EPS: f64 = 1e-8;
/// How far NGRPO's virtual reward lies above the best of the group: this share of its size, and
/// at least so much.
const VIRTUAL_SHARE: f64 = 0.1;
const VIRTUAL_MIN: f64 = 0.5;

/// How advantages are estimated from the returns of rollouts.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
#[serde(tag = "estimator", rename_all = "lowercase")]
pub enum Estimator {
    /// `(J - mean) / (std + eps)`, `std` the population's (paper, GSPO Objective).
    Paper {
        /// Keeps groups of equal returns from dividing by nothing.
        eps: f64,
    },
    /// `(J - mean) / sqrt(var + 1e-8)` where a virtual reward has joined the group, so that a group
    /// in which all failed alike still says that it failed.
    Ngrpo {
        /// The virtual reward; `None`: the group's best plus the larger of 0.5 and a
        /// tenth of its size.
        virtual_max: Option<f64>,
    },
    /// `(J - mean) / (std + 1e-4)`, `std` the sample's.
    Grpo {
        /// Whether the deviation of the group, of the batch or none divides.
        scale: Scale,
    },
    /// `J` minus the mean of the group's others, over `std + 1e-4` of the returns.
    Rloo {
        /// Whether the deviation of the group, of the batch or none divides.
        scale: Scale,
    },
    /// `J - mean`, over `std + 1e-4` of these differences.
    #[serde(rename = "reinforce++")]
    ReinforcePlusPlus {
        /// Whether the deviation of the group, of the batch or none divides.
        scale: Scale,
    },
}

/// Over which rollouts the standard deviation is taken that advantages are divided by.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Scale {
    /// Those of the group.
    #[default]
    Group,
    /// Those of all groups.
    Batch,
    /// They are not divided.
    None,
}

impl Scale {
    /// All scales, in the order in which errors list them.
    pub const ALL: [Scale; 3] = [Scale::Group, Scale::Batch, Scale::None];

    /// As it is named on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Scale::Group => "group",
            Scale::Batch => "batch",
            Scale::None => "none",
        }
    }

    /// Reads what [`Scale::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scale| scale.as_str() == text)
    }
}

impl Estimator {
    /// The names of all estimators.
    pub const NAMES: [&str; 5] = ["paper", "ngrpo", "grpo", "rloo", "reinforce++"];

    /// The estimator of a name with its defaults; `scale` is for those that scale. `None` if there
    /// is none of that name.
    pub fn named(name: &str, scale: Scale) -> Option<Self> {
        match name {
            "paper" => Some(Estimator::Paper { eps: PAPER_EPS }),
            "ngrpo" => Some(Estimator::Ngrpo { virtual_max: None }),
            "grpo" => Some(Estimator::Grpo { scale }),
            "rloo" => Some(Estimator::Rloo { scale }),
            "reinforce++" => Some(Estimator::ReinforcePlusPlus { scale }),
            _ => None,
        }
    }

    /// Its name on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Estimator::Paper { .. } => "paper",
            Estimator::Ngrpo { .. } => "ngrpo",
            Estimator::Grpo { .. } => "grpo",
            Estimator::Rloo { .. } => "rloo",
            Estimator::ReinforcePlusPlus { .. } => "reinforce++",
        }
    }

    /// The advantages of rollouts, group by group, in the order of their returns.
    ///
    /// # Errors
    /// Fails if a group is empty, a return or a parameter is not finite, or a group has a single
    /// rollout where the estimator compares rollouts with each other.
    pub fn advantages(self, groups: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, RewardError> {
        for (group, returns) in groups.iter().enumerate() {
            if returns.is_empty() {
                return Err(RewardError::Empty);
            }
            if let Some(found) = returns.iter().find(|value| !value.is_finite()) {
                return Err(RewardError::Return {
                    group,
                    found: *found,
                });
            }
        }
        match self {
            Estimator::Paper { eps } => {
                if !(eps.is_finite() && eps >= 0.0) {
                    return Err(RewardError::Parameter {
                        name: "eps",
                        found: eps,
                    });
                }
                Ok(groups
                    .iter()
                    .map(|returns| group_relative(returns, eps))
                    .collect())
            }
            Estimator::Ngrpo { virtual_max } => {
                if let Some(found) = virtual_max.filter(|value| !value.is_finite()) {
                    return Err(RewardError::Parameter {
                        name: "virtual_max",
                        found,
                    });
                }
                Ok(groups
                    .iter()
                    .map(|returns| ngrpo(returns, virtual_max))
                    .collect())
            }
            Estimator::Grpo { scale } => {
                let deviations = deviations(groups, groups, scale)?;
                Ok(scaled(
                    groups.iter().map(|returns| centred(returns)),
                    &deviations,
                ))
            }
            Estimator::Rloo { scale } => {
                let deviations = deviations(groups, groups, scale)?;
                // `J - (sum - J) / (G - 1)`
                let alone = |returns: &Vec<f64>| -> Vec<f64> {
                    let others = returns.len() as f64 / (returns.len() as f64 - 1.0);
                    centred(returns)
                        .into_iter()
                        .map(|value| value * others)
                        .collect()
                };
                Ok(scaled(groups.iter().map(alone), &deviations))
            }
            Estimator::ReinforcePlusPlus { scale } => {
                let centred: Vec<Vec<f64>> =
                    groups.iter().map(|returns| centred(returns)).collect();
                let deviations = deviations(groups, &centred, scale)?;
                Ok(scaled(centred.into_iter(), &deviations))
            }
        }
    }
}

/// `(J_i - mean) / (std + eps)` of one group, `std` the population's. Equal returns give
/// zeros, no returns none.
pub fn group_relative(returns: &[f64], eps: f64) -> Vec<f64> {
    let deviation = (squares(returns) / returns.len() as f64).sqrt();
    let relative = |value: f64| {
        if deviation + eps > 0.0 {
            value / (deviation + eps)
        } else {
            0.0
        }
    };
    centred(returns).into_iter().map(relative).collect()
}

fn ngrpo(returns: &[f64], virtual_max: Option<f64>) -> Vec<f64> {
    let best = returns.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let virtual_reward =
        virtual_max.unwrap_or_else(|| best + (VIRTUAL_SHARE * best.abs()).max(VIRTUAL_MIN));
    let joined: Vec<f64> = returns.iter().copied().chain([virtual_reward]).collect();
    let deviation = (squares(&joined) / joined.len() as f64 + NGRPO_VARIANCE_EPS).sqrt();
    let mean = mean(&joined);
    returns
        .iter()
        .map(|value| (value - mean) / deviation)
        .collect()
}

/// By group, what its advantages are divided by: the sample's standard deviation of `values`.
/// `None`: they are not divided.
fn deviations(
    groups: &[Vec<f64>],
    values: &[Vec<f64>],
    scale: Scale,
) -> Result<Vec<Option<f64>>, RewardError> {
    if let Some(group) = groups.iter().position(|returns| returns.len() < 2) {
        return Err(RewardError::GroupOfOne { group });
    }
    let of = |values: &[f64]| Some((squares(values) / (values.len() as f64 - 1.0)).sqrt());
    Ok(match scale {
        Scale::Group => values.iter().map(|values| of(values)).collect(),
        Scale::Batch => vec![of(&values.concat()); groups.len()],
        Scale::None => vec![None; groups.len()],
    })
}

fn scaled(groups: impl Iterator<Item = Vec<f64>>, deviations: &[Option<f64>]) -> Vec<Vec<f64>> {
    let scale = |(values, deviation): (Vec<f64>, &Option<f64>)| match deviation {
        Some(deviation) => values
            .into_iter()
            .map(|value| value / (deviation + LIBRARY_EPS))
            .collect(),
        None => values,
    };
    groups.zip(deviations).map(scale).collect()
}

fn centred(values: &[f64]) -> Vec<f64> {
    let mean = mean(values);
    values.iter().map(|value| value - mean).collect()
}

/// Sum of the squared distances from the mean.
fn squares(values: &[f64]) -> f64 {
    centred(values).iter().map(|value| value * value).sum()
}

/// In the order of the values, so that the bits are a function of them.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
