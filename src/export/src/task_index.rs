//! What many episodes share, read once: tasks, scenes, presets.

use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
};

use reel_annotate::PublicTask;
use reel_dataset::{PrivilegedFacts, PublicReceptacle, TaskBriefing};
use reel_prompt::Prompt;
use reel_reward::Preset;
use reel_tables::{Store, StoreError, Table};
use reel_world::{ObjectInstance, Scene, Task};

use crate::{ExportError, episode::EpisodeRow};

/// Tasks that are kept in memory.
const TASKS_KEPT: usize = 4_096;

/// What is known of the tasks, scenes and presets of episodes.
pub(crate) struct TaskIndex {
    /// The documents, by digest.
    task_texts: HashMap<String, String>,
    scene_texts: HashMap<String, String>,
    tasks: HashMap<String, TaskEntry>,
    scenes: HashMap<String, Arc<Scene>>,
    preset_digests: HashMap<String, String>,
    prompt: Arc<Prompt>,
}

/// What the episodes of a task have in common.
pub(crate) struct TaskEntry {
    task: Task,
    scene: Arc<Scene>,
    /// For the annotator, once it asks.
    public: OnceLock<PublicTask>,
    /// Places of the objects in the task, by their instances.
    objects: HashMap<String, usize>,
    pub briefing: Arc<TaskBriefing>,
}

impl TaskIndex {
    /// Nothing yet, of a store; what is learned is put by this prompt.
    pub fn new(store: &Store, prompt: Arc<Prompt>) -> Result<Self, StoreError> {
        Ok(Self {
            task_texts: store.documents(Table::Tasks, "task")?,
            scene_texts: store.documents(Table::Scenes, "scene")?,
            tasks: HashMap::new(),
            scenes: HashMap::new(),
            preset_digests: HashMap::new(),
            prompt,
        })
    }

    /// Learns what some episodes share with others; what was learned of earlier
    /// ones may be forgotten.
    ///
    /// # Errors
    /// When an episode has a task or scene that is none.
    pub fn learn<'r>(
        &mut self,
        rows: impl IntoIterator<Item = &'r EpisodeRow<'r>>,
    ) -> Result<(), ExportError> {
        if self.tasks.len() > TASKS_KEPT {
            self.tasks.clear();
            self.scenes.clear();
        }
        for row in rows {
            if !self.tasks.contains_key(row.task_digest) {
                let damaged = |reason| ExportError::Document {
                    episode_id: row.episode_id.to_owned(),
                    reason,
                };
                let task = self.task(row).map_err(damaged)?;
                self.tasks.insert(row.task_digest.to_owned(), task);
            }
            if !self.preset_digests.contains_key(row.preset) {
                let digest = Preset::parse(row.preset)
                    .map_or_else(String::new, |preset| preset.version().to_string());
                self.preset_digests.insert(row.preset.to_owned(), digest);
            }
        }
        Ok(())
    }

    /// The task of an episode that was learned.
    pub fn task_of(&self, row: &EpisodeRow<'_>) -> &TaskEntry {
        &self.tasks[row.task_digest]
    }

    /// The digest of its preset; empty where the preset is not known here.
    pub fn preset_digest_of(&self, row: &EpisodeRow<'_>) -> &str {
        &self.preset_digests[row.preset]
    }

    fn task(&mut self, row: &EpisodeRow<'_>) -> Result<TaskEntry, String> {
        let task: Task = document(&self.task_texts, row.task_digest, "task")?;
        let scene = match self.scenes.get(row.scene_digest) {
            Some(scene) => Arc::clone(scene),
            None => {
                let scene: Arc<Scene> =
                    Arc::new(document(&self.scene_texts, row.scene_digest, "scene")?);
                self.scenes
                    .insert(row.scene_digest.to_owned(), Arc::clone(&scene));
                scene
            }
        };
        let receptacle = |it: &reel_world::Receptacle| PublicReceptacle {
            id: it.id.to_string(),
            category: it.category.clone(),
            room: it.room.clone(),
        };
        let receptacles = scene.receptacles.iter().map(receptacle).collect();
        Ok(TaskEntry {
            public: OnceLock::new(),
            objects: task
                .objects
                .iter()
                .enumerate()
                .map(|(index, object)| (object.instance.to_string(), index))
                .collect(),
            briefing: Arc::new(
                TaskBriefing::new(
                    &task.instruction,
                    receptacles,
                    PrivilegedFacts::of_task(&task),
                )
                .with_prompt(Arc::clone(&self.prompt)),
            ),
            task,
            scene,
        })
    }
}

fn document<D: serde::de::DeserializeOwned>(
    texts: &HashMap<String, String>,
    digest: &str,
    what: &str,
) -> Result<D, String> {
    let text = texts.get(digest).map_or("", String::as_str);
    serde_json::from_str(text)
        .map_err(|error| format!("the {what} in the tables is damaged: {error}"))
}

impl TaskEntry {
    /// What an annotator may know.
    pub fn public(&self) -> &PublicTask {
        self.public
            .get_or_init(|| PublicTask::of(&self.task, &self.scene))
    }

    /// An object by its instance.
    pub fn object(&self, instance: &str) -> Option<&ObjectInstance> {
        self.objects
            .get(instance)
            .map(|index| &self.task.objects[*index])
    }
}
