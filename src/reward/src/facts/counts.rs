//! A world graph as a short list: how many of a thing stand at a place. Never knows
//! what the numbers mean.

use crate::facts::ReceptacleKey;

/// How many of each thing stand where.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    entries: Vec<Entry>,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    thing: u32,
    place: ReceptacleKey,
    count: u32,
}

impl Counts {
    pub(crate) fn clone_from(&mut self, other: &Counts) {
        self.entries.clone_from(&other.entries);
    }

    pub(crate) fn count(&self, thing: u32, place: ReceptacleKey) -> u32 {
        self.entries
            .iter()
            .find(|entry| entry.thing == thing && entry.place == place)
            .map_or(0, |entry| entry.count)
    }

    pub(crate) fn add(&mut self, thing: u32, place: ReceptacleKey) {
        match self
            .entries
            .iter_mut()
            .find(|entry| entry.thing == thing && entry.place == place)
        {
            Some(entry) => entry.count += 1,
            None => self.entries.push(Entry {
                thing,
                place,
                count: 1,
            }),
        }
    }

    /// Takes one away; nothing where there is none.
    pub(crate) fn remove(&mut self, thing: u32, place: ReceptacleKey) {
        let Some(at) = self
            .entries
            .iter()
            .position(|entry| entry.thing == thing && entry.place == place)
        else {
            return;
        };
        self.entries[at].count -= 1;
        if self.entries[at].count == 0 {
            self.entries.swap_remove(at);
        }
    }

    /// Things, their places and how many there are, in no order.
    pub(crate) fn entries(&self) -> impl Iterator<Item = (u32, ReceptacleKey, u32)> {
        self.entries
            .iter()
            .map(|entry| (entry.thing, entry.place, entry.count))
    }

    /// The places that hold a thing, in no order.
    pub(crate) fn places_of(&self, thing: u32) -> impl Iterator<Item = ReceptacleKey> {
        self.entries
            .iter()
            .filter(move |entry| entry.thing == thing)
            .map(|entry| entry.place)
    }
}
