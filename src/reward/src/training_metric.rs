//! The figures of the published training curves: what the trainer counts of each episode, over all
//! and over a window. Never reads a reward rule.

use std::collections::VecDeque;

/// Episodes that means and deviations cover.
const HISTORY_MAX: usize = 10_000;
/// Episodes of the window.
const WINDOW: usize = 100;
/// Share of the targets from which an episode counts as a success.
const SUCCESS_MIN: f64 = 1.0;

/// What counts of a finished episode.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct EpisodeOutcome {
    /// Number of turns of the episode.
    pub steps: u32,
    /// Sum of what was paid.
    pub reward: f64,
    /// Changes of the graph that matched a target.
    pub completed: u32,
    /// Share of the targets that was matched.
    pub completion: f64,
    /// Whether it succeeded; `None`: the completion decides.
    pub success: Option<bool>,
    /// Whether it ended for want of time.
    pub timeout: bool,
    /// Whether it ended with an answer that held no call.
    pub invalid_action: bool,
}

impl EpisodeOutcome {
    /// Counts a turn: what it paid, how many of the episode's targets it matched, and the
    /// completion where the environment says it.
    pub fn step(&mut self, targets: u32, reward: f64, matched: u32, completion: Option<f64>) {
        self.steps += 1;
        self.reward += reward;
        self.completed += matched;
        if matched > 0 && targets > 0 {
            self.completion = f64::from(self.completed) / f64::from(targets);
        }
        self.completion = completion.unwrap_or(self.completion);
    }
}

/// How the figures are taken.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MetricOptions {
    /// Episodes that means and deviations cover, the last ones.
    pub history_max: usize,
    /// Episodes of the window.
    pub window: usize,
    /// Share of the targets from which an episode counts as a success.
    pub success_min: f64,
}

impl Default for MetricOptions {
    fn default() -> Self {
        Self {
            history_max: HISTORY_MAX,
            window: WINDOW,
            success_min: SUCCESS_MIN,
        }
    }
}

/// The figures of a list of episodes.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct TrainingFigures {
    /// How many episodes the rates cover.
    pub episodes: usize,
    /// Share of the episodes that succeeded, 0 to 1.
    pub success_rate: f64,
    /// Share of episodes that ended for want of time.
    pub timeout_rate: f64,
    /// Share of episodes that ended with an answer without a call.
    pub invalid_action_rate: f64,
    /// Mean share of the targets that was matched, and its population standard deviation.
    pub completion: [f64; 2],
    /// Mean reward and its population standard deviation.
    pub reward: [f64; 2],
    /// Mean number of turns and its population standard deviation.
    pub steps: [f64; 2],
}

/// The published training metric, episode after episode.
#[derive(Clone, Debug, Default)]
pub struct TrainingMetric {
    options: MetricOptions,
    /// The episodes that figures are computed over, the oldest first.
    history: VecDeque<EpisodeOutcome>,
    episodes: usize,
    successes: usize,
    timeouts: usize,
    invalid_actions: usize,
}

impl TrainingMetric {
    /// A metric that has seen no episode.
    pub fn new(options: MetricOptions) -> Self {
        Self {
            options,
            ..Self::default()
        }
    }

    /// Adds an episode; the oldest one goes when the history is full.
    pub fn push(&mut self, episode: EpisodeOutcome) {
        self.episodes += 1;
        self.successes += usize::from(self.is_success(&episode));
        self.timeouts += usize::from(episode.timeout);
        self.invalid_actions += usize::from(episode.invalid_action);
        self.history.push_back(episode);
        if self.history.len() > self.options.history_max {
            self.history.pop_front();
        }
    }

    /// Whether an episode counts as a success.
    pub fn is_success(&self, episode: &EpisodeOutcome) -> bool {
        episode
            .success
            .unwrap_or(episode.completion >= self.options.success_min)
    }

    /// Rates over all episodes; means and deviations over those of the history.
    pub fn figures(&self) -> TrainingFigures {
        let rate = |count: usize| {
            if self.episodes == 0 {
                0.0
            } else {
                count as f64 / self.episodes as f64
            }
        };
        TrainingFigures {
            episodes: self.episodes,
            success_rate: rate(self.successes),
            timeout_rate: rate(self.timeouts),
            invalid_action_rate: rate(self.invalid_actions),
            ..self.over(self.history.len())
        }
    }

    /// The figures of the last episodes: `count`, or the window.
    pub fn recent(&self, count: Option<usize>) -> TrainingFigures {
        self.over(count.unwrap_or(self.options.window))
    }

    fn over(&self, count: usize) -> TrainingFigures {
        let skipped = self.history.len().saturating_sub(count);
        let last: Vec<&EpisodeOutcome> = self.history.iter().skip(skipped).collect();
        let of = |value: &dyn Fn(&EpisodeOutcome) -> f64| -> [f64; 2] {
            let values: Vec<f64> = last.iter().map(|episode| value(episode)).collect();
            [mean(&values), population_std(&values)]
        };
        let share = |is: &dyn Fn(&EpisodeOutcome) -> bool| {
            of(&|episode| f64::from(u8::from(is(episode))))[0]
        };
        TrainingFigures {
            episodes: last.len(),
            success_rate: share(&|episode| self.is_success(episode)),
            timeout_rate: share(&|episode| episode.timeout),
            invalid_action_rate: share(&|episode| episode.invalid_action),
            completion: of(&|episode| episode.completion),
            reward: of(&|episode| episode.reward),
            steps: of(&|episode| f64::from(episode.steps)),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    if values.is_empty() {
        0.0
    } else {
        values.iter().sum::<f64>() / values.len() as f64
    }
}

fn population_std(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: Vec<f64> = values
        .iter()
        .map(|value| (value - mean) * (value - mean))
        .collect();
    self::mean(&squares).sqrt()
}
