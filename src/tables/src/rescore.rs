//! Rewards from the tables: the columns of an episode become facts, and the engine of `reel_reward`
//! runs on them. Gives the same bits as at record time; never opens a trace.

use std::collections::HashMap;

use arrow::{
    array::{
        Array, AsArray, Float64Array, Int32Array, ListArray, RecordBatch, StringArray, StructArray,
    },
    datatypes::{Float64Type, Int32Type},
};
use reel_reward::{
    Authority, Base, EpisodeFacts, EpisodeReward, MarkerReferent, Preset, Scorer, StepHead,
    TaskFacts,
};
use reel_world::{ErrorClass, Scene, Task};

use crate::{Store, StoreError, Table};

/// An episode that was scored again: what people name it by, and what was recorded.
#[derive(Debug)]
pub struct ScoredEpisode<'a> {
    /// Id of the episode, as in column `episode_id` of `episodes`.
    pub episode_id: &'a str,
    /// Of the trace it was read from.
    pub trace_digest: &'a str,
    /// The trace file that holds the episode, as in column `trace`.
    pub trace: &'a str,
    /// Name of the policy that decided in this episode.
    pub policy: &'a str,
    /// Id of the task that the episode is about.
    pub task_id: &'a str,
    /// Name of the preset at record time.
    pub preset: &'a str,
    recorded: RecordedTerms<'a>,
}

/// The terms at record time, where they were read.
#[derive(Debug)]
struct RecordedTerms<'a> {
    terms: &'a ListArray,
    steps: std::ops::Range<usize>,
}

impl ScoredEpisode<'_> {
    /// Whether a reward has the terms that were recorded, bit for bit and in their order.
    pub fn matches_recorded(&self, reward: &EpisodeReward) -> bool {
        let terms = self.recorded.terms.values().as_struct();
        let components = text(terms, "component");
        let values: &Float64Array = terms
            .column_by_name("value")
            .expect("a term has a value")
            .as_primitive::<Float64Type>();
        let offsets = self.recorded.terms.value_offsets();
        self.recorded.steps.len() == reward.steps().len()
            && self.recorded.steps.clone().enumerate().all(|(step, row)| {
                let recorded = offsets[row] as usize..offsets[row + 1] as usize;
                let fired = reward.terms(step);
                recorded.len() == fired.len()
                    && recorded.zip(fired).all(|(term, fired)| {
                        components.value(term) == fired.term.component()
                            && values.value(term).to_bits() == fired.value.to_bits()
                    })
            })
    }
}

/// Columns of `episodes` that a reward reads, and those that name the episode.
const COLUMNS: &[&str] = &reel_world::words! {
    episode_id trace_digest trace policy task_id task_digest scene_digest preset start_changes
    "start_objects.list.element.object" "steps.list.element.tool" "steps.list.element.argument"
    "steps.list.element.error_code" "steps.list.element.error_class" "steps.list.element.object"
    "steps.list.element.receptacle" "steps.list.element.held" "steps.list.element.reply"
    "steps.list.element.new_objects" "steps.list.element.changes"
    "steps.list.element.terms.list.element.component" "steps.list.element.terms.list.element.value"
};
/// What only some presets read.
const MARKERS: &str = "steps.list.element.marker_map";
const TEXT: &str = "steps.list.element.text";

/// What is prepared once a task.
type PreparedTasks = HashMap<(String, String), TaskFacts>;

