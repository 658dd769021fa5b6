//! Tasks of the four families, made for any scene with captions from the object library.
//!
//! Deterministic: the same options give the same tasks, and more tasks begin with the fewer. Checks
//! only the geometry of placements; whether physics keeps them is not tried here.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::{
    AssetId, Family, InstanceId, ObjectInstance, PlanStep, Receptacle, ReceptacleId, Scene, Task,
};

use crate::{
    generate::task::wording::InstructionWording,
    library::{self, LibraryObject},
    placement::{self, Occupancy, PlacementError},
    random::Stream,
    wording::{definite, indefinite},
    yaml,
};

/// Most draws for one task.
const MOST_DRAWS: usize = 200;
/// Most receptacles like the source that hold a copy of the target.
const MOST_COPIES: usize = 3;

/// Options of the generator: scene, families, number of tasks and seed.
#[derive(Clone, Copy, Debug)]
pub struct DrawOptions<'a> {
    /// The scene. Its receptacles need captions.
    pub scene: &'a Scene,
    /// The families, taken in turn.
    pub families: &'a [Family],
    /// Number of tasks to generate, over all families.
    pub count: usize,
    /// Seed of all choices.
    pub seed: u64,
}

/// What came of it.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct DrawnTasks {
    /// The tasks; fewer than asked for where the scene does not allow a family.
    pub tasks: Vec<Task>,
    /// How many drafts were thrown away, by reason.
    pub rejected: BTreeMap<String, usize>,
}

/// Generates tasks. Task ids are `<family>/<scene>_<number>`.
pub fn draw(options: &DrawOptions<'_>) -> DrawnTasks {
    let mut generated = DrawnTasks::default();
    let mut seen = BTreeSet::new();
    let mut numbers: BTreeMap<Family, usize> = BTreeMap::new();
    let usable = usable_receptacles(options.scene);
    for family in options
        .families
        .iter()
        .cycle()
        .take(if options.families.is_empty() {
            0
        } else {
            options.count
        })
    {
        let number = numbers
            .entry(*family)
            .and_modify(|number| *number += 1)
            .or_insert(1);
        let name = format!("{}_{number:04}", options.scene.scene_id);
        let mut stream = Stream::new(options.seed, family.as_str(), *number);
        for _ in 0..MOST_DRAWS {
            let draft = Draft::draw(*family, &usable, &mut stream).and_then(|draft| {
                let key = (
                    *family,
                    draft.src.id.clone(),
                    draft.dest.id.clone(),
                    draft.target.asset.clone(),
                );
                if seen.contains(&key) {
                    return Err("the same target, source and destination as an earlier task");
                }
                let task = draft.task(options.scene, &name, &mut stream)?;
                seen.insert(key);
                Ok(task)
            });
            match draft {
                Ok(task) => {
                    generated.tasks.push(task);
                    break;
                }
                Err(reason) => *generated.rejected.entry(reason.to_owned()).or_default() += 1,
            }
        }
    }
    generated
}

/// Receptacles a task may use, each with its captions that no other receptacle of the scene has.
fn usable_receptacles(scene: &Scene) -> Vec<(&Receptacle, Vec<&str>)> {
    let owners = |caption: &str| {
        scene
            .receptacles
            .iter()
            .filter(|receptacle| {
                receptacle
                    .captions
                    .keys()
                    .any(|other| other.eq_ignore_ascii_case(caption))
            })
            .count()
    };
    let unique = |receptacle: &'_ Receptacle| -> Vec<usize> {
        let captions = receptacle.captions.keys().enumerate();
        captions
            .filter(|(_, caption)| owners(caption) == 1)
            .map(|(index, _)| index)
            .collect()
    };
    let open = scene
        .receptacles
        .iter()
        .filter(|receptacle| scene.is_usable(receptacle));
    open.map(|receptacle| {
        let wanted = unique(receptacle);
        let captions = receptacle
            .captions
            .keys()
            .enumerate()
            .filter(|(index, _)| wanted.contains(index));
        (
            receptacle,
            captions
                .map(|(_, caption)| caption.as_str())
                .collect::<Vec<_>>(),
        )
    })
    .filter(|(_, captions)| !captions.is_empty())
    .collect()
}

