//! The YAML schema of REAL-Bench (docs/spec.md#real-bench) read into a [`Task`].
//!
//! Takes the published deviations without complaint and lists them. Fields it does not use are kept
//! in [`Task::extra`] under their path in the document, e.g. `episodes[0].global_index`.

use std::collections::BTreeMap;

use reel_world::{
    Attributes, DoorState, Family, InstanceId, ObjectInstance, PlanStep, ReceptacleId, Scene, Task,
    WorldGraph,
};
use serde_json::Value;

use crate::{TaskWarning, TaskWarningKind, attributes, error::Problem, field::Field};

/// An object at most this thick is a deviation, in metres.
const THIN_M: f64 = 0.0015;
/// The published physics check drops objects from this high, in metres.
pub(crate) const DROP_M: f64 = 0.1;
/// No household object is larger, in metres.
const LARGEST_M: f64 = 5.0;

const ROOT_FIELDS: &[&str] = &["scene_id", "objects", "episodes"];
const OBJECT_FIELDS: &[&str] = &reel_world::words! {
    original_id category detailed_caption attributes position size yaw
};
const EPISODE_FIELDS: &[&str] = &reel_world::words! {
    benchmark_task_id task_id family task_type scene_id benchmark_instruction task_description
    fuzzy_task_description physics_task_description purpose initial_world_graph goal_world_graph src
    src_distractors dest dest_distractors moves obj_distractors obj_meta obj_distractor_meta
    execution_plan placements final_positions target_object_id
};

/// Reads the task of a document.
pub(crate) fn read(root: &Field<'_>, scene: &Scene) -> Result<(Task, Vec<TaskWarning>), Problem> {
    let episodes = root.get("episodes")?;
    let items = episodes.items()?;
    let [episode] = items.as_slice() else {
        return Err(episodes.problem(format!("expected 1 episode, found {}", items.len())));
    };
    let mut reader = Reader {
        root,
        episode,
        scene,
        extra: BTreeMap::new(),
        deviations: Vec::new(),
    };
    let task = reader.task()?;
    let of_task = |(kind, detail)| TaskWarning {
        task_id: task.task_id.clone(),
        kind,
        detail,
    };
    let deviations = reader.deviations.into_iter().map(of_task).collect();
    Ok((task, deviations))
}

struct Reader<'a> {
    root: &'a Field<'a>,
    episode: &'a Field<'a>,
    scene: &'a Scene,
    extra: BTreeMap<String, Value>,
    deviations: Vec<(TaskWarningKind, String)>,
}

impl<'a> Reader<'a> {
    fn task(&mut self) -> Result<Task, Problem> {
        let episode = self.episode;
        let (task_id, family) = self.identity()?;
        let scene_id = self.scene_id()?;
        let (instruction, precise_instruction) = self.instructions()?;
        // Published files of other families have no fuzzy instruction; tasks
        // that were annotated have.
        let told_less =
            episode.find("fuzzy_task_description")?.is_some() && instruction != precise_instruction;
        let src = episode.get("src")?.receptacle(self.scene)?;
        let dest_field = episode.get("dest")?;
        let dest = dest_field.receptacle(self.scene)?;
        if src == dest {
            return Err(dest_field.problem(format!("is {dest}, where the target stands already")));
        }
        let src_distractors = self.episode.receptacles("src_distractors", self.scene)?;
        let dest_distractors = self.episode.receptacles("dest_distractors", self.scene)?;
        let object_distractors = match episode.find("obj_distractors")? {
            Some(list) => list
                .items()?
                .iter()
                .map(|item| Ok(item.text()?.into()))
                .collect::<Result<_, Problem>>()?,
            None => Vec::new(),
        };

        let objects = self.objects()?;
        let placement_order = self.placement_order(&objects)?;
        let initial = self.initial_graph(&objects)?;
        let target_field = episode.get("target_object_id")?;
        let target = self.target(&target_field, &objects, &src)?;
        let goal = self.goal(&initial, (&target, &src, &dest))?;

        self.metas(&objects)?;
        self.goal_deviations(&objects)?;
        self.place_deviations(&objects, &dest, &src_distractors);
        self.keep_unknown(self.root, ROOT_FIELDS)?;
        self.keep_unknown(episode, EPISODE_FIELDS)?;
        Ok(Task {
            task_id,
            family,
            task_type: text_of(episode, "task_type")?,
            scene_id,
            instruction,
            precise_instruction,
            fuzzy: family == Family::SUL || told_less,
            purpose: text_of(episode, "purpose")?,
            objects,
            placement_order,
            initial,
            goal,
            target,
            src,
            dest,
            src_distractors,
            dest_distractors,
            object_distractors,
            plan: self.plan()?,
            published_goal: episode.find("goal_world_graph")?.map(|graph| graph.json()),
            extra: std::mem::take(&mut self.extra),
        })
    }