impl Store {
    /// Scores every episode under some presets; `visit` gets each episode with its rewards in the
    /// order of the presets, and says whether to go on.
    ///
    /// # Errors
    /// When the store cannot be read, or holds a task or scene that is none.
    pub fn score(
        &self,
        presets: &[Preset],
        visit: impl FnMut(&ScoredEpisode<'_>, &[EpisodeReward]) -> bool,
    ) -> Result<(), StoreError> {
        self.score_in(&self.file_names(Table::Episodes), presets, visit)
    }

    /// [`Store::score`] of the episodes in some files ([`Store::file_names`]).
    ///
    /// # Errors
    /// As [`Store::score`].
    pub fn score_in(
        &self,
        files: &[String],
        presets: &[Preset],
        mut visit: impl FnMut(&ScoredEpisode<'_>, &[EpisodeReward]) -> bool,
    ) -> Result<(), StoreError> {
        let mut columns = COLUMNS.to_vec();
        let wanted = OptionalColumns {
            markers: presets.iter().any(|preset| preset.base() != Base::Paper),
            text: presets
                .iter()
                .any(|preset| preset.base() == Base::RealTrainer),
        };
        columns.extend(wanted.markers.then_some(MARKERS));
        columns.extend(wanted.text.then_some(TEXT));
        let (tasks, scenes) = (
            self.documents(Table::Tasks, "task")?,
            self.documents(Table::Scenes, "scene")?,
        );
        let mut prepared = PreparedTasks::new();
        let mut scorers: Vec<Scorer> = presets.iter().map(Scorer::new).collect();
        let mut rewards: Vec<EpisodeReward> = vec![EpisodeReward::default(); presets.len()];
        let mut facts = EpisodeFacts::default();
        let mut going = true;
        self.read_in(Table::Episodes, files, &columns, |batch| {
            let columns = Columns::new(&batch, wanted);
            for row in 0..batch.num_rows() {
                if !going {
                    return Ok(());
                }
                let task = columns.prepared(row, &mut prepared, &tasks, &scenes)?;
                columns.fill(row, task, &mut facts);
                for (scorer, reward) in scorers.iter_mut().zip(&mut rewards) {
                    scorer.score(task, &facts, reward);
                }
                going = visit(&columns.episode(row), &rewards);
            }
            Ok(())
        })
    }

    /// The JSON documents of `tasks` (column `task`) or `scenes` (`scene`), by their digests.
    ///
    /// # Errors
    /// When the store cannot be read.
    pub fn documents(
        &self,
        table: Table,
        column: &str,
    ) -> Result<HashMap<String, String>, StoreError> {
        let key = format!("{column}_digest");
        let mut documents = HashMap::new();
        self.read(table, &[&key, column], |batch| {
            let (keys, texts) = (
                batch[key.as_str()].as_string::<i32>(),
                batch[column].as_string::<i32>(),
            );
            documents.extend(
                keys.iter()
                    .zip(texts)
                    .filter_map(|(key, text)| Some((key?.to_owned(), text?.to_owned()))),
            );
            Ok(())
        })?;
        Ok(documents)
    }
}

/// Which of the columns that only some presets read were read.
#[derive(Clone, Copy)]
struct OptionalColumns {
    markers: bool,
    text: bool,
}

/// The columns of a batch by their types.
struct Columns<'a> {
    episode_id: &'a StringArray,
    trace_digest: &'a StringArray,
    trace: &'a StringArray,
    policy: &'a StringArray,
    task_id: &'a StringArray,
    task_digest: &'a StringArray,
    scene_digest: &'a StringArray,
    preset: &'a StringArray,
    start_changes: Changes<'a>,
    start_objects: (&'a ListArray, &'a StringArray),
    steps: &'a ListArray,
    tool: &'a StringArray,
    argument: &'a StringArray,
    error_code: &'a StringArray,
    error_class: &'a StringArray,
    object: &'a StringArray,
    receptacle: &'a StringArray,
    held: &'a StringArray,
    reply: &'a StringArray,
    new_objects: (&'a ListArray, &'a StringArray),
    changes: Changes<'a>,
    terms: &'a ListArray,
    markers: Option<Markers<'a>>,
    text: Option<&'a StringArray>,
}

struct Changes<'a> {
    list: &'a ListArray,
    authority: &'a StringArray,
    event: &'a StringArray,
    object: &'a StringArray,
    receptacle: &'a StringArray,
    door_from: &'a StringArray,
    door_to: &'a StringArray,
}

struct Markers<'a> {
    list: &'a ListArray,
    marker: &'a Int32Array,
    kind: &'a StringArray,
    id: &'a StringArray,
}

impl<'a> Columns<'a> {
    fn new(batch: &'a RecordBatch, wanted: OptionalColumns) -> Self {
        let plain = |name: &str| batch[name].as_string::<i32>();
        let steps = batch["steps"].as_list::<i32>();
        let step = steps.values().as_struct();
        let of_step = |name: &str| list(step, name);
        let start_objects = batch["start_objects"].as_list::<i32>();
        let new_objects = of_step("new_objects");
        let markers = wanted.markers.then(|| {
            let list = of_step("marker_map");
            let fields = list.values().as_struct();
            let marker = fields
                .column_by_name("marker")
                .expect("a marker has a number")
                .as_primitive::<Int32Type>();
            Markers {
                list,
                marker,
                kind: text(fields, "kind"),
                id: text(fields, "id"),
            }
        });
        Self {
            episode_id: plain("episode_id"),
            trace_digest: plain("trace_digest"),
            trace: plain("trace"),
            policy: plain("policy"),
            task_id: plain("task_id"),
            task_digest: plain("task_digest"),
            scene_digest: plain("scene_digest"),
            preset: plain("preset"),
            start_changes: Changes::new(batch["start_changes"].as_list::<i32>()),
            start_objects: (
                start_objects,
                text(start_objects.values().as_struct(), "object"),
            ),
            steps,
            tool: text(step, "tool"),
            argument: text(step, "argument"),
            error_code: text(step, "error_code"),
            error_class: text(step, "error_class"),
            object: text(step, "object"),
            receptacle: text(step, "receptacle"),
            held: text(step, "held"),
            reply: text(step, "reply"),
            new_objects: (new_objects, new_objects.values().as_string::<i32>()),
            changes: Changes::new(of_step("changes")),
            terms: of_step("terms"),
            markers,
            text: wanted.text.then(|| text(step, "text")),
        }
    }

