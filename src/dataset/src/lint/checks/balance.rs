//! Balance: how often each tool and each family of tasks is taught.
//!
//! Why: a model learns to say what is said most. Sure: the counts are exact; what is too much is a
//! matter of taste. Memory: constant, by the number of tools and families.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::ToolSpec;

use super::{Check, RowFacts};
use crate::lint::{Severity, report::Findings};

pub(super) struct Balance {
    share_max: f64,
    tools: BTreeMap<String, u64>,
    families: BTreeMap<String, u64>,
    declared: BTreeSet<String>,
}

/// Names that are kept apart; the rest is counted together.
const NAMES_MAX: usize = 1000;
/// A family with this many times the rows of another is too large.
const FAMILY_RATIO_MAX: u64 = 10;

impl Balance {
    pub(super) fn new(share_max: f64) -> Self {
        Self {
            share_max,
            tools: BTreeMap::new(),
            families: BTreeMap::new(),
            declared: BTreeSet::new(),
        }
    }
}

impl Check for Balance {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "balance",
            "tools or families of tasks that are taught much more than others, or never",
        )
    }

    fn see(&mut self, seen: &RowFacts, _: &mut Findings) {
        for call in seen.answers.iter().flat_map(|said| &said.calls) {
            count(&mut self.tools, ToolSpec::paper_name_of(&call.name));
        }
        // One look at the tools of a dataset's first row and now and then is enough:
        // the lists are long.
        if self.declared.is_empty() || seen.place().index.is_multiple_of(1000) {
            let names = seen
                .tools()
                .into_iter()
                .flatten()
                .map(|tool| ToolSpec::paper_name_of(&tool.name).to_owned());
            self.declared.extend(names.take(NAMES_MAX));
        }
        let family = seen
            .example
            .meta_text(&["family", "task_family"])
            .or_else(|| {
                let task = seen.example.meta_text(&["task_id", "task"])?;
                task.split_once('/').map(|(family, _)| family.to_owned())
            });
        if let Some(family) = family {
            count(&mut self.families, &family);
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        let all: u64 = self.tools.values().sum();
        let Some((most, most_count)) = self.tools.iter().max_by_key(|(_, count)| **count) else {
            found.not_applicable("no answer calls a tool");
            return;
        };
        let share = *most_count as f64 / all as f64;
        let shares = |counts: &BTreeMap<String, u64>| {
            let all: u64 = counts.values().sum();
            let mut sorted: Vec<(&String, &u64)> = counts.iter().collect();
            sorted.sort_by_key(|(name, count)| (u64::MAX - **count, *name));
            let line = |(name, count): (&String, &u64)| {
                format!(
                    "{name} {count} ({:.0}%)",
                    100.0 * *count as f64 / all as f64
                )
            };
            sorted
                .into_iter()
                .take(20)
                .map(line)
                .collect::<Vec<_>>()
                .join(", ")
        };
        if share > self.share_max && self.tools.len() > 1 {
            found.add("tool", Severity::Warning, &[], || {
                (
                    format!(
                        "{:.0}% of all calls are {most}: more than {:.0}%",
                        100.0 * share,
                        100.0 * self.share_max
                    ),
                    shares(&self.tools),
                )
            });
        }
        let never: Vec<&str> = self
            .declared
            .iter()
            .filter(|name| !self.tools.contains_key(*name))
            .map(String::as_str)
            .collect();
        if !never.is_empty() {
            found.add("never called", Severity::Note, &[], || {
                (
                    format!("declared and never called: {}", never.join(", ")),
                    String::new(),
                )
            });
        }
        let (least, greatest) = (
            self.families.values().min().copied().unwrap_or(0),
            self.families.values().max().copied().unwrap_or(0),
        );
        if greatest > FAMILY_RATIO_MAX * least {
            let told = format!(
                "a family of tasks has more than {FAMILY_RATIO_MAX} times the rows of another"
            );
            found.add("family", Severity::Warning, &[], || {
                (told, shares(&self.families))
            });
        }
        let families = if self.families.is_empty() {
            String::new()
        } else {
            format!("; families: {}", shares(&self.families))
        };
        found.note(format!("{}{families}", shares(&self.tools)));
    }
}

fn count(counts: &mut BTreeMap<String, u64>, name: &str) {
    let name = if counts.len() >= NAMES_MAX && !counts.contains_key(name) {
        "(others)"
    } else {
        name
    };
    *counts.entry(name.to_owned()).or_default() += 1;
}