    fn identity(&mut self) -> Result<(String, Family), Problem> {
        let family_field = self.episode.get("family")?;
        let unknown = || family_field.problem("expected FDP, FODP, FDO or SUL");
        let family = Family::parse(family_field.text()?).ok_or_else(unknown)?;
        let short = text_of(self.episode, "task_id")?;
        let task_id = match (text_of(self.episode, "benchmark_task_id")?, &short) {
            (Some(task_id), _) => task_id,
            (None, Some(short)) => format!("{family}/{short}"),
            (None, None) => return Err(self.episode.missing("benchmark_task_id")),
        };
        self.keep_unless("task_id", |value| {
            task_id.rsplit('/').next() == value.as_str()
        })?;
        Ok((task_id, family))
    }

    fn scene_id(&mut self) -> Result<String, Problem> {
        let field = self.root.get("scene_id")?;
        let scene_id = field.text()?;
        if scene_id != self.scene.scene_id {
            return Err(field.problem(format!(
                "is {scene_id}, but the scene given is {}",
                self.scene.scene_id
            )));
        }
        self.keep_unless("scene_id", |value| value == scene_id)?;
        Ok(scene_id.to_owned())
    }

    fn instructions(&mut self) -> Result<(String, String), Problem> {
        let text = |key| text_of(self.episode, key);
        let (told, fuzzy) = (
            text("benchmark_instruction")?,
            text("fuzzy_task_description")?,
        );
        let (physics, plain) = (text("physics_task_description")?, text("task_description")?);
        let Some(instruction) = told.or(fuzzy).or(plain.clone()) else {
            return Err(self.episode.missing("task_description"));
        };
        let precise = physics.or(plain).unwrap_or_else(|| instruction.clone());
        for key in ["fuzzy_task_description", "task_description"] {
            self.keep_unless(key, |value| *value == instruction || *value == precise)?;
        }
        Ok((instruction, precise))
    }

    /// Objects where `placements` puts them, sorted by instance.
    fn objects(&mut self) -> Result<Vec<ObjectInstance>, Problem> {
        let placements = self.episode.get("placements")?;
        let rests = self.episode.find("final_positions")?;
        let listed = self.root.get("objects")?;
        let mut objects = Vec::new();
        for (key, field) in listed.entries()? {
            let Some(placement) = placements.find(key)? else {
                self.odd(
                    TaskWarningKind::ObjectsAndPlacementsDiffer,
                    format!("{key} has no placement and is left out"),
                );
                self.extra.insert(field.path().to_owned(), field.json());
                continue;
            };
            let rest = rests
                .as_ref()
                .map(|rests| rests.find(key))
                .transpose()?
                .flatten();
            if rests.is_some() && rest.is_none() {
                self.odd(
                    TaskWarningKind::ObjectsAndPlacementsDiffer,
                    format!("{key} has no final position"),
                );
            }
            let object = self.object(key, &field, &placement, rest.as_ref())?;
            objects.push(object);
            self.keep_unknown(&field, OBJECT_FIELDS)?;
            self.keep_unknown(&placement, &["position", "furniture", "original_id"])?;
        }
        for (name, section) in [("placements", Some(placements)), ("final_positions", rests)] {
            for (key, field) in section.map_or(Ok(Vec::new()), |section| section.entries())? {
                if listed.find(key)?.is_none() {
                    self.odd(
                        TaskWarningKind::ObjectsAndPlacementsDiffer,
                        format!("{key} of {name} is not among the objects"),
                    );
                    self.extra.insert(field.path().to_owned(), field.json());
                }
            }
        }
        if objects.is_empty() {
            return Err(listed.problem("no object with a placement"));
        }
        Ok(objects)
    }

    /// The objects in the order of `placements`; empty if that is the order of `objects`.
    fn placement_order(&self, objects: &[ObjectInstance]) -> Result<Vec<InstanceId>, Problem> {
        let placements = self.episode.get("placements")?.entries_as_written()?;
        let placed = placements.into_iter().map(|(key, _)| InstanceId::from(key));
        let order: Vec<InstanceId> = placed
            .filter(|key| objects.iter().any(|object| object.instance == *key))
            .collect();
        let is_sorted = order
            .iter()
            .eq(objects.iter().map(|object| &object.instance));
        Ok(if is_sorted { Vec::new() } else { order })
    }

