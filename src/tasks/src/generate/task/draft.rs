//! A draft of a task: the choices made for a triplet, in words that were checked. Where its
//! objects stand comes later.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Stream, library::LibraryObject, wording::indefinite, yaml};
use reel_world::{
    AssetId, Family, InstanceId, ObjectInstance, PlanStep, ReceptacleId, Task, language,
};
use serde::Serialize;
use serde_json::json;

use super::{
    describe,
    ground::{SceneSites, Site},
    wording::InstructionWording,
};

/// What kind of task it is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskType {
    /// One object, like furniture elsewhere, nothing beside it.
    Basic,
    /// With distractors: copies of the target on like furniture, and in FODP objects
    /// like it beside it.
    Distractor,
    /// Articulation: into something with a door.
    Store,
    /// Articulation: out of something with a door.
    Retrieve,
    /// The instruction leaves open which object is meant; one has to ask.
    Interactive,
    /// Several objects to one place.
    Gather,
}

impl TaskType {
    /// All, in the order of the paper.
    pub const ALL: [TaskType; 6] = [
        TaskType::Basic,
        TaskType::Distractor,
        TaskType::Store,
        TaskType::Retrieve,
        TaskType::Interactive,
        TaskType::Gather,
    ];

    /// As it stands in files.
    pub fn as_str(self) -> &'static str {
        match self {
            TaskType::Basic => "basic",
            TaskType::Distractor => "distractor",
            TaskType::Store => "store",
            TaskType::Retrieve => "retrieve",
            TaskType::Interactive => "interactive",
            TaskType::Gather => "gather",
        }
    }

    /// Reads what [`TaskType::as_str`] wrote; `articulation` is both of its kinds.
    pub fn parse(text: &str) -> Vec<Self> {
        let is = |kind: &Self| {
            kind.as_str() == text || (text == "articulation" && kind.is_articulation())
        };
        Self::ALL.into_iter().filter(is).collect()
    }

    /// The types of a family, each as often as its share is.
    pub fn of_family(family: Family) -> &'static [TaskType] {
        match family {
            Family::FDP => &[TaskType::Basic, TaskType::Distractor, TaskType::Gather],
            Family::FODP => &[TaskType::Distractor, TaskType::Distractor, TaskType::Gather],
            // REAL-Bench has more to store, too.
            Family::FDO => &[TaskType::Store, TaskType::Store, TaskType::Retrieve],
            Family::SUL => &[TaskType::Interactive],
            Family::Other => &[],
        }
    }

    fn is_articulation(self) -> bool {
        matches!(self, TaskType::Store | TaskType::Retrieve)
    }
}

/// How hard the distractors of a task are, and so how many questions it is worth.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Difficulty {
    /// One distractor, the least like the target.
    Easy,
    /// Two distractors, drawn at random from the objects that qualify.
    Medium,
    /// Three, those most like the target first.
    Hard,
}

impl Difficulty {
    const ALL: [Difficulty; 3] = [Difficulty::Easy, Difficulty::Medium, Difficulty::Hard];

    /// As it stands in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Difficulty::Easy => "easy",
            Difficulty::Medium => "medium",
            Difficulty::Hard => "hard",
        }
    }

    fn count(self) -> usize {
        self as usize + 1
    }
}

/// Why nothing can be made of a triplet.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DraftError {
    /// Too few objects in the library are like the target.
    NoDistractor,
    /// Nothing else plausibly goes to the destination.
    NoCompanion,
    /// No description means the target alone.
    Ambiguous,
    /// The words happen to name furniture that has no part in it.
    SpeaksOfOthers,
    /// The fuzzy instruction means fewer than two objects.
    NotAmbiguous,
}

