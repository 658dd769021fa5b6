//! What a reward reads of a task, prepared once: its names as numbers, its goal, its start, its words. Never knows an episode.

use std::collections::BTreeSet;

use reel_world::{DoorState, FLOOR, GraphEvent, InstanceId, ObjectInstance, Scene, Task, WorldGraph, language};

use crate::{
    ambiguity,
    facts::{AssetChange, AssetKey, Called, Change, Counts, EpisodeFacts, ObjectKey, PlaceKey, ReplyKey, StepHead, names::Names},
    goal,
};

/// A task as a reward reads it, and the numbers of everything that its episodes name. One can serve any number of
/// episodes of its task, one after the other; what only records know is numbered as it comes.
#[derive(Clone, Debug)]
pub struct TaskFacts {
    objects: Names,
    object_facts: Vec<ObjectFacts>,
    assets: Names,
    places: Names,
    replies: Names,
    /// Which candidates each reply leaves, once it was asked for.
    reply_fits: Vec<Option<Box<[bool]>>>,
    /// `Delta_goal`
    pub(crate) goal: Vec<GoalChange>,
    /// `Delta_task`
    pub(crate) targets: Vec<Target>,
    /// The target diffs of preset `real-repo`.
    pub(crate) asset_goal: Vec<AssetChange>,
    pub(crate) initial: Counts,
    pub(crate) initial_assets: Counts,
    /// By place.
    pub(crate) initial_doors: Vec<Option<DoorState>>,
    pub(crate) floor: PlaceKey,
    /// Objects that fit the instruction; those of one asset stand together.
    pub(crate) candidates: Vec<Candidate>,
    /// How many questions the task is worth, before the preset's limit.
    pub(crate) ask_budget: u32,
}

/// An element of `Delta_task`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Target {
    /// Of `Delta_goal`.
    Goal(Change),
    /// First successful `nav_to`.
    Visit(PlaceKey),
    /// `(receptacle, open)`
    Opening(PlaceKey),
}

/// An element of `Delta_goal`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GoalChange {
    pub(crate) change: Change,
    /// How many of the object stood there at the start.
    pub(crate) was: u32,
    /// How many equal elements come before it.
    pub(crate) earlier: u32,
}

/// An object that the instruction may mean.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) object: ObjectKey,
    pub(crate) asset: AssetKey,
    instance: ObjectInstance,
}

/// What counts of an object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObjectFacts {
    pub(crate) asset: AssetKey,
    /// Whether its category is, or contains, the target's.
    pub(crate) like_target: bool,
    /// Whether a goal change names it.
    pub(crate) in_goal: bool,
    /// Whether the goal takes it away from somewhere.
    pub(crate) moves_away: bool,
    /// Whether the goal wants it somewhere.
    pub(crate) has_destination: bool,
}

impl TaskFacts {
    /// Prepares a task. The scene says which captions tell like receptacles apart.
    pub fn new(task: &Task, scene: &Scene) -> Self {
        let fits = |object: &&ObjectInstance| language::fits(&task.instruction, object, task.purpose.as_deref());
        let mut facts = TaskFacts {
            objects: Names::default(),
            object_facts: Vec::new(),
            assets: Names::default(),
            places: Names::default(),
            replies: Names::default(),
            reply_fits: Vec::new(),
            goal: Vec::new(),
            targets: Vec::new(),
            asset_goal: Vec::new(),
            initial: Counts::default(),
            initial_assets: Counts::default(),
            initial_doors: Vec::new(),
            floor: PlaceKey(0),
            candidates: Vec::new(),
            ask_budget: ambiguity::budget(task, scene),
        };
        facts.name_all(task, scene);
        facts.set_goal(task);
        facts.set_start(&task.initial);
        for object in task.objects.iter().filter(fits) {
            let key = facts.object(object.instance.as_str());
            let asset = AssetKey(facts.assets.number(object.asset.as_str()));
            facts.candidates.push(Candidate { object: key, asset, instance: object.clone() });
        }
        facts.candidates.sort_by_key(|candidate| candidate.asset);
        facts.objects.keep();
        facts.places.keep();
        facts.assets.keep();
        facts
    }

