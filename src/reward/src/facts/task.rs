//! What a reward reads of a task, prepared once: its names as numbers, its goal, its start, its
//! words. Never knows an episode.

use std::collections::BTreeSet;

use reel_world::{
    DoorState, ErrorCode, FLOOR, GraphEvent, InstanceId, ObjectInstance, ReceptacleId,
    ReceptacleState, Scene, Task, WorldGraph, language,
};

use crate::{
    ambiguity,
    facts::{
        Change, Counts, Delivery, EpisodeFacts, Identity, KindKey, Kinds, MarkerReferent,
        ObjectKey, ReceptacleKey, StepHead, TextKey, ToolKind, TrainerReading, is_no_call,
        names::Names,
    },
    goal,
    trainer::{Categories, Graph, GraphSize, TextError, is_dropped, is_unknown, lower},
};

/// A task as a reward reads it, and the numbers of everything that its episodes name. One can
/// serve any number of episodes of its task, one after the other; what only records know is
/// numbered as it comes.
#[derive(Clone, Debug)]
pub struct TaskFacts {
    objects: Names,
    object_facts: Vec<ObjectFacts>,
    pub(crate) assets: Kinds,
    pub(crate) categories: Kinds,
    /// Translates names into categories.
    mapping: Categories,
    /// Category of the target object, in lower case.
    target_category: String,
    places: Names,
    /// What the name of a marked object or receptacle holds, once it was asked for; by number.
    object_mentions: Vec<Option<Mentions>>,
    place_mentions: Vec<Option<Mentions>>,
    texts: Names,
    /// Which candidates each reply leaves, once it was asked for.
    reply_fits: Vec<Option<Box<[bool]>>>,
    /// `Delta_goal`: the changes from the task's initial graph to its goal graph.
    pub(crate) goal: Vec<GoalChange>,
    /// `Delta_task`: the goal changes, first visits and door openings to be matched.
    pub(crate) targets: Vec<Target>,
    pub(crate) initial: Counts,
    /// Of the initial graph, by which the trainer judges the next one.
    pub(crate) initial_size: GraphSize,
    /// Initial door state by receptacle number; `None` if there is no door.
    pub(crate) initial_doors: Vec<Option<DoorState>>,
    pub(crate) floor: ReceptacleKey,
    /// Objects that fit the instruction; those of one asset stand together.
    pub(crate) candidates: Vec<Candidate>,
    /// How many questions the task is worth, before the preset's limit.
    pub(crate) ask_budget: u32,
    /// Whether the task has a goal; without one nothing is rewarded.
    pub(crate) has_goal: bool,
}

/// An element of `Delta_task`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Target {
    /// A goal change, i.e. an element of `Delta_goal`.
    Goal(Change),
    /// The first successful `nav_to` to this receptacle.
    Visit(ReceptacleKey),
    /// `(receptacle, open)`: the opening of a door that is closed at the start.
    Opening(ReceptacleKey),
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
    pub(crate) asset: KindKey,
    instance: ObjectInstance,
}

/// What occurs in the name of something that has a marker.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mentions {
    /// Assets of target differences.
    assets: Box<[KindKey]>,
    /// Categories of target differences.
    categories: Box<[KindKey]>,
    /// Whether the target's category does, whatever its case.
    pub(crate) target_category: bool,
}

impl Mentions {
    pub(crate) fn targets(&self, identity: Identity) -> &[KindKey] {
        match identity {
            Identity::Asset => &self.assets,
            Identity::Category => &self.categories,
        }
    }
}

