//! What was rejected, by which filter, and why.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{draft::DraftError, placement::PlacementError, settle::SettleError};

/// Why a draft became no task, by the filter that stopped it; filters in their order.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Rejection {
    /// Nothing could be made of the triplet.
    Draft(DraftError),
    /// The static filter, or no place within reach.
    Static(PlacementError),
    /// The physics filter: an object falls, flies away or comes to rest elsewhere.
    Physics(SettleError),
    /// The robot cannot get near enough to an object that shall move, or does not
    /// see it from there.
    Approach,
}

impl Rejection {
    /// The filters, in their order.
    pub const FILTERS: [&str; 4] = ["words", "static", "physics", "approach"];

    /// Which filter stopped it: index into [`Rejection::FILTERS`].
    pub fn filter(self) -> usize {
        match self {
            Rejection::Draft(_) => 0,
            Rejection::Static(_) => 1,
            Rejection::Physics(_) => 2,
            Rejection::Approach => 3,
        }
    }

    /// The reason as a phrase for reports, that of the filter's own error.
    pub fn as_str(self) -> &'static str {
        match self {
            Rejection::Draft(why) => why.as_str(),
            Rejection::Static(why) => why.as_str(),
            Rejection::Physics(why) => why.as_str(),
            Rejection::Approach => "the robot cannot stand where it reaches and sees an object",
        }
    }
}

/// Counts over all drafts up to the last task of each kind.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Statistics {
    /// How many drafts there were.
    pub drafts: usize,
    /// How many became tasks.
    pub tasks: usize,
    /// How many were rejected, by reason.
    pub rejected: BTreeMap<Rejection, usize>,
    /// How many (source, destination) pairs of receptacles have an object that plausibly moves
    /// between them, over all scenes.
    pub receptacle_pairs: usize,
    /// How many such (source, destination, object) triplets there are.
    pub triplets: usize,
}

/// How many drafts a filter saw, and how many it let pass.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct FilterCounts {
    /// Name of the filter, one of [`Rejection::FILTERS`].
    pub filter: &'static str,
    /// How many came to it.
    pub examined: usize,
    /// How many it let pass.
    pub passed: usize,
}

impl Statistics {
    /// Pass rates, filter by filter.
    pub fn filters(&self) -> [FilterCounts; 4] {
        let mut seen = self.drafts;
        let stopped = |filter| {
            self.rejected
                .iter()
                .filter(|(why, _)| why.filter() == filter)
                .map(|(_, count)| count)
                .sum::<usize>()
        };
        std::array::from_fn(|index| {
            let passed = seen - stopped(index);
            let step = FilterCounts {
                filter: Rejection::FILTERS[index],
                examined: seen,
                passed,
            };
            seen = passed;
            step
        })
    }
}
