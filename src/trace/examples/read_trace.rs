//! Reads a trace: what was asked for, each call with its outcome and reward, and how it ended.
//!
//! `cargo run -p reel-trace --example read_trace -- traces/golden/FDO_home_0002--planner--4.mcap`

use std::{env, error::Error, path::PathBuf};

use reel_trace::Trace;

fn main() -> Result<(), Box<dyn Error>> {
    let path = PathBuf::from(env::args().nth(1).ok_or("usage: read_trace TRACE")?);
    // Checks checksums, order and the chain of digests before it returns anything.
    let trace = Trace::read(&path)?;
    println!("{}: {}", trace.header.episode_id, trace.task.instruction);
    for step in &trace.steps {
        let reward: f64 = step.reward.iter().map(|term| term.value).sum();
        println!("{:3} {} [{reward:+.2}]", step.step, step.input.call);
        println!("    {}", step.outcome.text);
    }
    match &trace.end {
        Some(end) => println!("success: {}", end.metrics.success),
        None => println!("the recording broke off"),
    }
    Ok(())
}
