//! What a trainer wrote down of its updates (docs/loop.md#the-log-of-a-training), and the same
//! figures from the traces of its rollouts. Owns the format of that log; trains nothing.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use reel_reward::{Estimator, Preset, Returns, Scale, gspo::ClipRange};
use reel_tables::Store;
use serde::{Deserialize, Serialize};

use crate::{ExportError, GspoOptions, GspoReport, RolloutOptions, gspo};

/// File with what is the same for all steps of a training.
const ABOUT: &str = "training.json";
/// File with one JSON object a line, one line a step.
const STEPS: &str = "steps.jsonl";

/// The log of a training.
#[derive(Debug)]
pub struct TrainingLog {
    folder: PathBuf,
    /// The objective that every update of this training minimised.
    pub objective: LoggedObjective,
    /// In the order of their numbers.
    pub steps: Vec<LoggedStep>,
}

/// The objective, in the names of `reel dataset gspo`.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct LoggedObjective {
    /// The policy that sampled the tokens, as the traces name it.
    pub old: String,
    /// The policy whose weights an update changed, before it did.
    pub new: String,
    /// The policy of the KL.
    pub reference: Option<String>,
    /// Radius of the clip range below 1.
    pub epsilon: f64,
    /// Radius of the clip range above 1.
    pub epsilon_high: f64,
    /// Weight of the KL in the loss.
    pub beta: f64,
    /// How rewards become returns: `paper` or `published`.
    pub returns: String,
    /// Name of the estimator of advantages.
    pub advantage: String,
    /// How many rollouts a group has.
    pub group_size: Option<usize>,
    /// The reward preset, if it is not the recorded one.
    pub preset: Option<String>,
}

/// One step: rollouts and the updates that were made from them.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct LoggedStep {
    /// The number of the step.
    pub step: u32,
    /// Digest of the weights that played.
    #[serde(default)]
    pub weights_before: Option<String>,
    /// Digest of the weights afterwards.
    #[serde(default)]
    pub weights: Option<String>,
    /// The store of its rollouts; a path that is not absolute is below the log's folder.
    pub store: PathBuf,
    /// In the order in which they were made.
    pub updates: Vec<LoggedUpdate>,
}

/// One update of the weights.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct LoggedUpdate {
    /// How many rollouts it is over.
    pub episodes: u32,
    /// The norm of the gradient, before it was clipped.
    #[serde(default)]
    pub gradient_norm: Option<f64>,
    /// What the objective made of these rollouts.
    #[serde(flatten)]
    pub figures: Figures,
}

/// Figures of the objective over some rollouts.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct Figures {
    /// The loss that was minimised.
    pub loss: f64,
    /// Mean ratio of the sequences.
    pub ratio: f64,
    /// Share of the sequences that were clipped below the range.
    pub low: f64,
    /// Share that was clipped above it.
    pub high: f64,
    /// Mean KL from the reference.
    pub kl: f64,
}

impl Figures {
    /// The figures that traces give.
    pub fn of(report: &GspoReport) -> Self {
        let objective = &report.objective;
        Self {
            loss: objective.loss,
            ratio: report.ratio[1],
            low: objective.clipped.low,
            high: objective.clipped.high,
            kl: objective.kl,
        }
    }

    fn values(self) -> [f64; 5] {
        [self.loss, self.ratio, self.low, self.high, self.kl]
    }

    /// The largest difference of a figure.
    pub fn apart(self, other: Self) -> f64 {
        let pairs = self.values().into_iter().zip(other.values());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

impl LoggedStep {
    /// The figures of its updates, weighted by their rollouts.
    pub fn figures(&self) -> Figures {
        let all: f64 = self.updates.iter().map(|one| f64::from(one.episodes)).sum();
        let mean = |value: fn(&Figures) -> f64| {
            let parts = self.updates.iter();
            parts
                .map(|one| value(&one.figures) * f64::from(one.episodes) / all)
                .sum()
        };
        Figures {
            loss: mean(|of| of.loss),
            ratio: mean(|of| of.ratio),
            low: mean(|of| of.low),
            high: mean(|of| of.high),
            kl: mean(|of| of.kl),
        }
    }
}

impl LoggedObjective {
    /// The same as options of [`gspo`], with the preset that it names.
    ///
    /// # Errors
    /// Says which name or radius means nothing.
    pub fn options(&self, preset: Option<Preset>) -> Result<GspoOptions, String> {
        let unknown = |what: &str, name: &str| format!("{what} `{name}` is none");
        Ok(GspoOptions {
            old: self.old.clone(),
            new: self.new.clone(),
            reference: self.reference.clone(),
            clip: ClipRange::new(self.epsilon, self.epsilon_high)
                .map_err(|error| error.to_string())?,
            beta: self.beta,
            rollouts: RolloutOptions {
                group_size: self.group_size,
                returns: Returns::parse(&self.returns)
                    .ok_or_else(|| unknown("returns", &self.returns))?,
                advantage: Estimator::named(&self.advantage, Scale::default())
                    .ok_or_else(|| unknown("advantage", &self.advantage))?,
                preset,
                ..RolloutOptions::default()
            },
            ..GspoOptions::default()
        })
    }
}

impl TrainingLog {
    /// Reads the log in a folder.
    ///
    /// # Errors
    /// Says which file and line cannot be read, and why.
    pub fn open(folder: &Path) -> Result<Self, ExportError> {
        #[derive(Deserialize)]
        struct About {
            objective: LoggedObjective,
        }
        let refuse = |path: &Path, line, reason: &dyn ToString| ExportError::TrainingLog {
            path: path.to_owned(),
            line,
            reason: reason.to_string(),
        };
        let read = |name: &str| {
            let path = folder.join(name);
            let text = fs::read_to_string(&path).map_err(|error| refuse(&path, None, &error))?;
            Ok::<_, ExportError>((text, path))
        };
        let (text, path) = read(ABOUT)?;
        let About { objective } =
            serde_json::from_str(&text).map_err(|error| refuse(&path, None, &error))?;
        let (text, path) = read(STEPS)?;
        let mut steps = BTreeMap::new();
        for (line, text) in text.lines().enumerate() {
            let line = Some(line + 1);
            let step: LoggedStep =
                serde_json::from_str(text).map_err(|error| refuse(&path, line, &error))?;
            if step.updates.iter().all(|update| update.episodes == 0) {
                return Err(refuse(&path, line, &"no update has episodes"));
            }
            let number = step.step;
            if steps.insert(number, step).is_some() {
                return Err(refuse(
                    &path,
                    line,
                    &format!("step {number} stands there twice"),
                ));
            }
        }
        Ok(Self {
            folder: folder.to_owned(),
            objective,
            steps: steps.into_values().collect(),
        })
    }

    /// The store of a step's rollouts.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn store(&self, step: &LoggedStep) -> Result<Store, ExportError> {
        Ok(Store::open(self.folder.join(&step.store))?)
    }

    /// What the objective is from the traces of a step.
    ///
    /// # Errors
    /// As [`gspo`], and when the log names an objective that there is not.
    pub fn from_traces(
        &self,
        step: &LoggedStep,
        preset: Option<Preset>,
    ) -> Result<GspoReport, ExportError> {
        let options = self.objective.options(preset);
        let options = options.map_err(|reason| ExportError::TrainingLog {
            path: self.folder.join(ABOUT),
            line: None,
            reason,
        })?;
        gspo(&self.store(step)?, &options)
    }
}
