//! What a task sets up and no call changes: shapes, doors and the navigation map. Takes most of the time and memory of a
//! simulator, so those of one task share it.

use std::{collections::BTreeSet, sync::Arc};

use reel_world::{Scene, Task};

use crate::{
    math,
    model::{ObjectModel, SceneModel, object_model, scene_model},
    nav::NavMap,
};

/// A task in its scene, before anything happens.
#[derive(Debug)]
pub struct Stage {
    pub(crate) scene: Arc<Scene>,
    pub(crate) task: Arc<Task>,
    pub(crate) model: SceneModel,
    /// In the order of the task's objects.
    pub(crate) object_models: Box<[ObjectModel]>,
    pub(crate) nav: NavMap,
    /// The door (index into physics) of each piece of furniture.
    pub(crate) door_of: Box<[Option<usize>]>,
}

impl Stage {
    /// Sets a task up.
    pub fn new(scene: Arc<Scene>, task: Arc<Task>) -> Arc<Self> {
        math::link();
        let in_use: BTreeSet<_> = task.objects.iter().map(|object| object.receptacle.clone()).collect();
        let model = scene_model(&scene, &in_use);
        let object_models = task.objects.iter().map(object_model).collect();
        let mut doors = 0..;
        let door_of = model.furniture.iter().map(|furniture| furniture.door.as_ref().and_then(|_| doors.next())).collect();
        Arc::new(Self { nav: NavMap::new(&model), scene, task, model, object_models, door_of })
    }

    /// The scene.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The task.
    pub fn task(&self) -> &Arc<Task> {
        &self.task
    }

    /// How many doors there are.
    pub(crate) fn door_count(&self) -> usize {
        self.door_of.iter().flatten().count()
    }
}
