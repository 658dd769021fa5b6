//! Files of REAL's task generator as tasks. What they do not say follows from the rest: all
//! doors are closed at the start, the goal is the targets at the destination, and the family is
//! that of the type.

use std::collections::BTreeMap;

use reel_world::{Family, InstanceId, ObjectInstance, PlanStep, ReceptacleId, Scene, Task};
use serde_json::{Value, json};

use crate::{error::Problem, field::Field};

const ROOT_FIELDS: &[&str] = &["scene_id", "task_type", "objects", "episodes"];
const OBJECT_FIELDS: &[&str] = &["original_id", "category", "position", "size"];
const EPISODE_FIELDS: &[&str] = &reel_world::words! {
    task_id task_type articulation_subtype task_description detailed_task_description purpose src
    dest target_object_id target_object_ids src_distractors dest_distractors
    dest_furniture_distractors obj_distractors execution_plan placements
};

/// Whether a document is of the generator: its episodes name a type, and no family as
/// those of REAL-Bench do.
pub(crate) fn is_proc(root: &Field<'_>) -> bool {
    let of_generator = || -> Result<bool, Problem> {
        let episodes = root.get("episodes")?.items()?;
        let Some(first) = episodes.first() else {
            return Ok(false);
        };
        Ok(first.find("family")?.is_none()
            && first.find("initial_world_graph")?.is_none()
            && first.find("task_type")?.is_some())
    };
    of_generator().unwrap_or(false)
}

/// Reads every episode of a document.
pub(crate) fn read(root: &Field<'_>, scene: &Scene) -> Result<Vec<Task>, Problem> {
    let scene_field = root.get("scene_id")?;
    let scene_id = scene_field.text()?;
    if scene_id != scene.scene_id {
        return Err(scene_field.problem(format!(
            "is {scene_id}, but the scene given is {}",
            scene.scene_id
        )));
    }
    let episodes = root.get("episodes")?;
    episodes
        .items()?
        .iter()
        .map(|episode| {
            Reader {
                root,
                episode,
                scene,
            }
            .task()
        })
        .collect()
}

struct Reader<'a> {
    root: &'a Field<'a>,
    episode: &'a Field<'a>,
    scene: &'a Scene,
}

