//! Parts of a dataset: whole scenes or tasks go to train, validation or test by their hash, family
//! by family; and the check that nothing is in two parts. Owns the assignment; chooses no ratio.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::Digest;
use serde::Serialize;

use crate::DatasetError;

/// A part of a dataset.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Examples that a model is trained on.
    #[default]
    Train,
    /// Examples for choosing between checkpoints or settings of training.
    Validation,
    /// Examples for judging the finished model only.
    Test,
}

impl Split {
    /// All splits, in the order train, validation, test.
    pub const ALL: [Split; 3] = [Split::Train, Split::Validation, Split::Test];

    /// As Hugging Face names it.
    pub fn as_str(self) -> &'static str {
        match self {
            Split::Train => "train",
            Split::Validation => "validation",
            Split::Test => "test",
        }
    }

    /// Reads what [`Split::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|split| split.as_str() == text)
    }
}

/// How much of the data each part gets: train, validation, test, in any unit.
#[derive(Clone, Copy, PartialEq, Debug, Serialize)]
pub struct Ratios([f64; 3]);

impl Ratios {
    /// Checks them.
    ///
    /// # Errors
    /// When one is below 0 or no number, or all are 0.
    pub fn new(found: [f64; 3]) -> Result<Self, DatasetError> {
        let sum: f64 = found.iter().sum();
        if found.iter().all(|ratio| *ratio >= 0.0) && sum > 0.0 && sum.is_finite() {
            Ok(Self(found.map(|ratio| ratio / sum)))
        } else {
            Err(DatasetError::Ratios { found })
        }
    }

    fn at(self, place: f64) -> Split {
        let [train, validation, _] = self.0;
        if place < train {
            Split::Train
        } else if place < train + validation {
            Split::Validation
        } else {
            Split::Test
        }
    }
}

/// The parts of groups (scenes or tasks). A group is whole in one part.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Splits {
    groups: BTreeMap<String, Split>,
}

impl Splits {
    /// Assigns groups (id, family). Each family's groups are ordered by their hash and cut at the
    /// ratios, so that every part has its share of each family as exactly as whole groups allow. A
    /// group of several families counts as the first by name.
    pub fn stratified<'g>(
        groups: impl IntoIterator<Item = (&'g str, &'g str)>,
        seed: u64,
        ratios: Ratios,
    ) -> Self {
        let mut family_of: BTreeMap<&str, &str> = BTreeMap::new();
        for (group, family) in groups {
            family_of
                .entry(group)
                .and_modify(|known| *known = (*known).min(family))
                .or_insert(family);
        }
        let mut families: BTreeMap<&str, Vec<(u64, &str)>> = BTreeMap::new();
        for (group, family) in family_of {
            families
                .entry(family)
                .or_default()
                .push((hash(group, seed), group));
        }
        let mut assigned = BTreeMap::new();
        // Where families are small their cuts would all round the same way: each begins where the
        // one before it ended.
        let mut offset = 0.0;
        for (_, mut members) in families {
            members.sort_unstable();
            let count = members.len() as f64;
            for (at, (_, group)) in members.into_iter().enumerate() {
                let place = ((at as f64 + 0.5) / count + offset) % 1.0;
                assigned.insert(group.to_owned(), ratios.at(place));
            }
            offset = (offset + 0.5 / count) % 1.0;
        }
        Self { groups: assigned }
    }

    /// The part of a group.
    pub fn of(&self, group: &str) -> Option<Split> {
        self.groups.get(group).copied()
    }

    /// How many groups each part has.
    pub fn counts(&self) -> BTreeMap<Split, usize> {
        let mut counts = BTreeMap::new();
        for split in self.groups.values() {
            *counts.entry(*split).or_default() += 1;
        }
        counts
    }
}

fn hash(group: &str, seed: u64) -> u64 {
    let digest = Digest::of(format!("{seed}:{group}").as_bytes());
    u64::from_le_bytes(digest.0[..8].try_into().expect("a digest has 32 bytes"))
}

