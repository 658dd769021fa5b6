//! What a task sets up and no call changes: shapes, doors and the navigation map. Takes most of the
//! time and memory of a simulator, so those of one task share it.

use std::{collections::BTreeSet, sync::Arc};

use reel_world::{Digest, Meshes, Scene, Task};

use crate::{
    math,
    model::{ObjectModel, SceneModel, meshed_model, object_model, scene_model},
    nav::NavMap,
    perception::{Perception, SimulatorPerception},
    physics::SPAWN_OFFSET_M,
};

/// A task in its scene, before anything happens.
#[derive(Debug)]
pub struct PreparedTask {
    pub(crate) scene: Arc<Scene>,
    pub(crate) task: Arc<Task>,
    scene_digest: Digest,
    task_digest: Digest,
    pub(crate) model: SceneModel,
    /// In the order of the task's objects.
    pub(crate) object_models: Box<[ObjectModel]>,
    meshes: Meshes,
    pub(crate) nav: NavMap,
    /// The door (index into physics) of each piece of furniture.
    pub(crate) door_of: Box<[Option<usize>]>,
    pub(crate) perception: Arc<dyn Perception>,
}

impl PreparedTask {
    /// Sets a task up, its objects as primitives.
    pub fn new(scene: Arc<Scene>, task: Arc<Task>) -> Arc<Self> {
        Self::with_meshes(scene, task, Meshes::default())
    }

    /// Sets a task up, the objects that have a mesh as that.
    pub fn with_meshes(scene: Arc<Scene>, task: Arc<Task>, meshes: Meshes) -> Arc<Self> {
        Self::with_perception(scene, task, meshes, Arc::new(SimulatorPerception))
    }

    /// [`PreparedTask::with_meshes`] where the tools of the published servers ask `perception`
    /// instead of the simulator's own geometry and camera: for tests, which give tables.
    pub fn with_perception(
        scene: Arc<Scene>,
        task: Arc<Task>,
        meshes: Meshes,
        perception: Arc<dyn Perception>,
    ) -> Arc<Self> {
        math::link();
        let in_use: BTreeSet<_> = task
            .objects
            .iter()
            .map(|object| object.receptacle.clone())
            .collect();
        let model = scene_model(&scene, &in_use);
        let object_models = task
            .objects
            .iter()
            .map(|object| match meshes.get(&object.asset) {
                Some(mesh) => meshed_model(object, mesh),
                None => object_model(object),
            });
        let object_models = object_models.collect();
        let mut doors = 0..;
        let door_of = model
            .furniture
            .iter()
            .map(|furniture| furniture.door.as_ref().and_then(|_| doors.next()))
            .collect();
        Arc::new(Self {
            nav: NavMap::new(&model),
            scene_digest: Digest::of_json(&*scene),
            task_digest: Digest::of_json(&*task),
            scene,
            task,
            model,
            object_models,
            meshes,
            door_of,
            perception,
        })
    }

    /// The scene of the episode, shared by all simulators of this stage.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.scene
    }

    /// The task of the episode, shared by all simulators of this stage.
    pub fn task(&self) -> &Arc<Task> {
        &self.task
    }

    /// Digest of the task's document, as headers of traces name it.
    pub fn task_digest(&self) -> Digest {
        self.task_digest
    }

    /// Digest of the scene's document, as headers of traces name it.
    pub fn scene_digest(&self) -> Digest {
        self.scene_digest
    }

    /// What objects look like that are no primitives, by asset.
    pub fn meshes(&self) -> &Meshes {
        &self.meshes
    }

    /// How far above its place an object is spawned, in metres: in a shelf or a drawer no farther
    /// than the board above allows.
    pub(crate) fn spawn_offset(&self, object: usize) -> f32 {
        let receptacle = &self.task.objects[object].receptacle;
        let furniture = self.model.furniture.iter();
        let part = furniture
            .filter(|furniture| furniture.part_of.is_some())
            .find(|furniture| furniture.id == *receptacle);
        part.map_or(SPAWN_OFFSET_M, |part| {
            let free = part.surface.clearance - 2.0 * self.object_models[object].half[2];
            (free * 0.5).clamp(0.002, SPAWN_OFFSET_M)
        })
    }

    /// How many doors there are.
    pub(crate) fn door_count(&self) -> usize {
        self.door_of.iter().flatten().count()
    }
}