impl Reader<'_> {
    fn task(&self) -> Result<Task, Problem> {
        let episode = self.episode;
        let kind_field = episode.get("task_type")?;
        let kind = kind_field.text()?;
        let distracted = match episode.find("obj_distractors")? {
            Some(list) => !list.items()?.is_empty(),
            None => false,
        };
        let family = match kind {
            "basic" | "gather" => Family::FDP,
            "distractor" if distracted => Family::FODP,
            "distractor" => Family::FDP,
            "articulation" => Family::FDO,
            "interactive" => Family::SUL,
            _ => {
                return Err(kind_field
                    .problem("expected basic, distractor, articulation, interactive or gather"));
            }
        };
        let name = format!(
            "{}_{kind}_{}",
            self.scene.scene_id,
            episode.get("task_id")?.text()?
        );
        let instruction = episode.get("task_description")?.text()?.to_owned();
        let precise = self
            .text("detailed_task_description")?
            .unwrap_or_else(|| instruction.clone());
        let (objects, placement_order) = self.objects(&name)?;
        let moved = self.moved(&objects)?;
        let (src, dest) = (
            self.object(&objects, &moved[0]).receptacle.clone(),
            episode.get("dest")?.receptacle(self.scene)?,
        );
        if let Some(field) = episode.find("src")?
            && field.receptacle(self.scene)? != src
        {
            return Err(field.problem(format!(
                "is {}, but the target stands on {src}",
                field.text()?
            )));
        }
        let initial = Task::initial_graph(self.scene, &objects);
        let mut goal = initial.clone();
        for instance in &moved {
            goal.remove(&self.object(&objects, instance).receptacle, instance);
            goal.add(&dest, instance);
        }
        let gathers = kind == "gather";
        let dest_distractors = if gathers {
            "dest_furniture_distractors"
        } else {
            "dest_distractors"
        };
        let object_distractors = match episode.find("obj_distractors")? {
            // Those of a gathering are names of receptacles.
            Some(list) if !gathers => list
                .items()?
                .iter()
                .map(|item| Ok(item.text()?.into()))
                .collect::<Result<Vec<_>, Problem>>()?,
            _ => Vec::new(),
        };
        Ok(Task {
            task_id: format!("{family}/{name}"),
            family,
            task_type: Some(
                self.text("articulation_subtype")?
                    .unwrap_or_else(|| kind.to_owned()),
            ),
            scene_id: self.scene.scene_id.clone(),
            fuzzy: instruction != precise,
            instruction,
            precise_instruction: precise,
            purpose: self.text("purpose")?,
            initial,
            goal,
            target: moved[0].clone(),
            src,
            dest,
            src_distractors: if gathers {
                Vec::new()
            } else {
                self.episode.receptacles("src_distractors", self.scene)?
            },
            dest_distractors: self.episode.receptacles(dest_distractors, self.scene)?,
            object_distractors,
            plan: self.plan()?,
            published_goal: None,
            extra: self.extra(&objects)?,
            objects,
            placement_order,
        })
    }

    /// What the episode places, sorted by instance, and the order in which it places them if
    /// that is another one.
    fn objects(&self, name: &str) -> Result<(Vec<ObjectInstance>, Vec<InstanceId>), Problem> {
        let listed = self.root.get("objects")?;
        let placements = self.episode.get("placements")?;
        let mut objects: Vec<ObjectInstance> = Vec::new();
        for (key, placement) in placements.entries_as_written()? {
            let Some(field) = listed.find(key)? else {
                return Err(
                    placement.problem(format!("{key} is not among the objects of the file"))
                );
            };
            let asset = field.get("original_id")?.text()?.into();
            let receptacle = placement.get("furniture")?.receptacle(self.scene)?;
            let instance = InstanceId::new(&asset, &receptacle, name);
            if objects.iter().any(|other| other.instance == instance) {
                return Err(
                    placement.problem(format!("a second {asset} on {receptacle}; one is expected"))
                );
            }
            let position = placement
                .find("position")?
                .map_or_else(|| field.get("position"), Ok)?
                .vector()?;
            let size_field = field.get("size")?;
            let size = size_field.vector()?;
            if size.iter().any(|length| *length <= 0.0) {
                return Err(
                    size_field.problem(format!("expected lengths above 0 m, found {size:?}"))
                );
            }
            objects.push(ObjectInstance {
                instance,
                asset,
                category: field.get("category")?.text()?.to_owned(),
                caption: None,
                attributes: BTreeMap::new(),
                size,
                position,
                yaw: 0.0,
                receptacle,
                reference_rest: None,
            });
        }
        if objects.is_empty() {
            return Err(placements.problem("no object is placed"));
        }
        let order: Vec<InstanceId> = objects
            .iter()
            .map(|object| object.instance.clone())
            .collect();
        objects.sort_by(|a, b| a.instance.cmp(&b.instance));
        Ok((objects, if order.is_sorted() { Vec::new() } else { order }))
    }

    /// The instances that shall go to the destination; at least one.
    fn moved(&self, objects: &[ObjectInstance]) -> Result<Vec<InstanceId>, Problem> {
        let find = |field: &Field<'_>, asset: &str, src: Option<&ReceptacleId>| {
            let meant = |object: &&ObjectInstance| {
                object.asset.as_str() == asset && src.is_none_or(|src| object.receptacle == *src)
            };
            let found = objects
                .iter()
                .find(meant)
                .map(|object| object.instance.clone());
            let place = src.map_or_else(|| "in this episode".to_owned(), |src| format!("on {src}"));
            found.ok_or_else(|| field.problem(format!("no {asset} stands {place}")))
        };
        let Some(list) = self.episode.find("target_object_ids")? else {
            let field = self.episode.get("target_object_id")?;
            let src = self.episode.get("src")?.receptacle(self.scene)?;
            return Ok(vec![find(&field, field.text()?, Some(&src))?]);
        };
        let sources: BTreeMap<String, ReceptacleId> = match self.episode.find("sources")? {
            Some(sources) => sources
                .items()?
                .iter()
                .map(|source| self.source(source))
                .collect::<Result<_, Problem>>()?,
            None => BTreeMap::new(),
        };
        let moved = list
            .items()?
            .iter()
            .map(|item| find(item, item.text()?, sources.get(item.text()?)))
            .collect::<Result<Vec<_>, _>>()?;
        if moved.is_empty() {
            Err(list.problem("no object shall be moved"))
        } else {
            Ok(moved)
        }
    }

    /// An object of a gathering and where it is.
    fn source(&self, source: &Field<'_>) -> Result<(String, ReceptacleId), Problem> {
        let asset = source
            .get("object_uid")?
            .text()?
            .trim_start_matches('_')
            .to_owned();
        Ok((asset, source.get("name")?.receptacle(self.scene)?))
    }

    /// Steps as texts, or as mappings like those of REAL-Bench.
    fn plan(&self) -> Result<Vec<PlanStep>, Problem> {
        let Some(list) = self.episode.find("execution_plan")? else {
            return Ok(Vec::new());
        };
        let step = |item: &Field<'_>| {
            let parsed = match item.json() {
                Value::String(text) => PlanStep::from_text(&text),
                mapping => serde_json::from_value(mapping).ok(),
            };
            parsed.ok_or_else(|| {
                item.problem(
                    "expected a step such as `navigate to table_1` or `find mug - A red mug.`",
                )
            })
        };
        list.items()?.iter().map(step).collect()
    }

    /// What the task has no field for, under its path in a file of the task alone, where objects
    /// are called by their instance.
    fn extra(&self, objects: &[ObjectInstance]) -> Result<BTreeMap<String, Value>, Problem> {
        let mut extra = BTreeMap::new();
        for (key, field) in self
            .root
            .entries()?
            .into_iter()
            .filter(|(key, _)| !ROOT_FIELDS.contains(key))
        {
            extra.insert(key.to_owned(), field.json());
        }
        for (key, field) in self
            .episode
            .entries()?
            .into_iter()
            .filter(|(key, _)| !EPISODE_FIELDS.contains(key))
        {
            extra.insert(format!("episodes[0].{key}"), field.json());
        }
        let listed = self.root.get("objects")?;
        for (key, placement) in self.episode.get("placements")?.entries()? {
            let (Some(field), furniture) = (listed.find(key)?, placement.get("furniture")?) else {
                continue;
            };
            let (asset, furniture) = (field.get("original_id")?.text()?, furniture.text()?);
            let placed = objects.iter().find(|object| {
                object.asset.as_str() == asset && object.receptacle.as_str() == furniture
            });
            let Some(placed) = placed else { continue };
            for (name, value) in field
                .entries()?
                .into_iter()
                .filter(|(name, _)| !OBJECT_FIELDS.contains(name))
            {
                extra.insert(format!("objects.{}.{name}", placed.instance), value.json());
            }
        }
        extra.insert(
            "episodes[0].generator_task_id".to_owned(),
            json!(self.episode.get("task_id")?.text()?),
        );
        Ok(extra)
    }

    fn object<'o>(
        &self,
        objects: &'o [ObjectInstance],
        instance: &InstanceId,
    ) -> &'o ObjectInstance {
        objects
            .iter()
            .find(|object| object.instance == *instance)
            .expect("only objects of the episode are moved")
    }

    fn text(&self, key: &str) -> Result<Option<String>, Problem> {
        self.episode
            .find(key)?
            .map(|field| field.text().map(str::to_owned))
            .transpose()
    }
}
