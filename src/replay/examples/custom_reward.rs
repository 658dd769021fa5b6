//! Scores a recorded episode under two rewards of one's own: a built-in preset with another weight,
//! and rules in Rust.
//!
//! `cargo run -p reel-replay --example custom_reward --
//! traces/golden/FDO_home_0002--planner--4.mcap`

use std::{collections::BTreeSet, env, error::Error, path::PathBuf};

use reel_reward::{Preset, Rewarder, Term};
use reel_trace::Trace;
use reel_world::record::{RewardTerm, StartRecord, StepRecord};

/// Pays for each object that is seen for the first time, and takes something for each error.
#[derive(Debug, Default)]
struct Curiosity {
    seen: BTreeSet<String>,
}

impl Rewarder for Curiosity {
    fn start(&mut self, _: &StartRecord) {}

    fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm> {
        let mut value = if step.outcome.error.is_some() {
            -0.5
        } else {
            0.0
        };
        for object in &step.visible {
            if self.seen.insert(object.object.to_string()) {
                value += 0.1;
            }
        }
        let (component, reason) = ("curiosity".to_owned(), String::new());
        vec![RewardTerm {
            component,
            value,
            reason,
        }]
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let path = PathBuf::from(env::args().nth(1).ok_or("usage: custom_reward TRACE")?);
    let trace = Trace::read(&path)?;
    let hasty = Preset::paper().with_weight(Term::Time, -0.1);
    for mut rewarder in [
        hasty.rewarder(&trace.task, &trace.scene),
        Box::new(Curiosity::default()),
    ] {
        rewarder.start(&trace.start);
        let terms = trace.steps.iter().flat_map(|step| rewarder.step(step));
        println!("{:.3}", terms.map(|term| term.value).sum::<f64>());
    }
    Ok(())
}