    /// Starts another episode: empties its facts, and forgets names that only earlier episodes had, if they became many.
    pub fn begin(&mut self, episode: &mut EpisodeFacts) {
        episode.clear();
        if self.objects.trim() {
            self.object_facts.truncate(self.objects.len());
        }
        self.places.trim();
        self.assets.trim();
        if self.replies.trim() {
            self.reply_fits.truncate(self.replies.len());
        }
    }

    /// The number of an object instance, also of one that the task does not know.
    pub fn object(&mut self, instance: &str) -> ObjectKey {
        let number = self.objects.number(instance);
        if number as usize == self.object_facts.len() {
            let asset = AssetKey(self.assets.number(instance.split_once("_on_").map_or(instance, |(asset, _)| asset)));
            let unknown = ObjectFacts { asset, like_target: false, in_goal: false, moves_away: false, has_destination: false };
            self.object_facts.push(unknown);
        }
        ObjectKey(number)
    }

    /// The number of a receptacle or the floor, also of one that the task does not know.
    pub fn place(&mut self, receptacle: &str) -> PlaceKey {
        PlaceKey(self.places.number(receptacle))
    }

    /// The number of a reply. Numbers of replies hold until the next [`TaskFacts::begin`].
    pub fn reply(&mut self, text: &str) -> ReplyKey {
        let number = self.replies.number(text);
        if number as usize == self.reply_fits.len() {
            self.reply_fits.push(None);
        }
        ReplyKey(number)
    }

    /// The call of a step, from its tool, the code of its error and the text of its argument: the marker or the receptacle that
    /// it names. The rest of the head is empty.
    pub fn called(&mut self, tool: &str, error_code: Option<&str>, argument: Option<&str>) -> StepHead {
        let tool = Called::parse(tool, error_code);
        let marker = match tool {
            Called::GazeAt | Called::Pick | Called::Place => argument.and_then(|text| text.trim().parse().ok()),
            _ => None,
        };
        let driven_to = argument.filter(|_| tool == Called::NavTo).map(|receptacle| self.place(receptacle));
        StepHead { tool, marker, driven_to, ..StepHead::default() }
    }

    /// A change from the columns of the tables: event (`add`, `remove`, `door`) and its operands; none where they do not
    /// fit together.
    pub fn change(
        &mut self,
        event: &str,
        object: Option<&str>,
        receptacle: &str,
        door_from: Option<&str>,
        door_to: Option<&str>,
    ) -> Option<Change> {
        let place = self.place(receptacle);
        Some(match event {
            "add" => Change::Add { object: self.object(object?), place },
            "remove" => Change::Remove { object: self.object(object?), place },
            "door" => Change::Door { place, from: door(door_from?)?, to: door(door_to?)? },
            _ => return None,
        })
    }

    /// A change from a record.
    pub(crate) fn event(&mut self, event: &GraphEvent) -> Change {
        let place = self.place(event.receptacle().as_str());
        match event {
            GraphEvent::Remove { object, .. } => Change::Remove { object: self.object(object.as_str()), place },
            GraphEvent::Add { object, .. } => Change::Add { object: self.object(object.as_str()), place },
            GraphEvent::Door { from, to, .. } => Change::Door { place, from: *from, to: *to },
        }
    }

    pub(crate) fn object_name(&self, object: ObjectKey) -> &str {
        self.objects.name(object.0)
    }

    pub(crate) fn asset_name(&self, asset: AssetKey) -> &str {
        self.assets.name(asset.0)
    }

    pub(crate) fn place_name(&self, place: PlaceKey) -> &str {
        self.places.name(place.0)
    }

    pub(crate) fn reply_text(&self, reply: ReplyKey) -> &str {
        self.replies.name(reply.0)
    }

    pub(crate) fn of(&self, object: ObjectKey) -> &ObjectFacts {
        &self.object_facts[object.0 as usize]
    }

    pub(crate) fn asset_of(&self, object: ObjectKey) -> AssetKey {
        self.of(object).asset
    }

    pub(crate) fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// The first place, in the order of identifiers, that holds a thing.
    pub(crate) fn first_place(&self, counts: &Counts, thing: u32) -> Option<PlaceKey> {
        counts.places_of(thing).min_by(|a, b| self.place_name(*a).cmp(self.place_name(*b)))
    }