    fn object(
        &mut self,
        key: &str,
        field: &Field<'_>,
        placement: &Field<'_>,
        rest: Option<&Field<'_>>,
    ) -> Result<ObjectInstance, Problem> {
        let asset = field.get("original_id")?.text()?;
        let category = field.get("category")?.text()?.to_owned();
        let receptacle = placement.get("furniture")?.receptacle(self.scene)?;
        let size_field = field.get("size")?;
        let size = size_field.vector()?;
        if size
            .iter()
            .any(|length| *length <= 0.0 || *length > LARGEST_M)
        {
            return Err(size_field.problem(format!(
                "expected lengths above 0 and at most {LARGEST_M} m, found {size:?}"
            )));
        }
        let position = placement.get("position")?.vector()?;
        if let Some(other) = field.find("position")?
            && other.vector()? != position
        {
            self.odd(
                TaskWarningKind::ObjectsAndPlacementsDiffer,
                format!("{key} stands elsewhere in its placement"),
            );
        }
        if let Some(other) = placement.find("original_id")?
            && other.text()? != asset
        {
            self.odd(
                TaskWarningKind::ObjectsAndPlacementsDiffer,
                format!("{key} is another asset in its placement"),
            );
        }
        if !key.starts_with(&format!("{asset}_on_{receptacle}_at_")) {
            self.odd(
                TaskWarningKind::ObjectsAndPlacementsDiffer,
                format!("{key} is not named after {asset} on {receptacle}"),
            );
        }
        if size.iter().any(|length| *length <= THIN_M) {
            self.odd(
                TaskWarningKind::ThinObject,
                format!("{key} has the size {size:?}"),
            );
        }
        let caption = text_of(field, "detailed_caption")?;
        Ok(ObjectInstance {
            instance: key.into(),
            asset: asset.into(),
            reference_rest: rest
                .map(|rest| self.rest(key, &category, position, rest))
                .transpose()?
                .flatten(),
            attributes: match field.find("attributes")? {
                Some(attributes) => words(&attributes)?,
                None => caption
                    .as_deref()
                    .map(attributes::from_caption)
                    .unwrap_or_default(),
            },
            category,
            caption,
            size,
            position,
            yaw: field.find("yaw")?.map_or(Ok(0.0), |yaw| yaw.number())?,
            receptacle,
        })
    }

    fn rest(
        &mut self,
        key: &str,
        category: &str,
        position: [f64; 3],
        rest: &Field<'_>,
    ) -> Result<Option<[f64; 3]>, Problem> {
        if let Some(field) = rest.find("category")? {
            let other = field.text()?;
            if other != category {
                self.odd(
                    TaskWarningKind::CategoryAlias,
                    format!("{key} is {category:?} and {other:?}"),
                );
                self.extra.insert(field.path().to_owned(), field.json());
            }
        }
        if let Some(field) = rest.find("initial_pos")? {
            let [x, y, z] = field.vector()?;
            let off = [x - position[0], y - position[1], z - position[2] - DROP_M];
            if off.iter().any(|length| length.abs() > 1e-6) {
                self.extra.insert(field.path().to_owned(), field.json());
            }
        }
        self.keep_unknown(
            rest,
            &["category", "initial_pos", "final_pos", "original_id"],
        )?;
        rest.find("final_pos")?
            .map(|field| field.vector())
            .transpose()
    }

