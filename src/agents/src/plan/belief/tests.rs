//! The competent agent in worlds without physics: whatever turns out, it succeeds, and every move
//! brings it nearer by one at least. No regret, in every world of a grid.

use std::collections::BTreeSet;

use reel_world::ReceptacleId;

use super::{Belief, CallEffect, DeliveryGoal, Move, ObjectIndex, Objection, PerceivedView};

/// Two things: what is meant, and one like it that the vague words fit too.
const MEANT: ObjectIndex = 0;
const LIKE: ObjectIndex = 1;

/// A world in which one errand is to be done.
#[derive(Clone, Debug)]
struct World {
    errand: DeliveryGoal,
    places: Vec<ReceptacleId>,
    closed: BTreeSet<ReceptacleId>,
    /// Where the things are; none: in the hand.
    at: [Option<ReceptacleId>; 2],
    /// What cannot be seen from the viewpoint, only found by walking around.
    hidden: bool,
    told: bool,
    robot: Option<ReceptacleId>,
    numbered: BTreeSet<ObjectIndex>,
    receptacles: BTreeSet<ReceptacleId>,
}

impl World {
    fn new(
        sources: usize,
        source: usize,
        destinations: usize,
        destination: usize,
        vague: bool,
        hidden: bool,
    ) -> Self {
        let name = |kind: &str, index: usize| ReceptacleId::from(format!("{kind}_{index}"));
        let sources: Vec<_> = (0..sources).map(|index| name("table", index)).collect();
        let destinations: Vec<_> = (0..destinations).map(|index| name("desk", index)).collect();
        let errand = DeliveryGoal {
            source: sources[source].clone(),
            destination: destinations[destination].clone(),
            vague,
            sources: sources.clone(),
            destinations: destinations.clone(),
        };
        let at = [Some(errand.source.clone()), Some(errand.source.clone())];
        let places = sources.into_iter().chain(destinations).collect();
        let (closed, numbered, receptacles) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        Self {
            errand,
            places,
            closed,
            at,
            hidden,
            told: false,
            robot: None,
            numbered,
            receptacles,
        }
    }

    fn here(&self) -> Vec<ObjectIndex> {
        let open = self
            .robot
            .as_ref()
            .is_some_and(|robot| !self.closed.contains(robot));
        [MEANT, LIKE]
            .into_iter()
            .filter(|thing| open && self.at[*thing as usize] == self.robot)
            .collect()
    }

    fn view(&self) -> PerceivedView {
        let seen = self
            .here()
            .into_iter()
            .filter(|thing| !self.hidden || self.numbered.contains(thing));
        let fits = |thing: ObjectIndex| thing == MEANT || (self.errand.vague && !self.told);
        PerceivedView {
            objects: seen
                .map(|thing| (thing, self.at[thing as usize].clone(), vec![fits(thing)]))
                .collect(),
            numbered: self.numbered.clone(),
            receptacles: self.receptacles.clone(),
        }
    }

    fn make(&mut self, next: &Move) -> CallEffect {
        if matches!(
            next,
            Move::NavTo(_) | Move::ShowReceptacles | Move::Find(_) | Move::WalkAround
        ) {
            self.numbered.clear();
            self.receptacles.clear();
        }
        match next {
            Move::NavTo(place) => {
                assert!(self.places.contains(place));
                self.robot = Some(place.clone());
                CallEffect::NavTo(place.clone())
            }
            Move::ShowReceptacles => {
                self.receptacles.extend(self.robot.clone());
                CallEffect::ShowReceptacles
            }
            Move::Find(thing) => {
                assert!(self.here().contains(thing) && !self.hidden);
                self.numbered.insert(*thing);
                CallEffect::Find
            }
            Move::WalkAround => {
                self.numbered.extend(self.here());
                CallEffect::WalkAround
            }
            Move::Gaze(thing) => CallEffect::Gaze(*thing),
            Move::Pick(thing) => {
                assert!(
                    self.here().contains(thing)
                        && self.numbered.remove(thing)
                        && self.held().is_none()
                );
                self.at[*thing as usize] = None;
                CallEffect::Pick(*thing)
            }
            Move::Place(place) => {
                assert!(
                    self.receptacles.contains(place)
                        && self.robot.as_ref() == Some(place)
                        && !self.closed.contains(place)
                );
                let held = self.held().expect("something is held");
                self.at[held as usize] = Some(place.clone());
                CallEffect::Place(place.clone())
            }
            Move::Open(place) => {
                assert!(
                    self.held().is_none()
                        && self.receptacles.contains(place)
                        && self.closed.remove(place)
                );
                CallEffect::Open(place.clone())
            }
            Move::Close(place) => {
                assert!(self.held().is_none() && self.closed.insert(place.clone()));
                CallEffect::Close(place.clone())
            }
            Move::Ask(_) => {
                self.told = true;
                CallEffect::Ask(true)
            }
            Move::Finish(_) => unreachable!("it ends the loop"),
        }
    }

    fn held(&self) -> Option<ObjectIndex> {
        [MEANT, LIKE]
            .into_iter()
            .find(|thing| self.at[*thing as usize].is_none())
    }
}

