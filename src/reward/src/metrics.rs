//! Metrics of one episode and advantages within a group of episodes (SPEC sections 5 and 6). Never reads a reward rule.

use reel_world::{
    GAMMA, Task, WorldGraph,
    record::{Metrics, StartRecord, StepRecord},
};

use crate::goal::holding;

/// Metrics of an episode. `end` is the final graph of the preset's authority ([`crate::Preset::authority`]); the steps hold
/// their reward terms.
///
/// SR and CR look at the final state. An `ask` counts also when nobody answered. SPL is `S * l / max(p, l)` with `l` the
/// shortest path of the start record and `p` the path driven, both in metres; where both are zero it is `S`.
pub fn metrics(task: &Task, start: &StartRecord, steps: &[StepRecord], end: &WorldGraph) -> Metrics {
    let changes = task.goal_changes();
    let held = holding(task, &changes, end);
    let success = held == changes.len();
    let rewards: Vec<f64> = steps.iter().map(StepRecord::reward_total).collect();
    let spl = start.shortest_path_m.map(|shortest| {
        let shortest = f64::from(shortest);
        let driven = f64::from(steps.last().map_or(start.robot.path_length_m, |step| step.robot.path_length_m));
        let longest = driven.max(shortest);
        f64::from(u8::from(success)) * if longest > 0.0 { shortest / longest } else { 1.0 }
    });
    Metrics {
        success,
        completion: if changes.is_empty() { 1.0 } else { held as f64 / changes.len() as f64 },
        total_reward: rewards.iter().sum(),
        discounted_return: discounted_return(&rewards),
        length: steps.len() as u32,
        asks: steps.iter().filter(|step| step.tool.as_deref() == Some("ask")).count() as u32,
        spl,
    }
}

/// `J = sum of gamma^(t-1) r_t` over steps t = 1, 2, ... with gamma 0.99.
pub fn discounted_return(rewards: &[f64]) -> f64 {
    let mut discount = 1.0;
    let mut sum = 0.0;
    for reward in rewards {
        sum += discount * reward;
        discount *= GAMMA;
    }
    sum
}

/// Group-relative advantages `(J_i - mean) / (std + eps)` (paper, GSPO Objective). `std` is the population's (divided by the
/// size of the group, not by one less). Equal returns give zeros; no returns give none.
pub fn advantages(returns: &[f64], eps: f64) -> Vec<f64> {
    let size = returns.len() as f64;
    let mean = returns.iter().sum::<f64>() / size;
    let deviation = (returns.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / size).sqrt();
    let relative = |value: &f64| if deviation + eps > 0.0 { (value - mean) / (deviation + eps) } else { 0.0 };
    returns.iter().map(relative).collect()
}