    /// The scene's receptacles with the placed objects; doors as the file has them, else closed.
    fn initial_graph(&mut self, objects: &[ObjectInstance]) -> Result<WorldGraph, Problem> {
        let mut graph = Task::initial_graph(self.scene, objects);
        let field = self.episode.get("initial_world_graph")?;
        let mut listed: Vec<ReceptacleId> = Vec::new();
        for (name, state) in field.entries()? {
            let Some(receptacle) = self.scene.receptacle(&name.into()) else {
                return Err(state.problem(format!("{name} is not a receptacle of the scene")));
            };
            listed.push(receptacle.id.clone());
            let mut here: Vec<&str> = objects
                .iter()
                .filter(|object| object.receptacle == receptacle.id)
                .map(|o| o.asset.as_str())
                .collect();
            let mut said = contents(&state)?;
            here.sort_unstable();
            said.sort_unstable();
            if here != said {
                self.odd(
                    TaskWarningKind::InitialGraphDisagrees,
                    format!("{name} holds {said:?}, placed there are {here:?}"),
                );
            }
            if let Some(room) = state.find("room")?
                && room.text()? != receptacle.room
            {
                self.odd(
                    TaskWarningKind::InitialGraphDisagrees,
                    format!("{name} is in {}, not in {}", receptacle.room, room.text()?),
                );
            }
            match (
                state.find("door")?,
                &mut graph
                    .receptacles
                    .get_mut(name)
                    .expect("every receptacle of the scene is in it")
                    .door,
            ) {
                (Some(door), Some(in_graph)) => *in_graph = door_state(&door)?,
                (Some(_), None) => self.odd(
                    TaskWarningKind::InitialGraphDisagrees,
                    format!("{name} has no door in the scene"),
                ),
                (None, _) => {}
            }
            self.keep_unknown(&state, &["room", "content", "door"])?;
        }
        let omitted: Vec<&str> = self
            .scene
            .receptacles
            .iter()
            .filter(|receptacle| !listed.contains(&receptacle.id))
            .map(|r| r.id.as_str())
            .collect();
        if !omitted.is_empty() {
            self.odd(TaskWarningKind::GraphOmitsReceptacles, omitted.join(", "));
        }
        Ok(graph)
    }

    /// The target at the destination, or what `moves` says: a field of our own, for tasks
    /// that move several objects.
    fn goal(
        &self,
        initial: &WorldGraph,
        (target, src, dest): (&InstanceId, &ReceptacleId, &ReceptacleId),
    ) -> Result<WorldGraph, Problem> {
        let mut goal = initial.clone();
        let Some(moves) = self.episode.find("moves")? else {
            goal.remove(src, target);
            goal.add(dest, target);
            return Ok(goal);
        };
        for (key, field) in moves.entries()? {
            let object = InstanceId::from(key);
            let Some(from) = initial.receptacle_of(&object).cloned() else {
                return Err(field.problem(format!("{key} is not an object of the task")));
            };
            goal.remove(&from, &object);
            goal.add(&field.receptacle(self.scene)?, &object);
        }
        if goal.receptacle_of(target) != Some(dest) {
            return Err(moves.problem(format!("expected to move the target, {target}, to {dest}")));
        }
        Ok(goal)
    }

    fn target(
        &self,
        field: &Field<'_>,
        objects: &[ObjectInstance],
        src: &ReceptacleId,
    ) -> Result<InstanceId, Problem> {
        let asset = field.text()?;
        let is_target =
            |object: &&ObjectInstance| object.asset.as_str() == asset && object.receptacle == *src;
        let target = objects.iter().find(is_target);
        target
            .map(|object| object.instance.clone())
            .ok_or_else(|| field.problem(format!("no {asset} stands on {src}")))
    }

    fn plan(&mut self) -> Result<Vec<PlanStep>, Problem> {
        let Some(list) = self.episode.find("execution_plan")? else {
            return Ok(Vec::new());
        };
        let mut plan = Vec::new();
        for step in list.items()? {
            let args = match step.find("args")? {
                Some(args) => args
                    .entries()?
                    .into_iter()
                    .map(|(key, value)| (key.to_owned(), value.json()))
                    .collect(),
                None => BTreeMap::new(),
            };
            plan.push(PlanStep {
                action: step.get("action")?.text()?.to_owned(),
                args,
            });
            self.keep_unknown(&step, &["action", "args"])?;
        }
        Ok(plan)
    }

    /// `obj_meta` and `obj_distractor_meta`: kept where they say more than the objects do.
    fn metas(&mut self, objects: &[ObjectInstance]) -> Result<(), Problem> {
        for section in ["obj_meta", "obj_distractor_meta"] {
            for (asset, meta) in self
                .episode
                .find(section)?
                .map_or(Ok(Vec::new()), |metas| metas.entries())?
            {
                let placed = objects.iter().find(|object| object.asset.as_str() == asset);
                if let (Some(size), None) = (meta.find("size")?, placed)
                    && size.vector()?.contains(&0.0)
                {
                    self.odd(
                        TaskWarningKind::ZeroSizeDistractor,
                        format!("{asset} has the size {:?}", size.vector()?),
                    );
                }
                let json = meta.json();
                if placed.is_none_or(|object| object.asset_meta() != json) {
                    self.extra.insert(meta.path().to_owned(), json);
                }
            }
        }
        Ok(())
    }

