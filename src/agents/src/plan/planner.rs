//! A plan from any state to the goal, by simulating its own effects on a copy of the graph. Never
//! looks for the shortest order of several objects: it takes the target first, then by identifier.

use std::collections::BTreeSet;

use reel_world::{DoorState, FLOOR, InstanceId, ReceptacleId, WorldGraph};

use crate::plan::{Intent, PlanningState, Unreachable};

/// What leads from here to the goal, with `finish` at its end.
///
/// A closed door is opened before something is taken from behind it or put there, with a free hand:
/// what is held may be put down elsewhere for that. Doors that stand otherwise than in the goal are
/// set at the end. Objects outside the goal's changes stay where they are, but for one that is
/// held: it goes back.
///
/// # Errors
/// When an object of the goal lies on the floor, is nowhere, or has to go where
/// nothing can be placed.
pub fn plan(situation: &PlanningState<'_>) -> Result<Vec<Intent>, Unreachable> {
    let mut draft = Draft {
        situation: *situation,
        graph: situation.graph.clone(),
        held: situation.held.cloned(),
        at: situation.at.cloned(),
        intents: Vec::new(),
    };
    loop {
        if let Some(object) = draft.held.clone() {
            draft.put_where_it_belongs(&object)?;
        } else if let Some(object) = draft.next_misplaced() {
            draft.fetch(&object)?;
        } else {
            break;
        }
    }
    draft.set_doors();
    draft.intents.push(Intent::Finish);
    Ok(draft.intents)
}

/// A plan being made and the state it leads to.
struct Draft<'a> {
    situation: PlanningState<'a>,
    graph: WorldGraph,
    held: Option<InstanceId>,
    at: Option<ReceptacleId>,
    intents: Vec<Intent>,
}

impl Draft<'_> {
    /// The next object of the goal that is not where it shall be: the target first.
    fn next_misplaced(&self) -> Option<InstanceId> {
        let task = self.situation.task;
        let changes = task.goal_changes();
        let moved: BTreeSet<&InstanceId> =
            changes.iter().filter_map(|event| event.object()).collect();
        let target = moved.contains(&task.target).then_some(&task.target);
        let others = moved
            .iter()
            .copied()
            .filter(|object| **object != task.target);
        target
            .into_iter()
            .chain(others)
            .find(|object| self.graph.receptacle_of(object) != task.goal.receptacle_of(object))
            .cloned()
    }

    fn fetch(&mut self, object: &InstanceId) -> Result<(), Unreachable> {
        let unreachable = |reason: String| Unreachable {
            object: object.clone(),
            reason,
        };
        let from = self
            .graph
            .receptacle_of(object)
            .cloned()
            .ok_or_else(|| unreachable("it is nowhere".into()))?;
        if from.as_str() == FLOOR {
            return Err(unreachable(
                "it lies on the floor, where the arm cannot reach".into(),
            ));
        }
        let to = self.destination(object)?;
        self.open_if_closed(&to);
        self.open_if_closed(&from);
        self.go(&from);
        let category = self
            .situation
            .task
            .object(object)
            .map_or("object", |known| &known.category)
            .to_owned();
        self.intents.push(Intent::Find {
            category,
            target: object.clone(),
        });
        self.intents.push(Intent::Pick(object.clone()));
        self.graph.remove(&from, object);
        self.held = Some(object.clone());
        Ok(())
    }

    fn put_where_it_belongs(&mut self, object: &InstanceId) -> Result<(), Unreachable> {
        let to = self.destination(object)?;
        if self.is_closed(&to) {
            let unreachable = || Unreachable {
                object: object.clone(),
                reason: format!(
                    "{to} is closed, and nothing is there to put it down on while the door is opened"
                ),
            };
            let shelf = self.shelf(&to).ok_or_else(unreachable)?;
            self.put(object, &shelf);
            self.open_if_closed(&to);
            // Something outside the goal's changes would stay on the shelf: it is in the way of
            // nobody there, but it belongs elsewhere.
            if self.next_misplaced().as_ref() != Some(object) {
                self.fetch(object)?;
            }
        } else {
            self.put(object, &to);
        }
        Ok(())
    }

    /// Where the goal wants the object.
    fn destination(&self, object: &InstanceId) -> Result<ReceptacleId, Unreachable> {
        let unreachable = |reason: String| Unreachable {
            object: object.clone(),
            reason,
        };
        let to = self
            .situation
            .task
            .goal
            .receptacle_of(object)
            .ok_or_else(|| unreachable("the goal has no place for it".into()))?;
        match self.situation.scene.receptacle(to) {
            None => Err(unreachable(format!("{to} is no receptacle of the scene"))),
            Some(receptacle) if !receptacle.placeable => {
                Err(unreachable(format!("nothing can be placed on {to}")))
            }
            Some(_) => Ok(to.clone()),
        }
    }

    /// Where to put something down for a moment: where the robot stands, or the first
    /// place without a door.
    fn shelf(&self, other_than: &ReceptacleId) -> Option<ReceptacleId> {
        let serves = |id: &ReceptacleId| {
            let placeable = self
                .situation
                .scene
                .receptacle(id)
                .is_some_and(|receptacle| receptacle.placeable);
            id != other_than && placeable && !self.is_closed(id)
        };
        let here = self.at.iter().find(|id| serves(id));
        let doorless = || {
            self.situation
                .scene
                .receptacles
                .iter()
                .map(|receptacle| &receptacle.id)
        };
        here.or_else(|| doorless().find(|id| serves(id) && self.graph.door(id).is_none()))
            .cloned()
    }

    fn put(&mut self, object: &InstanceId, to: &ReceptacleId) {
        self.go(to);
        self.intents.push(Intent::Place(to.clone()));
        self.graph.add(to, object);
        self.held = None;
    }

    fn set_doors(&mut self) {
        let goal = &self.situation.task.goal;
        let wrong = |id: &&ReceptacleId| {
            goal.door(id)
                .is_some_and(|wanted| self.graph.door(id).is_some_and(|now| now != wanted))
        };
        let mut doors: Vec<ReceptacleId> = self
            .graph
            .receptacles
            .keys()
            .filter(wrong)
            .cloned()
            .collect();
        // The door at hand comes first.
        doors.sort_by_key(|id| self.at.as_ref() != Some(id));
        for id in doors {
            self.go(&id);
            let open = goal.door(&id) == Some(DoorState::Open);
            self.intents.push(if open {
                Intent::Open(id.clone())
            } else {
                Intent::Close(id.clone())
            });
        }
    }

    fn open_if_closed(&mut self, id: &ReceptacleId) {
        if self.is_closed(id) {
            self.go(id);
            self.intents.push(Intent::Open(id.clone()));
            self.graph.receptacles.entry(id.clone()).or_default().door = Some(DoorState::Open);
        }
    }

    fn is_closed(&self, id: &ReceptacleId) -> bool {
        self.graph.door(id) == Some(DoorState::Closed)
    }

    fn go(&mut self, to: &ReceptacleId) {
        if self.at.as_ref() != Some(to) {
            self.intents.push(Intent::NavTo(to.clone()));
            self.at = Some(to.clone());
        }
    }
}