    fn episode(&self, row: usize) -> ScoredEpisode<'a> {
        ScoredEpisode {
            episode_id: self.episode_id.value(row),
            trace_digest: self.trace_digest.value(row),
            trace: self.trace.value(row),
            policy: self.policy.value(row),
            task_id: self.task_id.value(row),
            preset: self.preset.value(row),
            recorded: RecordedTerms {
                terms: self.terms,
                steps: range(self.steps, row),
            },
        }
    }

    /// The facts of a row's task, made at its first use.
    fn prepared<'p>(
        &self,
        row: usize,
        prepared: &'p mut PreparedTasks,
        tasks: &HashMap<String, String>,
        scenes: &HashMap<String, String>,
    ) -> Result<&'p mut TaskFacts, StoreError> {
        let key = (
            self.task_digest.value(row).to_owned(),
            self.scene_digest.value(row).to_owned(),
        );
        match prepared.entry(key) {
            std::collections::hash_map::Entry::Occupied(found) => Ok(found.into_mut()),
            std::collections::hash_map::Entry::Vacant(free) => {
                let (task, scene) = free.key();
                let task: Task = document(tasks, task, "task")?;
                let scene: Scene = document(scenes, scene, "scene")?;
                Ok(free.insert(TaskFacts::new(&task, &scene)))
            }
        }
    }

    fn fill(&self, row: usize, facts: &mut TaskFacts, episode: &mut EpisodeFacts) {
        facts.begin(episode);
        self.start_changes.fill(row, facts, episode);
        let (list, objects) = self.start_objects;
        range(list, row).for_each(|index| episode.push_visible(facts.object(objects.value(index))));
        let mut marked = false;
        for step in range(self.steps, row) {
            let call = facts.head_of_call(
                self.tool.value(step),
                optional(self.error_code, step),
                optional(self.argument, step),
            );
            let head = StepHead {
                trainer_reading: self
                    .text
                    .map(|text| facts.trainer_reading(&call, text.value(step)))
                    .unwrap_or_default(),
                error: optional(self.error_class, step).map(|class| {
                    if class == "severe" {
                        ErrorClass::Severe
                    } else {
                        ErrorClass::Moderate
                    }
                }),
                object: optional(self.object, step).map(|object| facts.object(object)),
                receptacle: optional(self.receptacle, step).map(|place| facts.receptacle(place)),
                held: optional(self.held, step).map(|object| facts.object(object)),
                reply: optional(self.reply, step).map(|text| facts.text(text)),
                ..call
            };
            episode.step(head);
            self.changes.fill(step, facts, episode);
            let (list, objects) = self.new_objects;
            range(list, step)
                .for_each(|index| episode.push_visible(facts.object(objects.value(index))));
            let Some(markers) = &self.markers else {
                continue;
            };
            let map = range(markers.list, step);
            if map.is_empty() && !marked {
                continue;
            }
            marked = !map.is_empty();
            episode.set_markers();
            for index in map {
                let id = markers.id.value(index);
                let target = match markers.kind.value(index) {
                    "object" => MarkerReferent::Object(facts.object(id)),
                    _ => MarkerReferent::Receptacle(facts.receptacle(id)),
                };
                episode.mark(markers.marker.value(index) as u32, target);
            }
        }
    }
}

impl<'a> Changes<'a> {
    fn new(list: &'a ListArray) -> Self {
        let fields = list.values().as_struct();
        Self {
            list,
            authority: text(fields, "authority"),
            event: text(fields, "event"),
            object: text(fields, "object"),
            receptacle: text(fields, "receptacle"),
            door_from: text(fields, "door_from"),
            door_to: text(fields, "door_to"),
        }
    }

    fn fill(&self, row: usize, facts: &mut TaskFacts, episode: &mut EpisodeFacts) {
        for index in range(self.list, row) {
            let authority = if self.authority.value(index) == "physics" {
                Authority::Physics
            } else {
                Authority::Registry
            };
            let (event, place) = (self.event.value(index), self.receptacle.value(index));
            let doors = (
                optional(self.door_from, index),
                optional(self.door_to, index),
            );
            if let Some(change) =
                facts.change(event, optional(self.object, index), place, doors.0, doors.1)
            {
                episode.change(authority, change);
            }
        }
    }
}

fn document<T: serde::de::DeserializeOwned>(
    documents: &HashMap<String, String>,
    digest: &str,
    what: &'static str,
) -> Result<T, StoreError> {
    let damaged = |reason: String| StoreError::Document {
        problem: what,
        digest: digest.to_owned(),
        reason,
    };
    let text = documents
        .get(digest)
        .ok_or_else(|| damaged("it is not there".into()))?;
    serde_json::from_str(text).map_err(|error| damaged(error.to_string()))
}

fn list<'a>(of: &'a StructArray, name: &str) -> &'a ListArray {
    of.column_by_name(name)
        .expect("the columns were asked for")
        .as_list::<i32>()
}

fn text<'a>(of: &'a StructArray, name: &str) -> &'a StringArray {
    of.column_by_name(name)
        .expect("the columns were asked for")
        .as_string::<i32>()
}

fn range(list: &ListArray, row: usize) -> std::ops::Range<usize> {
    let offsets = list.value_offsets();
    offsets[row] as usize..offsets[row + 1] as usize
}

fn optional(texts: &StringArray, row: usize) -> Option<&str> {
    texts.is_valid(row).then(|| texts.value(row))
}