/// Lets the agent act to its end; gives its moves.
fn act(world: &mut World, belief: &mut Belief) -> Vec<Move> {
    let mut moves = Vec::new();
    loop {
        let next = belief.next();
        moves.push(next.clone());
        let before = belief
            .cost_to_go()
            .unwrap_or_else(|| panic!("no way: {world:?}\n{belief:#?}"));
        if let Move::Finish(done) = next {
            assert!(done && before == 1, "{world:?}");
            return moves;
        }
        let deed = world.make(&next);
        belief.learn(&deed, &world.view());
        for thing in [MEANT, LIKE] {
            belief.fits(
                thing,
                vec![thing == MEANT || (world.errand.vague && !world.told)],
            );
        }
        let after = belief.cost_to_go();
        assert!(
            after.is_some_and(|after| after < before),
            "{next:?}: {before} -> {after:?}\n{world:?}\n{belief:#?}"
        );
        assert!(moves.len() < 60, "{moves:?}");
    }
}

fn start(world: &World) -> Belief {
    let mut belief = Belief::new(vec![world.errand.clone()], world.closed.clone());
    belief.see(&world.view());
    belief
}

fn worlds() -> Vec<World> {
    let mut worlds = Vec::new();
    for sources in 1..4 {
        for destinations in 1..4 {
            for (source, destination) in
                (0..sources).flat_map(|source| (0..destinations).map(move |other| (source, other)))
            {
                for bits in 0..16_u32 {
                    let mut world = World::new(
                        sources,
                        source,
                        destinations,
                        destination,
                        bits & 1 > 0,
                        bits & 2 > 0,
                    );
                    world
                        .closed
                        .extend((bits & 4 > 0).then(|| world.errand.source.clone()));
                    world
                        .closed
                        .extend((bits & 8 > 0).then(|| world.errand.destination.clone()));
                    worlds.push(world);
                }
            }
        }
    }
    worlds
}

#[test]
fn it_succeeds_in_every_world_and_regrets_nothing() {
    let mut worst_cases_met = 0;
    for mut world in worlds() {
        let mut belief = start(&world);
        let promised = belief.cost_to_go().unwrap();
        let closed = world.closed.clone();
        let moves = act(&mut world, &mut belief);
        assert_eq!(
            world.at,
            [
                Some(world.errand.destination.clone()),
                Some(world.errand.source.clone())
            ],
            "{moves:?}"
        );
        assert_eq!(world.closed, closed, "doors stand as before");
        assert!(moves.len() as u32 <= promised, "{moves:?}");
        worst_cases_met += usize::from(moves.len() as u32 == promised);
    }
    assert!(
        worst_cases_met * 10 > worlds().len(),
        "a bound that is never met is none: {worst_cases_met}"
    );
}

#[test]
fn what_was_done_wrong_is_made_good() {
    for mut world in worlds() {
        // Somebody took the other thing, and left it at the destination.
        let mut belief = start(&world);
        let (source, destination) = (
            world.errand.source.clone(),
            world.errand.destination.clone(),
        );
        for door in [&source, &destination] {
            if world.closed.contains(door) {
                for next in [
                    Move::NavTo(door.clone()),
                    Move::ShowReceptacles,
                    Move::Open(door.clone()),
                ] {
                    let deed = world.make(&next);
                    belief.learn(&deed, &world.view());
                }
            }
        }
        let wrong = [
            Move::NavTo(source.clone()),
            Move::WalkAround,
            Move::Gaze(LIKE),
            Move::Pick(LIKE),
        ];
        let placed = [
            Move::NavTo(destination.clone()),
            Move::ShowReceptacles,
            Move::Place(destination.clone()),
        ];
        let mut costs = Vec::new();
        for next in wrong.iter().chain(&placed) {
            if *next == Move::Pick(LIKE) {
                let objection = if world.errand.vague {
                    Objection::Communication
                } else {
                    Objection::Perception
                };
                assert_eq!(belief.objection(next), Some(objection));
            }
            costs.push(belief.cost_to_go().unwrap());
            let deed = world.make(next);
            belief.learn(&deed, &world.view());
        }
        costs.push(belief.cost_to_go().unwrap());
        assert!(
            costs[4] > costs[3] && costs[7] > costs[3],
            "a wrong pick costs: {costs:?}"
        );
        act(&mut world, &mut belief);
        assert_eq!(world.at, [Some(destination), Some(source)]);
    }
}

#[test]
fn of_two_equal_things_it_takes_the_one_that_can_be_taken() {
    let world = World::new(1, 0, 1, 0, false, false);
    let (mut belief, source) = (start(&world), world.errand.source.clone());
    let both = [MEANT, LIKE]
        .map(|thing| (thing, Some(source.clone()), vec![true]))
        .to_vec();
    let view = PerceivedView {
        objects: both,
        numbered: [MEANT, LIKE].into(),
        receptacles: BTreeSet::new(),
    };
    for deed in [
        CallEffect::NavTo(source),
        CallEffect::WalkAround,
        CallEffect::Gaze(MEANT),
    ] {
        belief.learn(&deed, &view);
    }
    assert_eq!(belief.next(), Move::Pick(MEANT));
    belief.learn(&CallEffect::Lost(MEANT), &view);
    assert_eq!(belief.next(), Move::Gaze(LIKE));
    belief.learn(&CallEffect::Gaze(LIKE), &view);
    assert_eq!(belief.next(), Move::Pick(LIKE));
}