impl DraftError {
    /// The reason as a phrase for reports, e.g. `too few objects are like the target`.
    pub fn as_str(self) -> &'static str {
        match self {
            DraftError::NoDistractor => "too few objects are like the target",
            DraftError::NoCompanion => "nothing else belongs to the destination",
            DraftError::Ambiguous => "no description means the target alone",
            DraftError::SpeaksOfOthers => "the words happen to name other furniture",
            DraftError::NotAmbiguous => "the fuzzy instruction means fewer than two objects",
        }
    }
}

/// What is drawn from: the pairs of sites and what plausibly moves between them.
#[derive(Debug)]
pub(crate) struct Source<'a> {
    pub ground: &'a SceneSites,
    pub library: &'a [LibraryObject],
    pub triplets: Vec<(usize, usize, Vec<usize>)>,
}

/// The task to draft: family, type, sites (by index) and target object.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DraftSpec {
    pub family: Family,
    pub task_type: TaskType,
    pub src: usize,
    pub dest: usize,
    /// Index into the library.
    pub object: usize,
}

/// An object where it stands.
#[derive(Clone, Copy, Debug)]
struct Placed<'a> {
    object: &'a LibraryObject,
    site: usize,
}

/// The choices, before words.
struct Draft<'a> {
    source: &'a Source<'a>,
    wanted: DraftSpec,
    difficulty: Difficulty,
    /// What moves, the target first.
    moved: Vec<Placed<'a>>,
    /// Objects like the target, on its source.
    others: Vec<&'a LibraryObject>,
    /// Sites with a copy of the target.
    copies: Vec<usize>,
    /// The word of a fuzzy instruction.
    purpose: Option<&'a str>,
}

impl DraftSpec {
    /// Whether a pair of sites can have such tasks at all.
    pub fn admits(family: Family, task_type: TaskType, src: &Site, dest: &Site) -> bool {
        let doors = (src.receptacle.door.exists(), dest.receptacle.door.exists());
        let has_alike = match (family, task_type) {
            (Family::FDP, TaskType::Distractor) => !src.alike.is_empty(),
            (Family::FDP | Family::FODP, _) => !src.alike.is_empty() || !dest.alike.is_empty(),
            _ => true,
        };
        has_alike
            && match task_type {
                TaskType::Store => doors == (false, true),
                TaskType::Retrieve => doors == (true, false),
                _ => doors == (false, false),
            }
    }
}

/// Makes a task of a triplet; its objects have no positions yet.
pub(crate) fn draw(
    source: &Source<'_>,
    wanted: DraftSpec,
    name: &str,
    stream: &mut Stream,
) -> Result<Task, DraftError> {
    let difficulty = Difficulty::ALL[stream.below(3)];
    let target = Placed {
        object: &source.library[wanted.object],
        site: wanted.src,
    };
    let mut draft = Draft {
        source,
        wanted,
        difficulty,
        moved: vec![target],
        others: Vec::new(),
        copies: Vec::new(),
        purpose: None,
    };
    draft.draw_copies(stream);
    match (wanted.family, wanted.task_type) {
        (_, TaskType::Interactive) => draft.draw_candidates(stream)?,
        (Family::FODP, TaskType::Gather) => draft.draw_like_target(1, stream)?,
        (Family::FODP, _) => draft.draw_like_target(difficulty.count(), stream)?,
        _ => {}
    }
    if wanted.task_type == TaskType::Gather {
        draft.draw_companions(stream)?;
    }
    draft.task(name, stream)
}