/// Something that is in more than one part.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
pub struct Leakage {
    /// What kind: `task`, `scene`, `instruction`, `image`.
    pub kind: String,
    /// What the splits share: a task id, scene id, instruction or image path.
    pub key: String,
    /// The splits that hold it, two or more.
    pub splits: BTreeSet<Split>,
}

/// Finds what is in more than one part. Keeps 8 bytes and a part for every key.
#[derive(Clone, Debug, Default)]
pub struct LeakageCheck {
    seen: BTreeMap<&'static str, BTreeMap<u64, u8>>,
    found: BTreeMap<(&'static str, String), u8>,
}

impl LeakageCheck {
    /// Notes a key of a part. Instructions are compared without case and spaces. Same kinds and
    /// keys may come often.
    pub fn add(&mut self, what: &'static str, key: &str, split: Split) {
        let folded = key
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
            .to_lowercase();
        let bit = 1 << split as u8;
        let seen = self
            .seen
            .entry(what)
            .or_default()
            .entry(hash(&folded, 0))
            .or_default();
        *seen |= bit;
        if seen.count_ones() > 1 {
            self.found.insert((what, key.to_owned()), *seen);
        }
    }

    /// What is in more than one part, by kind and key.
    pub fn found(&self) -> Vec<Leakage> {
        let splits = |bits: u8| {
            Split::ALL
                .into_iter()
                .filter(|split| bits & (1 << *split as u8) != 0)
                .collect()
        };
        let leakage = |((what, key), bits): (&(&'static str, String), &u8)| Leakage {
            kind: (*what).to_owned(),
            key: key.clone(),
            splits: splits(*bits),
        };
        self.found.iter().map(leakage).collect()
    }

    /// How many keys of a kind are in more than one part.
    pub fn count(&self, what: &str) -> usize {
        self.seen.get(what).map_or(0, |keys| {
            keys.values().filter(|bits| bits.count_ones() > 1).count()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn groups(count: usize) -> Vec<(String, &'static str)> {
        (0..count)
            .map(|at| (format!("task_{at}"), ["FDP", "FODP", "FDO", "SUL"][at % 4]))
            .collect()
    }

    #[test]
    fn every_part_has_its_share_of_each_family() {
        let groups = groups(400);
        let named = || {
            groups
                .iter()
                .map(|(group, family)| (group.as_str(), *family))
        };
        let ratios = Ratios::new([8.0, 1.0, 1.0]).unwrap();
        let splits = Splits::stratified(named(), 7, ratios);
        for family in ["FDP", "FODP", "FDO", "SUL"] {
            let share = |split| {
                named()
                    .filter(|(group, of)| *of == family && splits.of(group) == Some(split))
                    .count()
            };
            assert_eq!(
                [
                    share(Split::Train),
                    share(Split::Validation),
                    share(Split::Test)
                ],
                [80, 10, 10],
                "{family}"
            );
        }
        assert_eq!(
            Splits::stratified(named().collect::<Vec<_>>().into_iter().rev(), 7, ratios),
            splits,
            "in any order"
        );
        assert_ne!(Splits::stratified(named(), 8, ratios), splits);
    }

    #[test]
    fn ratios_that_are_none_are_refused() {
        for ratios in [[0.0; 3], [-1.0, 2.0, 0.0], [f64::NAN, 1.0, 1.0]] {
            assert!(Ratios::new(ratios).is_err(), "{ratios:?}");
        }
    }

    #[test]
    fn what_is_in_two_parts_is_found() {
        let mut check = LeakageCheck::default();
        check.add("instruction", "Bring the mug.", Split::Train);
        check.add("instruction", "bring  the mug.", Split::Train);
        check.add("scene", "home", Split::Train);
        assert!(check.found().is_empty());
        check.add("instruction", "bring the MUG.", Split::Test);
        let found = check.found();
        assert_eq!(
            (
                found.len(),
                found[0].kind.as_str(),
                check.count("instruction"),
                check.count("scene")
            ),
            (1, "instruction", 1, 0)
        );
        assert_eq!(found[0].splits, BTreeSet::from([Split::Train, Split::Test]));
    }
}