/// What counts of an object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObjectFacts {
    pub(crate) asset: KindKey,
    /// Its category; an unknown name is one of its own.
    pub(crate) category: KindKey,
    /// What the trainer takes it for while it is held.
    held_category: KindKey,
    /// Whether the trainer refuses graphs that hold it.
    pub(crate) is_unknown: bool,
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
    /// Prepares a task. The scene says which captions tell like receptacles apart, and in
    /// which order graphs come.
    pub fn new(task: &Task, scene: &Scene) -> Self {
        let fits = |object: &&ObjectInstance| {
            language::fits(&task.instruction, object, task.purpose.as_deref())
        };
        let category = task
            .object(&task.target)
            .map(|target| target.category.as_str())
            .unwrap_or_default();
        let mut facts = Self::empty(Categories::of_task(task), category);
        facts.ask_budget = ambiguity::budget(task, scene);
        facts.has_goal = task.has_goal();
        facts.name_all(task, scene);
        facts.set_goal(task);
        facts.set_start(&task.initial);
        facts.set_kinds(&contents(&task.initial), &contents(&task.goal));
        facts.initial_size.is_empty = task.initial.receptacles.is_empty();
        for object in task.objects.iter().filter(fits) {
            let key = facts.object(object.instance.as_str());
            facts.candidates.push(Candidate {
                object: key,
                asset: facts.of(key).asset,
                instance: object.clone(),
            });
        }
        facts.candidates.sort_by_key(|candidate| candidate.asset);
        facts.keep();
        facts
    }

    /// Prepares what preset `real-trainer` reads, from what the trainer is told of a task.
    /// The rest is empty.
    pub(crate) fn for_trainer(
        mapping: Categories,
        category: &str,
        initial: &Graph,
        goal: &Graph,
    ) -> Self {
        let mut facts = Self::empty(mapping, category);
        for (receptacle, _) in initial.0.iter().chain(&goal.0) {
            facts.receptacle(receptacle);
        }
        let objects = |graph: &Graph| {
            graph
                .objects()
                .map(|(name, place)| (name.to_owned(), place.to_owned()))
                .collect::<Vec<_>>()
        };
        facts.set_kinds(&objects(initial), &objects(goal));
        facts.initial_size.is_empty = initial.0.is_empty();
        facts.floor = facts.receptacle(FLOOR);
        facts.keep();
        facts
    }

    fn empty(mapping: Categories, category: &str) -> Self {
        TaskFacts {
            objects: Names::default(),
            object_facts: Vec::new(),
            assets: Kinds::default(),
            categories: Kinds::default(),
            mapping,
            target_category: category.to_lowercase(),
            places: Names::default(),
            object_mentions: Vec::new(),
            place_mentions: Vec::new(),
            texts: Names::default(),
            reply_fits: Vec::new(),
            goal: Vec::new(),
            targets: Vec::new(),
            initial: Counts::default(),
            initial_size: GraphSize::default(),
            initial_doors: Vec::new(),
            floor: ReceptacleKey(0),
            candidates: Vec::new(),
            ask_budget: 0,
            has_goal: true,
        }
    }

    fn keep(&mut self) {
        self.objects.keep();
        self.places.keep();
        self.assets.keep();
        self.categories.keep();
    }

    /// Starts another episode: empties its facts, and forgets names that only earlier episodes had,
    /// if they became many.
    pub fn begin(&mut self, episode: &mut EpisodeFacts) {
        episode.clear();
        if self.objects.trim() {
            self.object_facts.truncate(self.objects.len());
            self.object_mentions.truncate(self.objects.len());
            self.assets.trim();
            self.categories.trim();
        }
        if self.places.trim() {
            self.place_mentions.truncate(self.places.len());
        }
        if self.texts.trim() {
            self.reply_fits.truncate(self.texts.len());
        }
    }

    /// The number of an object instance, also of one that the task does not know.
    pub fn object(&mut self, instance: &str) -> ObjectKey {
        let number = self.objects.number(instance);
        if number as usize == self.object_facts.len() {
            let converted = self.mapping.convert(instance);
            self.object_facts.push(ObjectFacts {
                asset: self.assets.key(
                    instance
                        .split_once("_on_")
                        .map_or(instance, |(asset, _)| asset),
                ),
                category: self.categories.key(converted),
                held_category: self.categories.key(self.mapping.of_held(instance)),
                is_unknown: is_unknown(converted),
                like_target: false,
                in_goal: false,
                moves_away: false,
                has_destination: false,
            });
        }
        ObjectKey(number)
    }

    /// The number of a receptacle or the floor, also of one that the task does not know.
    pub fn receptacle(&mut self, receptacle: &str) -> ReceptacleKey {
        ReceptacleKey(self.places.number(receptacle))
    }

    /// The number of a text, such as a reply. It holds until the next [`TaskFacts::begin`].
    pub fn text(&mut self, text: &str) -> TextKey {
        TextKey(self.texts.number(text))
    }

    /// The call of a step, from its tool, the code of its error and the text of its argument: the
    /// marker or the receptacle that it names. The rest of the head is empty.
    pub fn head_of_call(
        &mut self,
        tool: &str,
        error_code: Option<&str>,
        argument: Option<&str>,
    ) -> StepHead {
        let named = ToolKind::named(tool);
        let tool = if is_no_call(error_code) {
            ToolKind::Other
        } else {
            named
        };
        let unreadable = error_code == Some(ErrorCode::UnparsableOutput.as_str());
        let delivery = if unreadable {
            Delivery::Unreadable
        } else {
            Delivery::Executed
        };
        let takes_marker = matches!(named, ToolKind::GazeAt | ToolKind::Pick);
        let marker = argument
            .filter(|_| takes_marker)
            .map(|text| self.text(text));
        let driven_to = argument
            .filter(|_| tool == ToolKind::NavTo)
            .map(|receptacle| self.receptacle(receptacle));
        StepHead {
            tool,
            named,
            delivery,
            marker,
            driven_to,
            ..StepHead::default()
        }
    }

    /// What the trainer reads from the text of a call's result.
    pub fn trainer_reading(&mut self, call: &StepHead, text: &str) -> TrainerReading {
        if is_dropped(text) {
            return TrainerReading::default();
        }
        let words = (call.named == ToolKind::Ask).then(|| self.text(text));
        TrainerReading {
            error: TextError::find(text),
            words,
        }
    }

    /// A change from the columns of the tables: event (`add`, `remove`, `door`) and its operands;
    /// none where they do not fit together.
    pub fn change(
        &mut self,
        event: &str,
        object: Option<&str>,
        receptacle: &str,
        door_from: Option<&str>,
        door_to: Option<&str>,
    ) -> Option<Change> {
        let place = self.receptacle(receptacle);
        Some(match event {
            "add" => Change::Add {
                object: self.object(object?),
                place,
            },
            "remove" => Change::Remove {
                object: self.object(object?),
                place,
            },
            "door" => Change::Door {
                place,
                from: door(door_from?)?,
                to: door(door_to?)?,
            },
            _ => return None,
        })
    }

    /// A change from a record.
    pub(crate) fn event(&mut self, event: &GraphEvent) -> Change {
        let place = self.receptacle(event.receptacle().as_str());
        match event {
            GraphEvent::Remove { object, .. } => Change::Remove {
                object: self.object(object.as_str()),
                place,
            },
            GraphEvent::Add { object, .. } => Change::Add {
                object: self.object(object.as_str()),
                place,
            },
            GraphEvent::Door { from, to, .. } => Change::Door {
                place,
                from: *from,
                to: *to,
            },
        }
    }

    pub(crate) fn object_name(&self, object: ObjectKey) -> &str {
        self.objects.name(object.0)
    }

    /// The kinds of a task under an identity.
    pub(crate) fn kinds(&self, identity: Identity) -> &Kinds {
        match identity {
            Identity::Asset => &self.assets,
            Identity::Category => &self.categories,
        }
    }

    /// The kind of an object under an identity.
    pub(crate) fn kind_of(&self, identity: Identity, object: ObjectKey) -> KindKey {
        match identity {
            Identity::Asset => self.of(object).asset,
            Identity::Category => self.of(object).category,
        }
    }

    /// The kind that a held object is taken for.
    pub(crate) fn held_kind(&self, identity: Identity, object: ObjectKey) -> KindKey {
        match identity {
            Identity::Asset => self.of(object).asset,
            Identity::Category => self.of(object).held_category,
        }
    }

    /// What occurs in the name of something marked. The name is searched once.
    pub(crate) fn mentions(&mut self, marked: MarkerReferent) -> &Mentions {
        let (name, number, known) = match marked {
            MarkerReferent::Object(object) => (
                self.objects.name(object.0),
                object.0 as usize,
                &mut self.object_mentions,
            ),
            MarkerReferent::Receptacle(place) => (
                self.places.name(place.0),
                place.0 as usize,
                &mut self.place_mentions,
            ),
        };
        if known.len() <= number {
            known.resize_with(number + 1, || None);
        }
        known[number].get_or_insert_with(|| {
            let among = |kinds: &Kinds| -> Box<[KindKey]> {
                let mut found: Vec<KindKey> = kinds.goal.iter().map(|change| change.kind).collect();
                found.sort_unstable();
                found.dedup();
                found
                    .into_iter()
                    .filter(|kind| name.contains(kinds.name(*kind)))
                    .collect()
            };
            let category = &self.target_category;
            let target_category = !category.is_empty() && lower(name).contains(category.as_str());
            Mentions {
                assets: among(&self.assets),
                categories: among(&self.categories),
                target_category,
            }
        })
    }

    pub(crate) fn place_name(&self, place: ReceptacleKey) -> &str {
        self.places.name(place.0)
    }

    pub(crate) fn text_of(&self, text: TextKey) -> &str {
        self.texts.name(text.0)
    }

    pub(crate) fn of(&self, object: ObjectKey) -> &ObjectFacts {
        &self.object_facts[object.0 as usize]
    }

    pub(crate) fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// The first place, in the order of the scene, that holds a thing. Places that the task does
    /// not know come last, by name.
    pub(crate) fn first_place(&self, counts: &Counts, thing: u32) -> Option<ReceptacleKey> {
        let order = |place: &ReceptacleKey| {
            let known = self.places.is_kept(place.0);
            (
                !known,
                known.then_some(place.0),
                (!known).then(|| self.place_name(*place)),
            )
        };
        counts
            .places_of(thing)
            .min_by(|a, b| order(a).cmp(&order(b)))
    }

    /// Which candidates a reply leaves; none said is an empty one. The words are read once a reply.
    pub(crate) fn fits(&mut self, reply: Option<TextKey>) -> &[bool] {
        let reply = reply.unwrap_or_else(|| self.text("")).0;
        if self.reply_fits.len() <= reply as usize {
            self.reply_fits.resize(reply as usize + 1, None);
        }
        let (text, candidates) = (self.texts.name(reply), &self.candidates);
        self.reply_fits[reply as usize].get_or_insert_with(|| {
            candidates
                .iter()
                .map(|candidate| language::fits(text, &candidate.instance, None))
                .collect()
        })
    }

    fn name_all(&mut self, task: &Task, scene: &Scene) {
        let of_graph = |graph: &WorldGraph| -> Vec<InstanceId> {
            graph
                .receptacles
                .values()
                .flat_map(|state| state.content.keys().cloned())
                .collect()
        };
        let mut objects: BTreeSet<InstanceId> = task
            .objects
            .iter()
            .map(|object| object.instance.clone())
            .collect();
        objects.extend(
            of_graph(&task.initial)
                .into_iter()
                .chain(of_graph(&task.goal)),
        );
        for object in &objects {
            self.object(object.as_str());
        }
        for receptacle in &scene.receptacles {
            self.receptacle(receptacle.id.as_str());
        }
        let mut places: BTreeSet<&str> = BTreeSet::new();
        places.extend(
            task.initial
                .receptacles
                .keys()
                .chain(task.goal.receptacles.keys())
                .map(|id| id.as_str()),
        );
        places.extend([task.src.as_str(), task.dest.as_str(), FLOOR]);
        for place in places {
            self.receptacle(place);
        }
        self.floor = self.receptacle(FLOOR);
        let category = task
            .object(&task.target)
            .map(|target| target.category.to_lowercase())
            .unwrap_or_default();
        for object in task
            .objects
            .iter()
            .filter(|object| object.category.to_lowercase().contains(&category))
        {
            let key = self.object(object.instance.as_str());
            self.object_facts[key.0 as usize].like_target = !category.is_empty();
        }
    }

    fn set_goal(&mut self, task: &Task) {
        let events = task.goal_changes();
        for (index, event) in events.iter().enumerate() {
            let change = self.event(event);
            let earlier = events[..index]
                .iter()
                .filter(|other| *other == event)
                .count() as u32;
            self.goal.push(GoalChange {
                change,
                was: goal::count(&task.initial, event),
                earlier,
            });
            self.targets.push(Target::Goal(change));
            let (Change::Add { object, .. } | Change::Remove { object, .. }) = change else {
                continue;
            };
            let facts = &mut self.object_facts[object.0 as usize];
            facts.in_goal = true;
            facts.moves_away |= matches!(change, Change::Remove { .. });
            facts.has_destination |= matches!(change, Change::Add { .. });
        }
        let places = if task.src == task.dest {
            vec![&task.src]
        } else {
            vec![&task.src, &task.dest]
        };
        for place in &places {
            let place = self.receptacle(place.as_str());
            self.targets.push(Target::Visit(place));
        }
        for id in places {
            let place = self.receptacle(id.as_str());
            let opening = Change::Door {
                place,
                from: DoorState::Closed,
                to: DoorState::Open,
            };
            if task.initial.door(id) == Some(DoorState::Closed)
                && !self.goal.iter().any(|goal| goal.change == opening)
            {
                self.targets.push(Target::Opening(place));
            }
        }
    }

    /// Sets the graphs by kind, from objects with their receptacles.
    fn set_kinds(&mut self, initial: &[(String, String)], goal: &[(String, String)]) {
        let mut standing = |objects: &[(String, String)]| -> Vec<(ObjectKey, ReceptacleKey)> {
            objects
                .iter()
                .map(|(object, place)| (self.object(object), self.receptacle(place)))
                .collect()
        };
        let (initial, goal) = (standing(initial), standing(goal));
        for identity in [Identity::Asset, Identity::Category] {
            let kinds = |objects: &[(ObjectKey, ReceptacleKey)]| -> Vec<(KindKey, ReceptacleKey)> {
                objects
                    .iter()
                    .map(|(object, place)| (self.kind_of(identity, *object), *place))
                    .collect()
            };
            let (initial, goal) = (kinds(&initial), kinds(&goal));
            match identity {
                Identity::Asset => self.assets.set_graphs(&initial, &goal),
                Identity::Category => self.categories.set_graphs(&initial, &goal),
            }
        }
        self.initial_size.objects = initial.len();
        self.initial_size.unknown = initial
            .iter()
            .filter(|(object, _)| self.of(*object).is_unknown)
            .count();
    }

    fn set_start(&mut self, initial: &WorldGraph) {
        for (id, state) in &initial.receptacles {
            let place = self.receptacle(id.as_str());
            if self.initial_doors.len() <= place.0 as usize {
                self.initial_doors.resize(place.0 as usize + 1, None);
            }
            self.initial_doors[place.0 as usize] = state.door;
            for (instance, count) in &state.content {
                let object = self.object(instance.as_str());
                for _ in 0..*count {
                    self.initial.add(object.0, place);
                }
            }
        }
    }
}

/// The objects of a graph with their receptacles, each as often as it stands there.
fn contents(graph: &WorldGraph) -> Vec<(String, String)> {
    let of = |(receptacle, state): (&ReceptacleId, &ReceptacleState)| -> Vec<(String, String)> {
        let objects = state.content.iter();
        objects
            .flat_map(|(object, count)| {
                std::iter::repeat_n(
                    (object.to_string(), receptacle.to_string()),
                    *count as usize,
                )
            })
            .collect()
    };
    graph.receptacles.iter().flat_map(of).collect()
}

fn door(text: &str) -> Option<DoorState> {
    match text {
        "open" => Some(DoorState::Open),
        "closed" => Some(DoorState::Closed),
        _ => None,
    }
}