    /// Which candidates a reply leaves; none said is an empty one. The words are read once a reply.
    pub(crate) fn fits(&mut self, reply: Option<ReplyKey>) -> &[bool] {
        let reply = reply.unwrap_or_else(|| self.reply(""));
        let (text, candidates) = (self.replies.name(reply.0), &self.candidates);
        self.reply_fits[reply.0 as usize]
            .get_or_insert_with(|| candidates.iter().map(|candidate| language::fits(text, &candidate.instance, None)).collect())
    }

    fn name_all(&mut self, task: &Task, scene: &Scene) {
        let of_graph = |graph: &WorldGraph| -> Vec<InstanceId> {
            graph.receptacles.values().flat_map(|state| state.content.keys().cloned()).collect()
        };
        let mut objects: BTreeSet<InstanceId> = task.objects.iter().map(|object| object.instance.clone()).collect();
        objects.extend(of_graph(&task.initial).into_iter().chain(of_graph(&task.goal)));
        for object in &objects {
            self.object(object.as_str());
        }
        let mut places: BTreeSet<&str> = scene.receptacles.iter().map(|receptacle| receptacle.id.as_str()).collect();
        places.extend(task.initial.receptacles.keys().chain(task.goal.receptacles.keys()).map(|id| id.as_str()));
        places.extend([task.src.as_str(), task.dest.as_str(), FLOOR]);
        for place in places {
            self.place(place);
        }
        self.floor = self.place(FLOOR);
        let category = task.object(&task.target).map(|target| target.category.to_lowercase()).unwrap_or_default();
        for object in task.objects.iter().filter(|object| object.category.to_lowercase().contains(&category)) {
            let key = self.object(object.instance.as_str());
            self.object_facts[key.0 as usize].like_target = !category.is_empty();
        }
    }

    fn set_goal(&mut self, task: &Task) {
        let events = task.goal_changes();
        for (index, event) in events.iter().enumerate() {
            let change = self.event(event);
            let earlier = events[..index].iter().filter(|other| *other == event).count() as u32;
            self.goal.push(GoalChange { change, was: goal::count(&task.initial, event), earlier });
            self.targets.push(Target::Goal(change));
            let (Change::Add { object, .. } | Change::Remove { object, .. }) = change else { continue };
            let facts = &mut self.object_facts[object.0 as usize];
            facts.in_goal = true;
            facts.moves_away |= matches!(change, Change::Remove { .. });
            facts.has_destination |= matches!(change, Change::Add { .. });
        }
        let places = if task.src == task.dest { vec![&task.src] } else { vec![&task.src, &task.dest] };
        for place in &places {
            let place = self.place(place.as_str());
            self.targets.push(Target::Visit(place));
        }
        for id in places {
            let place = self.place(id.as_str());
            let opening = Change::Door { place, from: DoorState::Closed, to: DoorState::Open };
            if task.initial.door(id) == Some(DoorState::Closed) && !self.goal.iter().any(|goal| goal.change == opening) {
                self.targets.push(Target::Opening(place));
            }
        }
        for event in goal::by_asset(&task.goal).difference(&goal::by_asset(&task.initial)) {
            let Some(asset) = event.object() else { continue };
            let add = matches!(event, GraphEvent::Add { .. });
            let (asset, place) = (AssetKey(self.assets.number(asset.as_str())), self.place(event.receptacle().as_str()));
            self.asset_goal.push(AssetChange { asset, place, add });
        }
        self.asset_goal.sort_by_key(|change| (change.place, !change.add, change.asset));
    }

    fn set_start(&mut self, initial: &WorldGraph) {
        for (id, state) in &initial.receptacles {
            let place = self.place(id.as_str());
            if self.initial_doors.len() <= place.0 as usize {
                self.initial_doors.resize(place.0 as usize + 1, None);
            }
            self.initial_doors[place.0 as usize] = state.door;
            for (instance, count) in &state.content {
                let object = self.object(instance.as_str());
                for _ in 0..*count {
                    self.initial.add(object.0, place);
                    self.initial_assets.add(self.asset_of(object).0, place);
                }
            }
        }
    }
}

fn door(text: &str) -> Option<DoorState> {
    match text {
        "open" => Some(DoorState::Open),
        "closed" => Some(DoorState::Closed),
        _ => None,
    }
}
