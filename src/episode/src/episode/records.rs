//! Records of an episode: header, digests and the end.

use super::*;

pub(super) fn end(
    ended: Option<EndReason>,
    config: &EpisodeConfig,
    start: &StartRecord,
    steps: &[StepRecord],
    graphs: Graphs,
) -> EndRecord {
    EndRecord {
        reason: ended.unwrap_or(EndReason::Aborted),
        metrics: metrics(&config.preset, &config.task, start, steps, &graphs),
        steps: u32::try_from(steps.len()).expect("an episode has few steps"),
        graphs,
        reported: Reported::default(),
    }
}

/// Those who watch an episode: the rewards and the user, told of its start.
pub(super) fn observers(
    config: &EpisodeConfig,
    start: &StartRecord,
) -> (Box<dyn Rewarder>, RuleUser) {
    let mut rewarder = config.preset.rewarder(&config.task, &config.scene);
    rewarder.start(start);
    let mut user = RuleUser::new(&config.task, &config.scene);
    user.observe("", &seen(&start.visible, &[]));
    (rewarder, user)
}

/// What the user learns of a step.
pub(super) fn observe(user: &mut RuleUser, step: &StepRecord) {
    user.observe(
        &step.input.call.to_string(),
        &seen(&step.visible, &step.listed),
    );
    user.observe_held(step.held.as_ref());
}

/// The header of an episode on a stage, which knows the digests of its task and scene.
pub(super) fn header(config: &EpisodeConfig, stage: &PreparedTask) -> EpisodeHeader {
    EpisodeHeader {
        episode_id: String::new(),
        run_id: config.run_id.clone(),
        group_id: config
            .rollout
            .as_ref()
            .map(|rollout| rollout.group_id.clone()),
        rollout_index: config.rollout.as_ref().map(|rollout| rollout.index),
        task_id: config.task.task_id.clone(),
        family: config.task.family,
        scene_id: config.scene.scene_id.clone(),
        task_digest: stage.task_digest(),
        scene_digest: stage.scene_digest(),
        seed: config.seed,
        sim_version: sim_version(config.profile),
        build: env!("CARGO_PKG_VERSION").to_owned(),
        profile: config.profile,
        reward_preset: config.preset.name().to_owned(),
        policy: config.policy.clone(),
        backend: Backend::Sim,
        skills: config.skills,
        meshes: config
            .meshes
            .iter()
            .map(|(asset, mesh)| (asset.clone(), mesh.digest()))
            .collect(),
        parent: config.parent.clone(),
    }
    .identified()
}

pub(super) fn digests(simulator: &mut Simulator, frame: Option<&Frame>) -> StateDigests {
    StateDigests {
        state: simulator.digest(),
        frame: frame.map(Frame::digests),
        physics_steps: simulator.take_step_digests(),
    }
}

/// What an auxiliary observation holds: what is in the image and what was told in words.
pub(super) fn seen(
    visible: &[reel_world::record::VisibleObject],
    listed: &[InstanceId],
) -> Vec<InstanceId> {
    visible
        .iter()
        .map(|object| object.object.clone())
        .chain(listed.iter().cloned())
        .collect()
}
