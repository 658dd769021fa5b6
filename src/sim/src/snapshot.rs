//! The whole state of a simulator between two calls, taken out and put back: what comes after a
//! restore equals what came after the original, bit for bit. Never part of a trace: the engine's
//! form is no file format.

use std::sync::Arc;

use reel_world::{Digest, FRAME_HEIGHT, FRAME_WIDTH, Profile, record::RobotState};
use serde::{Deserialize, Serialize};

use crate::{PreparedTask, SIM_VERSION, physics::Physics, render::Detail, simulator::Simulator};

/// The state of a simulator between two calls.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Snapshot {
    sim_version: u32,
    digest: Digest,
    /// Engine, doors and held objects, as the serializer of this build writes them.
    physics: Vec<u8>,
    /// World graph and markers as JSON: their tagged forms need a format that describes itself.
    registry: String,
    arrivals: Vec<u32>,
    markers: String,
    held: Option<u32>,
    has_marker_map: bool,
    markers_persist: bool,
    landmark: Option<u32>,
    robot: RobotState,
    sim_step: u64,
    /// What stood in the last image: (entity, pixels) runs over its rows.
    view: Vec<(u16, u32)>,
}

/// Why a snapshot cannot be restored.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum SnapshotError {
    /// Taken by another simulator.
    #[error(
        "the snapshot was taken by simulator {found}, this is {SIM_VERSION}; delete it, it is created again on demand"
    )]
    OtherSimulator { found: u32 },
    /// The bytes cannot be decoded, or their content does not fit the task.
    #[error("the snapshot is damaged ({problem}); delete it, it is created again on demand")]
    Damaged { problem: String },
    /// Of another task, scene or seed.
    #[error(
        "the snapshot is of another episode: it has the state {expected}, restored it is {found}"
    )]
    OtherEpisode { expected: Digest, found: Digest },
}

impl Snapshot {
    /// Digest of the state it was taken of.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// The bytes of a snapshot, for a cache of this build.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("a snapshot holds nothing that cannot be written")
    }

    /// A snapshot from its bytes.
    ///
    /// # Errors
    /// When they are no snapshot of this simulator.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let (found, _) = postcard::take_from_bytes::<u32>(bytes).map_err(damaged)?;
        if found != SIM_VERSION {
            return Err(SnapshotError::OtherSimulator { found });
        }
        postcard::from_bytes(bytes).map_err(damaged)
    }
}

impl Simulator {
    /// Takes the state out.
    pub fn snapshot(&self) -> Snapshot {
        let index =
            |index: usize| u32::try_from(index).expect("a scene has fewer than 65,000 things");
        Snapshot {
            sim_version: SIM_VERSION,
            digest: self.digest(),
            physics: postcard::to_allocvec(&self.physics)
                .expect("the engine's state can be written"),
            registry: reel_world::canonical_json(&self.registry),
            arrivals: self.arrivals.iter().copied().map(index).collect(),
            markers: reel_world::canonical_json(&self.markers),
            held: self.held.map(index),
            has_marker_map: self.has_marker_map,
            markers_persist: self.markers_persist,
            landmark: self.landmark.map(index),
            robot: self.robot,
            sim_step: self.sim_step,
            view: self.view.clone(),
        }
    }

    /// A simulator of an episode that goes on from a snapshot.
    ///
    /// # Errors
    /// When the snapshot is damaged or of another episode.
    pub fn resume(
        stage: Arc<PreparedTask>,
        profile: Profile,
        seed: u64,
        snapshot: &Snapshot,
    ) -> Result<Self, SnapshotError> {
        if snapshot.sim_version != SIM_VERSION {
            return Err(SnapshotError::OtherSimulator {
                found: snapshot.sim_version,
            });
        }
        let physics: Physics = postcard::from_bytes(&snapshot.physics).map_err(damaged)?;
        let things = |index: Option<u32>, count: usize| match index.map(|index| index as usize) {
            Some(index) if index >= count => Err(damaged("it speaks of things that are not there")),
            index => Ok(index),
        };
        if (physics.object_count(), physics.door_count())
            != (stage.object_models.len(), stage.door_count())
        {
            return Err(damaged("it has other objects or doors than the task"));
        }
        let pixels = snapshot
            .view
            .iter()
            .try_fold(0u32, |sum, (_, pixels)| sum.checked_add(*pixels));
        if pixels != Some((FRAME_WIDTH * FRAME_HEIGHT) as u32) {
            return Err(damaged("its image has another size"));
        }
        let arrivals = snapshot
            .arrivals
            .iter()
            .filter_map(|object| things(Some(*object), stage.object_models.len()).transpose());
        let restored = Self {
            arrivals: arrivals.collect::<Result<_, _>>()?,
            profile,
            seed,
            physics,
            registry: serde_json::from_str(&snapshot.registry).map_err(damaged)?,
            held: things(snapshot.held, stage.object_models.len())?,
            markers: serde_json::from_str(&snapshot.markers).map_err(damaged)?,
            has_marker_map: snapshot.has_marker_map,
            markers_persist: snapshot.markers_persist,
            landmark: things(snapshot.landmark, stage.model.furniture.len())?,
            stage,
            robot: snapshot.robot,
            view: snapshot.view.clone(),
            detail: Detail::Full,
            sim_step: snapshot.sim_step,
            step_digests: Vec::new(),
            watch: None,
            watched: None,
            motion: Default::default(),
        };
        match restored.digest() {
            found if found == snapshot.digest => Ok(restored),
            found => Err(SnapshotError::OtherEpisode {
                expected: snapshot.digest,
                found,
            }),
        }
    }
}

fn damaged(what: impl std::fmt::Display) -> SnapshotError {
    SnapshotError::Damaged {
        problem: what.to_string(),
    }
}