/// The choices of a task before its objects are placed.
struct Draft<'a> {
    family: Family,
    src: &'a Receptacle,
    dest: &'a Receptacle,
    src_caption: &'a str,
    dest_caption: &'a str,
    src_distractors: Vec<ReceptacleId>,
    dest_distractors: Vec<ReceptacleId>,
    target: &'a LibraryObject,
    /// Where copies of the target stand.
    copies: Vec<ReceptacleId>,
    /// What else stands on the source.
    others: Vec<&'a LibraryObject>,
}

impl<'a> Draft<'a> {
    fn draw(
        family: Family,
        usable: &[(&'a Receptacle, Vec<&'a str>)],
        stream: &mut Stream,
    ) -> Result<Self, &'static str> {
        let stores = family == Family::FDO && stream.below(5) > 0;
        let retrieves = family == Family::FDO && !stores;
        let with_door = |door: bool| {
            usable
                .iter()
                .filter(|(receptacle, _)| receptacle.door.exists() == door)
                .collect::<Vec<_>>()
        };
        let (src, src_captions) = stream
            .pick(&with_door(retrieves))
            .ok_or("the scene has no receptacle for the source")?;
        let (dest, dest_captions) = stream
            .pick(&with_door(stores))
            .ok_or("the scene has no receptacle for the destination")?;
        if src.id == dest.id {
            return Err("the source is the destination");
        }
        let like = |one: &Receptacle| -> Vec<ReceptacleId> {
            let same = usable
                .iter()
                .map(|(other, _)| other)
                .filter(|other| other.category == one.category);
            same.filter(|other| ![&src.id, &dest.id].contains(&&other.id))
                .map(|other| other.id.clone())
                .collect()
        };
        let (src_distractors, dest_distractors) = (like(src), like(dest));
        let needs_like_src = matches!(family, Family::FDP | Family::FODP) || stores;
        if (needs_like_src && src_distractors.is_empty())
            || (retrieves && dest_distractors.is_empty())
        {
            return Err("no receptacle is like the one that must have its like");
        }