    fn goal_deviations(&mut self, objects: &[ObjectInstance]) -> Result<(), Problem> {
        if let Some(goal) = self.episode.find("goal_world_graph")? {
            let initial = self.episode.get("initial_world_graph")?;
            let assets = |graph: &Field<'a>| -> Result<Vec<&'a str>, Problem> {
                let mut all: Vec<&str> = Vec::new();
                for (_, state) in graph.entries()? {
                    all.extend(contents(&state)?);
                }
                all.sort_unstable();
                Ok(all)
            };
            let (before, after) = (assets(&initial)?, assets(&goal)?);
            if before != after {
                self.odd(
                    TaskWarningKind::GoalDoesNotConserve,
                    format!("{} objects before, {} after", before.len(), after.len()),
                );
            }
        }
        let mut places: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for object in objects {
            places
                .entry(object.asset.as_str())
                .or_default()
                .push(object.receptacle.as_str());
        }
        for (asset, receptacles) in places
            .into_iter()
            .filter(|(_, receptacles)| receptacles.len() > 1)
        {
            self.odd(
                TaskWarningKind::SameAssetInSeveralPlaces,
                format!("{asset} on {}", receptacles.join(", ")),
            );
        }
        Ok(())
    }

    fn place_deviations(
        &mut self,
        objects: &[ObjectInstance],
        dest: &ReceptacleId,
        src_distractors: &[ReceptacleId],
    ) {
        if src_distractors.contains(dest) {
            self.odd(
                TaskWarningKind::DestinationAmongSourceDistractors,
                dest.to_string(),
            );
        }
        let scene = self.scene;
        for receptacle in &scene.receptacles {
            let wanted = receptacle.id == *dest;
            if wanted && receptacle.extra.get("synthetic") == Some(&Value::Bool(true)) {
                self.odd(
                    TaskWarningKind::DestinationWithoutGeometry,
                    dest.to_string(),
                );
            }
            if !receptacle.placeable
                && (wanted
                    || objects
                        .iter()
                        .any(|object| object.receptacle == receptacle.id))
            {
                self.odd(
                    TaskWarningKind::UnplaceableReceptacle,
                    receptacle.id.to_string(),
                );
            }
        }
    }

    fn odd(&mut self, kind: TaskWarningKind, detail: String) {
        self.deviations.push((kind, detail));
    }

    /// Keeps a field of the episode unless it says what the task says anyway.
    fn keep_unless(&mut self, key: &str, is_known: impl Fn(&Value) -> bool) -> Result<(), Problem> {
        if let Some(field) = self.episode.find(key)?
            && !is_known(&field.json())
        {
            self.extra.insert(field.path().to_owned(), field.json());
        }
        Ok(())
    }

    fn keep_unknown(&mut self, mapping: &Field<'_>, known: &[&str]) -> Result<(), Problem> {
        let unknown = mapping
            .entries()?
            .into_iter()
            .filter(|(key, _)| !known.contains(key));
        self.extra
            .extend(unknown.map(|(_, field)| (field.path().to_owned(), field.json())));
        Ok(())
    }
}

fn text_of(mapping: &Field<'_>, key: &str) -> Result<Option<String>, Problem> {
    mapping
        .find(key)?
        .map(|field| field.text().map(str::to_owned))
        .transpose()
}

/// Attribute words by kind.
fn words(field: &Field<'_>) -> Result<Attributes, Problem> {
    let kind = |(kind, words): (&str, Field<'_>)| {
        let words = words
            .items()?
            .iter()
            .map(|word| Ok(word.text()?.to_owned()))
            .collect::<Result<_, Problem>>()?;
        Ok((kind.to_owned(), words))
    };
    field.entries()?.into_iter().map(kind).collect()
}

fn contents<'a>(state: &Field<'a>) -> Result<Vec<&'a str>, Problem> {
    state
        .find("content")?
        .map_or(Ok(Vec::new()), |list| list.items())?
        .iter()
        .map(Field::text)
        .collect()
}

/// `false` is closed, as published.
fn door_state(field: &Field<'_>) -> Result<DoorState, Problem> {
    match (field.boolean(), field.json().as_str()) {
        (Some(true), _) | (_, Some("open")) => Ok(DoorState::Open),
        (Some(false), _) | (_, Some("closed")) => Ok(DoorState::Closed),
        _ => Err(field.problem("expected true, false, open or closed")),
    }
}
