//! Metrics of one episode (docs/spec.md#metrics and docs/spec.md#advantages). Never
//! reads a reward rule.

use reel_world::{
    InstanceId, Task, WorldGraph,
    record::{Graphs, Metrics, StartRecord, StepRecord},
};

use crate::{
    goal::{by_kind, holding},
    preset::Preset,
    terms::Base,
    trainer::Categories,
};

/// Metrics of an episode under a preset. `end` are the final graphs; the steps
/// hold their reward terms.
///
/// SR and CR look at the final state: in the physical graph by instance for `paper`, in the
/// registry and without doors by asset for `real-repo` and by category for `real-trainer`. An `ask`
/// counts also when nobody answered. SPL is `S * l / max(p, l)` with `l` the shortest path of the
/// start record and `p` the path driven, both in metres; where both are zero it is `S`.
/// A task without a goal is never a success here, its completion is 0, and it has no SPL.
pub fn metrics(
    preset: &Preset,
    task: &Task,
    start: &StartRecord,
    steps: &[StepRecord],
    end: &Graphs,
) -> Metrics {
    let end: &WorldGraph = preset.authority(end);
    let (held, wanted) = match preset.base() {
        Base::Paper => holding(&task.initial, &task.goal, end),
        Base::RealRepo => holding_by(task, end, |instance| {
            InstanceId::from(instance.asset().as_str())
        }),
        Base::RealTrainer => {
            let categories = Categories::of_task(task);
            holding_by(task, end, |instance| {
                InstanceId::from(categories.convert(instance.as_str()))
            })
        }
    };
    let success = task.has_goal() && held == wanted;
    let rewards: Vec<f64> = steps.iter().map(StepRecord::reward_total).collect();
    let shortest = start.shortest_path_m.filter(|_| task.has_goal());
    let spl = shortest.map(|shortest| {
        let shortest = f64::from(shortest);
        let driven = f64::from(
            steps
                .last()
                .map_or(start.robot.path_length_m, |step| step.robot.path_length_m),
        );
        let longest = driven.max(shortest);
        f64::from(u8::from(success))
            * if longest > 0.0 {
                shortest / longest
            } else {
                1.0
            }
    });
    Metrics {
        success,
        completion: if wanted == 0 {
            f64::from(u8::from(task.has_goal()))
        } else {
            held as f64 / wanted as f64
        },
        total_reward: rewards.iter().sum(),
        discounted_return: discounted_return(&rewards, preset.gamma()),
        length: steps.len() as u32,
        asks: steps
            .iter()
            .filter(|step| step.tool.as_deref() == Some("ask"))
            .count() as u32,
        spl,
    }
}

fn holding_by(
    task: &Task,
    end: &WorldGraph,
    kind: impl Fn(&InstanceId) -> InstanceId,
) -> (usize, usize) {
    holding(
        &by_kind(&task.initial, &kind),
        &by_kind(&task.goal, &kind),
        &by_kind(end, &kind),
    )
}

/// `J = sum of gamma^(t-1) r_t` over steps t = 1, 2, ... (paper, GSPO Objective).
pub fn discounted_return(rewards: &[f64], gamma: f64) -> f64 {
    let mut discount = 1.0;
    let mut sum = 0.0;
    for reward in rewards {
        sum += discount * reward;
        discount *= gamma;
    }
    sum
}
