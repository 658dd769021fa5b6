//! Runs a recorded episode again, call by call, from its start or from a snapshot, and compares
//! each call with what was recorded. Stops at the first difference.

use std::sync::Arc;

use reel_episode::{Episode, EpisodeConfig, Rollout, StepOutput};
use reel_reward::Preset;
use reel_sim::{MotionSample, SIM_CHANGES, Snapshot, render::Detail, sim_version};
use reel_trace::Trace;
use reel_world::{
    Frame, Meshes, Scene, Task,
    record::{Backend, BodyState, EpisodeHeader, StartRecord, StateDigests, StepRecord},
};

use crate::{Divergence, Verdict, difference};

/// An episode that is executed again beside its trace.
#[derive(Debug)]
pub struct Replay<'t> {
    trace: &'t Trace,
    episode: Episode,
    detail: Detail,
    calls: usize,
    /// Executed physics steps, those of a sleeping world left out.
    physics_steps: u64,
    images: u32,
}

/// What a call gave that differs from its record.
#[derive(Clone, Debug)]
pub struct StepMismatch {
    /// First difference between the recorded call and its replay.
    pub divergence: Box<Divergence>,
    /// What this simulator gave.
    pub output: StepOutput,
}

impl From<Box<StepMismatch>> for Verdict {
    fn from(differing: Box<StepMismatch>) -> Self {
        Verdict::Diverged {
            divergence: differing.divergence,
        }
    }
}

impl<'t> Replay<'t> {
    /// Executes the start again; gives its image too.
    ///
    /// # Errors
    /// Why nothing can be executed, or the first difference.
    pub fn start(trace: &'t Trace, detail: Detail) -> Result<(Self, Frame), Verdict> {
        let config = config(trace)?;
        let (episode, start, frame) =
            Episode::start_with(config, detail).map_err(|error| Verdict::NotReplayable {
                reason: error.to_string(),
            })?;
        let found = difference::header(&trace.header, episode.header());
        found
            .and_then(|()| compare_start(&trace.start, &start, detail))
            .map_err(diverged)?;
        let physics_steps = start.digests.physics_steps.len() as u64;
        Ok((
            Self {
                trace,
                episode,
                detail,
                calls: 0,
                physics_steps,
                images: 1,
            },
            frame,
        ))
    }

    /// Goes on after the first `calls` recorded calls from a snapshot of the state there.
    ///
    /// # Errors
    /// Why nothing can be executed, or that the snapshot is not of that state.
    pub fn resume(trace: &'t Trace, calls: usize, snapshot: &Snapshot) -> Result<Self, Verdict> {
        let refused = |reason| Verdict::Refused { reason };
        let before = trace
            .steps
            .get(..calls)
            .ok_or_else(|| refused(format!("the episode has {} calls", trace.steps.len())))?;
        let episode = Episode::resume(
            config(trace)?,
            trace.start.clone(),
            before.to_vec(),
            snapshot,
        )
        .map_err(|error| refused(error.to_string()))?;
        Ok(Self {
            trace,
            episode,
            detail: Detail::Full,
            calls,
            physics_steps: 0,
            images: 0,
        })
    }

    /// Executes the next recorded call again and gives its image, where it has one; nothing
    /// after the last call.
    ///
    /// # Errors
    /// The first difference.
    pub fn step(&mut self) -> Result<Option<StepOutput>, Box<StepMismatch>> {
        let Some(recorded) = self.trace.steps.get(self.calls) else {
            return Ok(None);
        };
        let output = self.episode.step(recorded.input.clone());
        match compare_step(recorded, &output.record, self.detail) {
            Err(divergence) => Err(Box::new(StepMismatch { divergence, output })),
            Ok(()) => {
                self.calls += 1;
                self.physics_steps += output.record.digests.physics_steps.len() as u64;
                self.images += u32::from(output.frame.is_some());
                Ok(Some(output))
            }
        }
    }

    /// Executes what is left, hands every image over with its call, and compares the end.
    ///
    /// # Errors
    /// The first difference.
    pub fn finish(mut self, mut on_frame: impl FnMut(u32, &Frame)) -> Result<Verdict, Verdict> {
        while let Some(output) = self.step()? {
            if let Some(frame) = &output.frame {
                on_frame(output.record.step, frame);
            }
        }
        let exact = Verdict::Exact {
            calls: u32::try_from(self.trace.steps.len()).unwrap_or(u32::MAX),
            physics_steps: self.physics_steps,
            images: self.images,
        };
        if let Some(recorded) = &self.trace.end {
            let replayed = self.episode.end();
            // An episode that its runner stopped early ends as it did then.
            difference::end(recorded, &replayed).map_err(diverged)?;
        }
        Ok(exact)
    }

    /// What it is compared with.
    pub fn trace(&self) -> &'t Trace {
        self.trace
    }

    /// How many of the recorded calls were executed or skipped.
    pub fn calls(&self) -> usize {
        self.calls
    }

    /// The episode, as far as it was executed.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Keeps the motion states after one physics step of the next call; see [`Episode::watch`].
    pub(crate) fn watch(&mut self, physics_step: usize) {
        self.episode.watch(physics_step);
    }

    /// Renders what the head sees after these physics steps in the next call; see
    /// [`Episode::sample_motion`].
    pub(crate) fn sample_motion(&mut self, sim_steps: impl IntoIterator<Item = u64>) {
        self.episode.sample_motion(sim_steps);
    }

    /// The samples of the last call.
    pub(crate) fn take_samples(&mut self) -> Vec<MotionSample> {
        self.episode.take_samples()
    }

    /// The motion states after the watched physics step.
    pub(crate) fn take_watched(&mut self) -> Option<Vec<BodyState>> {
        self.episode.take_watched()
    }
}