        let target = stream
            .pick(library::small_library())
            .expect("the library is not empty");
        if !placement::fits(dest, target.size) {
            return Err("too large for the destination");
        }
        let candidates: Vec<&LibraryObject> = library::small_library()
            .iter()
            .filter(|other| confuses(family, target, other))
            .collect();
        let most_others = 1 + stream.below(2);
        let others = stream.pick_some(&candidates, most_others);
        let copies = if family == Family::SUL {
            Vec::new()
        } else {
            stream.pick_some(&src_distractors, MOST_COPIES)
        };
        let (src_caption, dest_caption) = (stream.pick(src_captions), stream.pick(dest_captions));
        let (src_caption, dest_caption) = (
            src_caption.expect("usable: captioned"),
            dest_caption.expect("usable: captioned"),
        );
        Ok(Self {
            family,
            src,
            dest,
            src_caption,
            dest_caption,
            src_distractors,
            dest_distractors,
            target,
            copies,
            others,
        })
    }

    fn task(&self, scene: &Scene, name: &str, stream: &mut Stream) -> Result<Task, &'static str> {
        let mut objects = self.objects(scene, name, stream)?;
        let target = InstanceId::new(&self.target.asset, &self.src.id, name);
        objects.sort_by(|a, b| a.instance.cmp(&b.instance));

        let wording = InstructionWording::published(stream);
        let into = self.dest.door.exists();
        let word = |object: &str| wording.say(object, self.src_caption, self.dest_caption, into);
        let precise = match self.family {
            Family::FDO => word(&indefinite(&self.target.category)),
            _ => word(&definite(&self.target.caption)),
        };
        let fuzzy = self.family == Family::SUL;
        let instruction = if fuzzy {
            word(&indefinite(&self.target.purpose))
        } else {
            precise.clone()
        };

        let initial = Task::initial_graph(scene, &objects);
        let mut goal = initial.clone();
        goal.remove(&self.src.id, &target);
        goal.add(&self.dest.id, &target);
        let mut object_distractors: Vec<AssetId> = self
            .others
            .iter()
            .map(|other| other.asset.clone())
            .collect();
        object_distractors.sort();
        let mut task = Task {
            placement_order: Vec::new(),
            task_id: format!("{}/{name}", self.family),
            family: self.family,
            task_type: self.task_type().map(str::to_owned),
            scene_id: scene.scene_id.clone(),
            instruction,
            precise_instruction: precise,
            fuzzy,
            purpose: fuzzy.then(|| self.target.purpose.clone()),
            objects,
            initial,
            goal,
            target,
            src: self.src.id.clone(),
            dest: self.dest.id.clone(),
            src_distractors: self.src_distractors.clone(),
            dest_distractors: self.dest_distractors.clone(),
            object_distractors,
            plan: self.plan(stream),
            published_goal: None,
            extra: BTreeMap::new(),
        };
        task.published_goal = Some(yaml::graph(&task, &task.goal, scene));
        Ok(task)
    }

    fn objects(
        &self,
        scene: &Scene,
        name: &str,
        stream: &mut Stream,
    ) -> Result<Vec<ObjectInstance>, &'static str> {
        let mut occupancy = Occupancy::default();
        let mut put = |object: &LibraryObject, place: &ReceptacleId| {
            let receptacle = scene
                .receptacle(place)
                .expect("distractors are receptacles of the scene");
            let position = occupancy
                .place(receptacle, object.size, stream)
                .map_err(|misfit| match misfit {
                    PlacementError::TooLarge => "too large for its receptacle",
                    PlacementError::TriesExceeded => "no free place on its receptacle",
                })?;
            Ok(object.instance_at(place, name, position))
        };
        let on_src = [self.target]
            .into_iter()
            .chain(self.others.iter().copied())
            .map(|object| (object, &self.src.id));
        let copies = self.copies.iter().map(|place| (self.target, place));
        on_src
            .chain(copies)
            .map(|(object, place)| put(object, place))
            .collect()
    }

    fn task_type(&self) -> Option<&'static str> {
        match (self.src.door.exists(), self.dest.door.exists()) {
            (_, true) => Some("store"),
            (true, false) => Some("retrieve"),
            (false, false) => None,
        }
    }

    /// The plan in the words of the published ones: some receptacles alike are visited first.
    fn plan(&self, stream: &mut Stream) -> Vec<PlanStep> {
        let at = |action: &str, place: &ReceptacleId| {
            PlanStep::new(action, &[("receptacle_name", place.as_str())])
        };
        let about = |action: &str| match self.family {
            Family::FDO => PlanStep::new(action, &[("target_category", &self.target.category)]),
            _ => PlanStep::new(
                action,
                &[
                    ("target_category", &self.target.category),
                    ("target_description", &self.target.caption),
                ],
            ),
        };
        let mut detour = |alike: &[ReceptacleId]| -> Vec<PlanStep> {
            let most = stream.below(3);
            stream
                .pick_some(alike, most)
                .iter()
                .map(|place| at("nav_to", place))
                .collect()
        };
        let (src, dest) = (&self.src.id, &self.dest.id);
        let (opens_src, opens_dest) = (self.src.door.exists(), self.dest.door.exists());
        let mut plan = Vec::new();
        if opens_dest {
            plan.extend([at("nav_to", dest), at("open", dest)]);
        }
        plan.extend(detour(&self.src_distractors));
        plan.push(at("nav_to", src));
        if opens_src {
            plan.push(at("open", src));
        }
        plan.extend(["find", "gaze_at", "pick"].map(about));
        if !opens_dest {
            plan.extend(detour(&self.dest_distractors));
        }
        plan.extend([at("nav_to", dest), at("place", dest)]);
        if opens_dest {
            plan.push(at("close", dest));
        }
        if opens_src {
            plan.extend([at("nav_to", src), at("close", src)]);
        }
        plan
    }
}

/// Whether an object beside the target makes the family's task harder.
fn confuses(family: Family, target: &LibraryObject, other: &LibraryObject) -> bool {
    match family {
        Family::FDP | Family::FDO | Family::Other => false,
        Family::FODP => other.category == target.category && other.asset != target.asset,
        Family::SUL => other.purpose == target.purpose && other.category != target.category,
    }
}