impl<'a> Draft<'a> {
    fn target(&self) -> &'a LibraryObject {
        self.moved[0].object
    }

    fn site(&self, index: usize) -> &'a Site {
        &self.source.ground.sites[index]
    }

    /// Sites like one, other than source and destination.
    fn alike(&self, index: usize) -> Vec<usize> {
        let others = self.site(index).alike.iter().copied();
        others
            .filter(|other| ![self.wanted.src, self.wanted.dest].contains(other))
            .collect()
    }

    fn draw_copies(&mut self, stream: &mut Stream) {
        let most = match (self.wanted.family, self.wanted.task_type) {
            (Family::FDP, TaskType::Distractor) => self.difficulty.count(),
            (Family::FODP, TaskType::Distractor) | (Family::FDO, _) => self.difficulty.count() - 1,
            _ => 0,
        };
        self.copies = stream.pick_some(&self.alike(self.wanted.src), most);
    }

    /// Objects of the target's category: for easy tasks the least like it, for hard ones the most.
    fn draw_like_target(&mut self, count: usize, stream: &mut Stream) -> Result<(), DraftError> {
        let target = self.target();
        let alike = |other: &&LibraryObject| {
            other.category == target.category && other.asset != target.asset
        };
        let mut pool: Vec<&LibraryObject> = self.source.library.iter().filter(alike).collect();
        pool = stream.pick_some(&pool, pool.len());
        pool.sort_by(|a, b| likeness(target, a).total_cmp(&likeness(target, b)));
        match self.difficulty {
            Difficulty::Easy => {}
            Difficulty::Medium => pool = stream.pick_some(&pool, pool.len()),
            Difficulty::Hard => pool.reverse(),
        }
        self.others = pool.into_iter().take(count).collect();
        if self.others.is_empty() {
            Err(DraftError::NoDistractor)
        } else {
            Ok(())
        }
    }

    /// What else a fuzzy instruction may mean: things for the same purpose, or (a third of the
    /// tasks) of the same category.
    fn draw_candidates(&mut self, stream: &mut Stream) -> Result<(), DraftError> {
        let target = self.target();
        if stream.below(3) == 0 {
            self.purpose = Some(&target.category);
            return self.draw_like_target(self.difficulty.count(), stream);
        }
        self.purpose = Some(&target.purpose);
        let hard = self.difficulty == Difficulty::Hard;
        let serves = |other: &&LibraryObject| {
            other.purpose == target.purpose
                && other.asset != target.asset
                && (hard || other.category != target.category)
        };
        let pool: Vec<&LibraryObject> = self.source.library.iter().filter(serves).collect();
        self.others = stream.pick_some(&pool, self.difficulty.count());
        if self.others.is_empty() {
            Err(DraftError::NoDistractor)
        } else {
            Ok(())
        }
    }

    /// One or two more objects for the destination: from the source where it is easy, else
    /// also from somewhere else.
    fn draw_companions(&mut self, stream: &mut Stream) -> Result<(), DraftError> {
        let count = if self.difficulty == Difficulty::Hard {
            2
        } else {
            1
        };
        let easy = self.difficulty == Difficulty::Easy;
        for _ in 0..count {
            let is_source = |(src, dest, _): &&(usize, usize, Vec<usize>)| {
                let wanted = if easy {
                    *src == self.wanted.src
                } else {
                    !self.site(*src).receptacle.door.exists()
                };
                wanted && *dest == self.wanted.dest
            };
            let sources: Vec<_> = self.source.triplets.iter().filter(is_source).collect();
            let (site, _, objects) = stream.pick(&sources).ok_or(DraftError::NoCompanion)?;
            let object = |index: &usize| &self.source.library[*index];
            let is_other = |other: &&LibraryObject| {
                !self
                    .moved
                    .iter()
                    .any(|moved| moved.object.category == other.category)
            };
            let objects: Vec<&LibraryObject> =
                objects.iter().map(object).filter(is_other).collect();
            let object = stream
                .pick(&objects)
                .copied()
                .ok_or(DraftError::NoCompanion)?;
            self.moved.push(Placed {
                object,
                site: *site,
            });
        }
        Ok(())
    }

    fn task(&self, name: &str, stream: &mut Stream) -> Result<Task, DraftError> {
        let DraftSpec {
            family, src, dest, ..
        } = self.wanted;
        let scene = &self.source.ground.scene;
        let id = |site: usize| self.site(site).receptacle.id.clone();
        let instance =
            |placed: &Placed<'_>| InstanceId::new(&placed.object.asset, &id(placed.site), name);
        let others = self
            .others
            .iter()
            .map(|object| Placed { object, site: src });
        let copies = self.copies.iter().map(|site| Placed {
            object: self.target(),
            site: *site,
        });
        let placed: Vec<Placed<'_>> = self
            .moved
            .iter()
            .copied()
            .chain(others)
            .chain(copies)
            .collect();
        let mut objects: Vec<ObjectInstance> = placed
            .iter()
            .map(|placed| placed.object.instance_at(&id(placed.site), name, [0.0; 3]))
            .collect();
        let (precise, instruction) = self.instructions(&objects, stream)?;
        if self.speaks_of_others(&precise) || self.speaks_of_others(&instruction) {
            return Err(DraftError::SpeaksOfOthers);
        }
        objects.sort_by(|a, b| a.instance.cmp(&b.instance));

        let initial = Task::initial_graph(scene, &objects);
        let mut goal = initial.clone();
        for moved in &self.moved {
            goal.remove(&id(moved.site), &instance(moved));
            goal.add(&id(dest), &instance(moved));
        }
        let assets: BTreeSet<AssetId> = self
            .others
            .iter()
            .map(|other| other.asset.clone())
            .collect();
        let ids = |sites: Vec<usize>| sites.into_iter().map(id).collect::<Vec<ReceptacleId>>();
        let mut task = Task {
            placement_order: Vec::new(),
            task_id: format!("{family}/{name}"),
            family,
            task_type: Some(self.wanted.task_type.as_str().to_owned()),
            scene_id: scene.scene_id.clone(),
            fuzzy: self.purpose.is_some(),
            purpose: self.purpose.map(str::to_owned),
            precise_instruction: precise,
            instruction,
            objects,
            initial,
            goal,
            target: instance(&self.moved[0]),
            src: id(src),
            dest: id(dest),
            src_distractors: ids(self.alike(src)),
            dest_distractors: ids(self.alike(dest)),
            object_distractors: assets.into_iter().collect(),
            plan: self.plan(name, stream),
            published_goal: None,
            extra: BTreeMap::new(),
        };
        task.published_goal = Some(yaml::graph(&task, &task.goal, scene));
        self.grade(&mut task);
        Ok(task)
    }

    /// The precise instruction, which means what moves and nothing else, and the one that is told.
    fn instructions(
        &self,
        objects: &[ObjectInstance],
        stream: &mut Stream,
    ) -> Result<(String, String), DraftError> {
        let caption = |site: usize, stream: &mut Stream| -> &'a str {
            stream
                .pick(&self.site(site).captions)
                .expect("sites have captions")
        };
        let dest = caption(self.wanted.dest, stream);
        let into = self.site(self.wanted.dest).receptacle.door.exists();
        let mut sources: BTreeMap<usize, &str> = BTreeMap::new();
        let mut phrases: Vec<(String, &str)> = Vec::new();
        for (moved, instance) in self.moved.iter().zip(objects) {
            let src = *sources
                .entry(moved.site)
                .or_insert_with(|| caption(moved.site, stream));
            let beside = objects.iter().filter(|other| {
                other.receptacle == instance.receptacle && other.asset != instance.asset
            });
            let beside: Vec<&ObjectInstance> = beside.collect();
            let phrase = self
                .phrase(moved.object, instance, &beside, stream)
                .ok_or(DraftError::Ambiguous)?;
            phrases.push((phrase, src));
        }
        let fuzzy = self.purpose.is_some();
        if phrases.len() > 1 {
            let precise = InstructionWording::gathering(stream).say_all(&phrases, dest, into);
            return Ok((precise.clone(), precise));
        }
        let wording = InstructionWording::moving(fuzzy, stream);
        let (phrase, src) = &phrases[0];
        let precise = wording.say(phrase, src, dest, into);
        let beside = || {
            objects
                .iter()
                .filter(|object| object.receptacle == objects[0].receptacle)
        };
        if beside().any(|object| {
            language::fits(&precise, object, None) != (object.instance == objects[0].instance)
        }) {
            return Err(DraftError::Ambiguous);
        }
        let Some(purpose) = self.purpose else {
            return Ok((precise.clone(), precise));
        };
        // In half of the hard tasks like receptacles are not told apart either.
        let dest_site = self.site(self.wanted.dest);
        let vague = self.difficulty == Difficulty::Hard
            && !self.alike(self.wanted.dest).is_empty()
            && stream.below(2) == 0;
        let vaguely = indefinite(&dest_site.receptacle.category);
        let told = wording.say(
            &indefinite(purpose),
            src,
            if vague { &vaguely } else { dest },
            into,
        );
        let meant = beside()
            .filter(|object| language::fits(&told, object, Some(purpose)))
            .count();
        if meant < 2 {
            Err(DraftError::NotAmbiguous)
        } else {
            Ok((precise, told))
        }
    }

    /// Whether a text says, even by chance (`the brown desk clock`), what a receptacle is called
    /// that has no part in the task.
    fn speaks_of_others(&self, text: &str) -> bool {
        let sites = || self.source.ground.sites.iter().enumerate();
        let is_ours = |index: usize| {
            index == self.wanted.dest || self.moved.iter().any(|moved| moved.site == index)
        };
        let ours: Vec<&String> = sites()
            .filter(|(index, _)| is_ours(*index))
            .flat_map(|(_, site)| &site.captions)
            .collect();
        let foreign = |caption: &String| !ours.iter().any(|own| language::quotes(own, caption));
        let mut others = sites()
            .filter(|(index, _)| !is_ours(*index))
            .flat_map(|(_, site)| site.receptacle.captions.keys());
        others.any(|caption| foreign(caption) && language::quotes(text, caption))
    }

    /// A description that means an object and nothing beside it: mostly the full one; in FDO,
    /// as published, the category.
    fn phrase(
        &self,
        object: &LibraryObject,
        instance: &ObjectInstance,
        beside: &[&ObjectInstance],
        stream: &mut Stream,
    ) -> Option<String> {
        let mut phrases = describe::object(&object.category, &object.caption, &object.attributes);
        if self.wanted.family == Family::FDO {
            phrases.insert(0, indefinite(&object.category));
        } else if stream.below(3) == 0 {
            let [_, short @ ..] = phrases.as_mut_slice() else {
                return None;
            };
            let shuffled = stream.pick_some(short, short.len());
            phrases.splice(0..0, shuffled);
        }
        let means = |phrase: &str, other: &ObjectInstance| {
            language::fits(&format!("Take {phrase}."), other, None)
        };
        let is_unique = |phrase: &String| {
            means(phrase, instance)
                && !beside
                    .iter()
                    .any(|other| means(phrase, other) || describe::may_mean(phrase, other))
        };
        phrases.into_iter().find(is_unique)
    }

    /// The plan in the words of the published ones: some receptacles alike are visited first.
    fn plan(&self, name: &str, stream: &mut Stream) -> Vec<PlanStep> {
        let at = |action: &str, site: usize| {
            PlanStep::new(
                action,
                &[("receptacle_name", self.site(site).receptacle.id.as_str())],
            )
        };
        let about = |action: &str, placed: &Placed<'_>| {
            let object = placed.object;
            let mut args = vec![("target_category", object.category.as_str())];
            if self.wanted.family != Family::FDO {
                args.push(("target_description", &object.caption));
            }
            // What a published plan has no need to say: which of several objects that move.
            let instance =
                InstanceId::new(&object.asset, &self.site(placed.site).receptacle.id, name);
            if self.moved.len() > 1 {
                args.push(("instance", instance.as_str()));
            }
            PlanStep::new(action, &args)
        };
        let DraftSpec { src, dest, .. } = self.wanted;
        let mut detour = |index: usize| -> Vec<PlanStep> {
            let most = if self.moved.len() > 1 {
                0
            } else {
                stream.below(3)
            };
            stream
                .pick_some(&self.alike(index), most)
                .into_iter()
                .map(|site| at("nav_to", site))
                .collect()
        };
        let has_door = |site: usize| self.site(site).receptacle.door.exists();
        let mut plan = Vec::new();
        if has_door(dest) {
            plan.extend([at("nav_to", dest), at("open", dest)]);
        }
        for moved in &self.moved {
            plan.extend(detour(src));
            plan.push(at("nav_to", moved.site));
            if has_door(moved.site) {
                plan.push(at("open", moved.site));
            }
            plan.extend(["find", "gaze_at", "pick"].map(|action| about(action, moved)));
            if !has_door(dest) {
                plan.extend(detour(dest));
            }
            plan.extend([at("nav_to", dest), at("place", dest)]);
        }
        if has_door(dest) {
            plan.push(at("close", dest));
        }
        if has_door(src) {
            plan.extend([at("nav_to", src), at("close", src)]);
        }
        plan
    }

    /// Writes down how hard the task is: its level, the grade of each distractor (1 to 3) and what
    /// asking can be worth (docs/spec.md#reward-preset-paper, `B_ask`).
    fn grade(&self, task: &mut Task) {
        let target = self.target();
        let mut grades: BTreeMap<String, usize> = BTreeMap::new();
        for other in &self.others {
            grades.insert(other.asset.to_string(), object_grade(target, other));
        }
        for (place, of) in [
            (self.wanted.src, &task.src_distractors),
            (self.wanted.dest, &task.dest_distractors),
        ] {
            let room = &self.site(place).receptacle.room;
            for site in self.alike(place) {
                let receptacle = &self.site(site).receptacle;
                assert!(
                    of.contains(&receptacle.id),
                    "distractors are the sites alike"
                );
                let copied = place == self.wanted.src && self.copies.contains(&site);
                grades.insert(
                    receptacle.id.to_string(),
                    if copied {
                        3
                    } else {
                        1 + usize::from(receptacle.room == *room)
                    },
                );
            }
        }
        let serves = |other: &&&LibraryObject| {
            other.category == target.category
                || self.purpose.is_some_and(|purpose| purpose == other.purpose)
        };
        let fitting: BTreeSet<&AssetId> = self
            .others
            .iter()
            .filter(serves)
            .map(|other| &other.asset)
            .collect();
        let dest = &self.site(self.wanted.dest).captions;
        let vague = task.fuzzy
            && !dest
                .iter()
                .any(|caption| language::quotes(&task.instruction, caption));
        let asks = if task.fuzzy || !self.others.is_empty() {
            (fitting.len() + usize::from(vague)).min(3)
        } else {
            0
        };
        let fields = [
            ("difficulty", json!(self.difficulty)),
            ("ask_budget", json!(asks)),
            ("distractor_grades", json!(grades)),
        ];
        task.extra
            .extend(fields.map(|(key, value)| (format!("episodes[0].{key}"), value)));
    }
}

/// How much an object distracts: 1 for the same purpose, 2 for the same category, 3 if
/// it looks alike, too.
fn object_grade(target: &LibraryObject, other: &LibraryObject) -> usize {
    match (
        target.category == other.category,
        likeness(target, other) >= 1.0 / 3.0,
    ) {
        (false, _) => 1,
        (true, false) => 2,
        (true, true) => 3,
    }
}

/// Share of the attribute words of two objects that both have.
fn likeness(a: &LibraryObject, b: &LibraryObject) -> f64 {
    let words = |object: &LibraryObject| -> BTreeSet<(String, String)> {
        let kinds = object.attributes.iter();
        kinds
            .flat_map(|(kind, words)| words.iter().map(|word| (kind.clone(), word.clone())))
            .collect()
    };
    let (a, b) = (words(a), words(b));
    let all = a.union(&b).count();
    if all == 0 {
        1.0
    } else {
        a.intersection(&b).count() as f64 / all as f64
    }
}