/// What an episode is a function of, from its trace; refuses what no simulator
/// of this version recorded.
pub(crate) fn config(trace: &Trace) -> Result<EpisodeConfig, Verdict> {
    check_version(&trace.header)?;
    config_of_any_version(trace)
}

/// Refuses what another version of the simulator recorded.
pub(crate) fn check_version(header: &EpisodeHeader) -> Result<(), Verdict> {
    if header.backend == Backend::Sim && header.sim_version != sim_version(header.profile) {
        return Err(other_simulator(header));
    }
    Ok(())
}

/// [`config`] also for traces of other versions, whose outcomes may differ.
pub(crate) fn config_of_any_version(trace: &Trace) -> Result<EpisodeConfig, Verdict> {
    config_of(&trace.header, &trace.task, &trace.scene, &trace.meshes)
}

/// [`config_of_any_version`] of inputs that are in no trace.
pub(crate) fn config_of(
    header: &EpisodeHeader,
    task: &Arc<Task>,
    scene: &Arc<Scene>,
    meshes: &Meshes,
) -> Result<EpisodeConfig, Verdict> {
    let not_replayable = |reason| Verdict::NotReplayable { reason };
    if let Some(origin) = header.backend.not_replayable_reason() {
        return Err(not_replayable(format!(
            "recorded {origin}: nothing to re-execute"
        )));
    }
    let preset = Preset::parse(&header.reward_preset).ok_or_else(|| {
        not_replayable(format!("unknown reward preset '{}'", header.reward_preset))
    })?;
    check_meshes(header, meshes)?;
    Ok(EpisodeConfig {
        task: task.clone(),
        scene: scene.clone(),
        seed: header.seed,
        profile: header.profile,
        skills: header.skills,
        meshes: meshes.clone(),
        preset,
        run_id: header.run_id.clone(),
        policy: header.policy.clone(),
        rollout: Rollout::of(header),
        parent: header.parent.clone(),
    })
}

/// Refuses a trace whose meshes are not those that it was recorded with: everything would
/// differ, and say nothing.
///
/// # Errors
/// Fails with the verdict that says which meshes are missing or are others.
pub fn check_meshes(header: &EpisodeHeader, meshes: &Meshes) -> Result<(), Verdict> {
    let wrong = header
        .meshes
        .iter()
        .filter_map(|(asset, recorded)| match meshes.get(asset) {
            None => Some(format!("{asset} ({}) is missing", recorded.short())),
            Some(mesh) if mesh.digest() != *recorded => Some(format!(
                "{asset} is {} here, and was {} when it was recorded",
                mesh.digest().short(),
                recorded.short()
            )),
            Some(_) => None,
        });
    let wrong: Vec<String> = wrong.collect();
    if wrong.is_empty() {
        return Ok(());
    }
    let reason = format!(
        "its objects are meshes, which a trace does not hold: {}; name the folder they were recorded from by --assets DIR or \
         REEL_ASSETS, and `reel scene check-assets DIR` tells the digests in it",
        wrong.join("; ")
    );
    Err(Verdict::Refused { reason })
}

fn other_simulator(header: &EpisodeHeader) -> Verdict {
    let (recorded, this) = (header.sim_version, sim_version(header.profile));
    let [low, high] = [recorded.min(this), recorded.max(this)];
    let between = (1..)
        .zip(SIM_CHANGES)
        .filter(|(version, _)| (low + 1..=high).contains(version));
    let concerns = between.filter(|(_, change)| change.profiles.contains(&header.profile));
    let changes = concerns
        .map(|(version, change)| format!("simulator {version}: {}", change.text))
        .collect();
    Verdict::OtherSimulator {
        recorded,
        current: this,
        changes,
    }
}

fn compare_start(
    recorded: &StartRecord,
    replayed: &StartRecord,
    detail: Detail,
) -> Result<(), Box<Divergence>> {
    if detail == Detail::Full {
        return difference::start(recorded, replayed);
    }
    let digests = without_rgb(&recorded.digests, &replayed.digests);
    difference::start(
        recorded,
        &StartRecord {
            digests,
            ..replayed.clone()
        },
    )
}

fn compare_step(
    recorded: &StepRecord,
    replayed: &StepRecord,
    detail: Detail,
) -> Result<(), Box<Divergence>> {
    if detail == Detail::Full {
        return difference::step(recorded, replayed);
    }
    let digests = without_rgb(&recorded.digests, &replayed.digests);
    difference::step(
        recorded,
        &StepRecord {
            digests,
            ..replayed.clone()
        },
    )
}

/// Replayed digests with what depends on RGB taken from the record: nothing is said of it.
fn without_rgb(recorded: &StateDigests, replayed: &StateDigests) -> StateDigests {
    let mut digests = replayed.clone();
    if let (Some(old), Some(new)) = (&recorded.frame, &mut digests.frame) {
        new.rgb = old.rgb;
    }
    digests
}

fn diverged(divergence: Box<Divergence>) -> Verdict {
    Verdict::Diverged { divergence }
}
