//! Places at work that few may do at once, given out in turns: who asks for many waits for its own,
//! and not everybody else for it.

use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::oneshot;

/// Who asks, by the name of a token. Where no tokens are demanded nobody is told from anybody else.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Owner(Option<Arc<str>>);

impl Owner {
    /// Whoever shows the token of this name.
    pub fn named(name: &str) -> Self {
        Self(Some(name.into()))
    }

    /// The name of the token, if there is one.
    pub fn name(&self) -> Option<&str> {
        self.0.as_deref()
    }

    /// Whether what belongs to this owner may be used by another one: what belongs to nobody may.
    pub fn lets(&self, other: &Owner) -> bool {
        self.0.is_none() || self == other
    }
}

impl fmt::Display for Owner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name().unwrap_or("anyone"))
    }
}

/// Places, and who waits for one.
pub struct Turns {
    state: Mutex<State>,
    /// Most places that one named owner holds at once.
    each: usize,
}

struct State {
    free: usize,
    held: BTreeMap<Owner, usize>,
    /// In the order of their turns; nobody is here twice, or without somebody who waits.
    waiting: VecDeque<(Owner, VecDeque<oneshot::Sender<Turn>>)>,
}

/// One place, for as long as it lives.
pub struct Turn {
    turns: Arc<Turns>,
    owner: Owner,
}

impl Turns {
    /// So many places, of which a named owner has at most `each` at a time.
    pub fn new(places: usize, each: usize) -> Arc<Self> {
        let state = State {
            free: places.max(1),
            held: BTreeMap::new(),
            waiting: VecDeque::new(),
        };
        Arc::new(Self {
            state: Mutex::new(state),
            each: each.max(1),
        })
    }

    /// Waits for a place. Who stops waiting leaves the queue.
    pub async fn take(self: &Arc<Self>, owner: &Owner) -> Turn {
        let (sender, given) = oneshot::channel();
        {
            let mut state = self.lock();
            let queue = state.waiting.iter_mut().find(|(other, _)| other == owner);
            match queue {
                Some((_, queue)) => queue.push_back(sender),
                None => state.waiting.push_back((owner.clone(), [sender].into())),
            }
        }
        self.give();
        given.await.expect("who waits is not forgotten")
    }

    /// Gives free places to those whose turn it is.
    fn give(self: &Arc<Self>) {
        while let Some((owner, sender)) = self.next() {
            let turn = Turn {
                turns: self.clone(),
                owner,
            };
            // One that stopped waiting gives its place back, which comes here again: at most once
            // for each that stopped in this very moment.
            drop(sender.send(turn));
        }
    }

    /// Takes a place for whose turn it is, if there is one.
    fn next(&self) -> Option<(Owner, oneshot::Sender<Turn>)> {
        let mut state = self.lock();
        let State {
            free,
            held,
            waiting,
        } = &mut *state;
        for (_, queue) in waiting.iter_mut() {
            queue.retain(|sender| !sender.is_closed());
        }
        waiting.retain(|(_, queue)| !queue.is_empty());
        if *free == 0 {
            return None;
        }
        let may = |owner: &Owner| {
            owner.name().is_none() || held.get(owner).copied().unwrap_or(0) < self.each
        };
        let place = waiting.iter().position(|(owner, _)| may(owner))?;
        let (owner, mut queue) = waiting.remove(place)?;
        let sender = queue.pop_front()?;
        if !queue.is_empty() {
            waiting.push_back((owner.clone(), queue));
        }
        *free -= 1;
        *held.entry(owner.clone()).or_default() += 1;
        Some((owner, sender))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        {
            let mut state = self.turns.lock();
            state.free += 1;
            if let Some(held) = state.held.get_mut(&self.owner) {
                *held -= 1;
                if *held == 0 {
                    state.held.remove(&self.owner);
                }
            }
        }
        self.turns.give();
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use tokio::time::timeout;

    use super::*;

    #[tokio::test]
    async fn places_go_round_among_owners() {
        let turns = Turns::new(1, 1);
        let (many, few) = (Owner::named("many"), Owner::named("few"));
        let first = turns.take(&many).await;
        let (told, mut order) = tokio::sync::mpsc::unbounded_channel();
        for (owner, times) in [(&many, 5), (&few, 2)] {
            for _ in 0..times {
                let (turns, owner, told) = (turns.clone(), owner.clone(), told.clone());
                tokio::spawn(async move {
                    let _turn = turns.take(&owner).await;
                    told.send(owner).unwrap();
                });
                // The queue has the order of the requests.
                tokio::task::yield_now().await;
            }
        }
        drop(told);
        drop(first);
        let mut seen = String::new();
        while let Some(owner) = order.recv().await {
            seen.push(owner.name().unwrap().chars().next().unwrap());
        }
        assert_eq!(seen, "mfmfmmm");
        assert_eq!(turns.lock().free, 1);
        assert!(turns.lock().held.is_empty());
    }

    #[tokio::test]
    async fn one_owner_leaves_a_place_to_others_and_who_gives_up_holds_none() {
        let turns = Turns::new(2, 1);
        let (one, other) = (Owner::named("one"), Owner::named("other"));
        let held = turns.take(&one).await;
        let late = timeout(Duration::from_millis(20), turns.take(&one)).await;
        assert!(late.is_err(), "one owner holds both places");
        let others = timeout(Duration::from_millis(20), turns.take(&other)).await;
        drop((held, others.expect("the other place is free")));
        assert!(
            turns
                .lock()
                .waiting
                .iter()
                .all(|(_, queue)| queue.iter().all(oneshot::Sender::is_closed))
        );
        assert_eq!(turns.lock().free, 2);
        // Where nobody has a name, all places are for all.
        let both = [
            turns.take(&Owner::default()).await,
            turns.take(&Owner::default()).await,
        ];
        drop(both);
        assert_eq!(turns.lock().free, 2);
    }
}
