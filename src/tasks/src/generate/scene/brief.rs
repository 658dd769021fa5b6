//! What a scene is to consist of: its rooms, and which furniture stands in each. Drawn by seed, or
//! taken from another scene.

use crate::random::Stream;
use reel_world::Scene;

use super::{SceneError, kinds};

/// Rooms by name (`bedroom/0`), each with the categories of its furniture.
#[derive(Clone, PartialEq, Debug)]
pub struct Brief {
    /// In the order of the scene.
    pub rooms: Vec<(String, Vec<String>)>,
}

/// The rooms a flat gets first, in this order; then [`MORE`] in turn.
const FIRST: [&str; 8] = reel_world::words! {
    "living room" kitchen bedroom toilet "dining room" corridor bedroom "study room"
};
const MORE: [&str; 6] = reel_world::words! {
    balcony bedroom washroom "study room" bedroom bathroom
};
/// Most balconies, and most rooms: a house of more is no home, and the map ends at 100 m.
const BALCONIES_MAX: usize = 2;
/// Most rooms of a scene.
pub const ROOMS_MAX: usize = 60;

impl Brief {
    /// What a scene consists of.
    pub fn of(scene: &Scene) -> Self {
        let inside = |room: &str| -> Vec<String> {
            let pieces = scene
                .receptacles
                .iter()
                .filter(|piece| piece.room == room && piece.placeable);
            pieces.map(|piece| piece.category.clone()).collect()
        };
        Self {
            rooms: scene
                .rooms
                .iter()
                .map(|room| (room.name.clone(), inside(&room.name)))
                .collect(),
        }
    }

    /// A flat of so many rooms with so many receptacles.
    ///
    /// # Errors
    /// When no flat of that many rooms takes that many receptacles.
    pub fn draw(rooms: usize, receptacles: usize, seed: u64) -> Result<Self, SceneError> {
        if !(1..=ROOMS_MAX).contains(&rooms) {
            return Err(SceneError::Rooms {
                asked: rooms,
                most: ROOMS_MAX,
            });
        }
        let mut stream = Stream::new(seed, "brief", rooms);
        let shift = stream.below(MORE.len());
        let mut more = MORE.iter().cycle().skip(shift);
        let mut kinds: Vec<&str> = FIRST.into_iter().take(rooms).collect();
        while kinds.len() < rooms {
            let next = more.next().expect("a cycle has no end");
            if *next != "balcony"
                || kinds.iter().filter(|kind| **kind == "balcony").count() < BALCONIES_MAX
            {
                kinds.push(next);
            }
        }
        let wishes: Vec<&[&str]> = kinds
            .iter()
            .map(|kind| {
                kinds::room_kind(kind)
                    .expect("we build what we draw")
                    .1
                    .pieces
            })
            .collect();
        let most = wishes.iter().map(|pieces| pieces.len()).sum();
        if !(1..=most).contains(&receptacles) {
            return Err(SceneError::Receptacles {
                rooms,
                asked: receptacles,
                most,
            });
        }
        // What every room needs most, then what is left over, in random order.
        let mut counts = vec![0; rooms];
        for _ in 0..receptacles {
            let least = (0..rooms)
                .filter(|room| counts[*room] < wishes[*room].len())
                .map(|room| counts[room].min(2))
                .min();
            let open: Vec<usize> = (0..rooms)
                .filter(|room| {
                    counts[*room] < wishes[*room].len() && Some(counts[*room].min(2)) == least
                })
                .collect();
            counts[*stream.pick(&open).expect("the sum was checked")] += 1;
        }
        let named = kinds.iter().enumerate().map(|(index, kind)| {
            let number = kinds[..index].iter().filter(|other| *other == kind).count();
            let pieces = wishes[index][..counts[index]]
                .iter()
                .map(|piece| (*piece).to_owned())
                .collect();
            (format!("{kind}/{number}"), pieces)
        });
        Ok(Self {
            rooms: named.collect(),
        })
    }
}
