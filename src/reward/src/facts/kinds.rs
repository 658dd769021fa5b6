//! Objects by kind: which instances count as one thing (of one asset, or of one category), and a
//! task's graphs in these terms. Never knows a reward.

use crate::facts::{Counts, ReceptacleKey, names::Names};

/// A kind of object, numbered within its [`Kinds`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) struct KindKey(pub(crate) u32);

/// Which instances count as one thing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Identity {
    /// Instances of one asset: preset `real-repo`.
    Asset,
    /// Instances of one category: preset `real-trainer`.
    Category,
}

/// An element of a difference of graphs whose objects are kinds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct KindChange {
    pub(crate) kind: KindKey,
    pub(crate) place: ReceptacleKey,
    pub(crate) add: bool,
}

impl KindChange {
    /// The change that undoes this one.
    pub(crate) fn reverse(self) -> Self {
        Self {
            add: !self.add,
            ..self
        }
    }
}

/// The kinds of a task under one identity.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kinds {
    names: Names,
    /// The target differences: `goal (-) initial`, doors apart.
    pub(crate) goal: Vec<KindChange>,
    /// How many of each kind stand where at the start.
    pub(crate) initial: Counts,
}

impl Kinds {
    /// The number of a kind, new or old.
    pub(crate) fn key(&mut self, name: &str) -> KindKey {
        KindKey(self.names.number(name))
    }

    pub(crate) fn name(&self, kind: KindKey) -> &str {
        self.names.name(kind.0)
    }

    /// Sets the goal from the contents of both graphs: kinds with their places, each as often
    /// as it stands there.
    pub(crate) fn set_graphs(
        &mut self,
        initial: &[(KindKey, ReceptacleKey)],
        goal: &[(KindKey, ReceptacleKey)],
    ) {
        self.initial = Counts::default();
        initial
            .iter()
            .for_each(|(kind, place)| self.initial.add(kind.0, *place));
        let mut wanted = Counts::default();
        goal.iter()
            .for_each(|(kind, place)| wanted.add(kind.0, *place));
        let mut standing: Vec<(KindKey, ReceptacleKey)> =
            initial.iter().chain(goal).copied().collect();
        standing.sort_unstable();
        standing.dedup();
        self.goal.clear();
        for (kind, place) in standing {
            let (was, will) = (
                self.initial.count(kind.0, place),
                wanted.count(kind.0, place),
            );
            let change = KindChange {
                kind,
                place,
                add: will > was,
            };
            self.goal
                .extend(std::iter::repeat_n(change, will.abs_diff(was) as usize));
        }
        self.goal
            .sort_by_key(|change| (change.place, !change.add, change.kind));
    }

    /// What came so far stays for ever.
    pub(crate) fn keep(&mut self) {
        self.names.keep();
    }

    /// Forgets names beyond those that stay, if there are too many.
    pub(crate) fn trim(&mut self) {
        self.names.trim();
    }
}
