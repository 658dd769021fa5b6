//! What a run may cost: tokens, money and time, after which no further episode is begun.

use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::{Duration, Instant},
};

use reel_agents::EpisodeReport;

use super::Arguments;

/// What a run may cost.
pub(super) struct Budget {
    tokens: [AtomicU64; 2],
    most_tokens: Option<u64>,
    most_cost: Option<(f64, [f64; 2])>,
    until: Option<Instant>,
}

impl Budget {
    pub(super) fn new(arguments: &Arguments) -> Self {
        let minutes = arguments
            .max_minutes
            .filter(|minutes| *minutes >= 0.0 && minutes.is_finite());
        Self {
            tokens: [AtomicU64::new(0), AtomicU64::new(0)],
            most_tokens: arguments.max_total_tokens,
            most_cost: arguments.max_cost.zip(arguments.prices()),
            until: minutes
                .map(|minutes| Instant::now() + Duration::from_secs_f64((60.0 * minutes).min(1e9))),
        }
    }

    pub(super) fn spend(&self, report: &EpisodeReport) {
        for (spent, tokens) in self.tokens.iter().zip(report.tokens.unwrap_or_default()) {
            spent.fetch_add(tokens, Ordering::Relaxed);
        }
    }

    /// Why nothing may be begun any more.
    pub(super) fn check(&self) -> Result<(), String> {
        let spent = self
            .tokens
            .each_ref()
            .map(|tokens| tokens.load(Ordering::Relaxed));
        if self
            .most_tokens
            .is_some_and(|most| spent[0] + spent[1] >= most)
        {
            return Err(format!("{} tokens were spent", spent[0] + spent[1]));
        }
        if let Some((most, prices)) = self.most_cost
            && cost(spent, prices) >= most
        {
            return Err(format!("{:.2} was spent", cost(spent, prices)));
        }
        if self.until.is_some_and(|until| Instant::now() >= until) {
            return Err("the time is over".to_owned());
        }
        Ok(())
    }
}

pub(super) fn cost(tokens: [u64; 2], prices: [f64; 2]) -> f64 {
    tokens
        .iter()
        .zip(prices)
        .map(|(tokens, price)| *tokens as f64 * price / 1e6)
        .sum()
}
