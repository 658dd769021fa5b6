//! Many traces from a few: each is written again under other episode ids, hash chain and all, so
//! that an ingest of tens of thousands can be measured. What they hold was not played under these
//! ids: they replay as refused.
//!
//! `cargo run --release -p reel-trace --example trace_copies -- OUT COUNT TRACES...`

use std::{env, error::Error, fs, path::Path};

use reel_trace::{Images, Recorder, Trace};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [out, count, paths @ ..] = arguments.as_slice() else {
        return Err("usage: trace_copies OUT COUNT TRACES...".into());
    };
    let traces = paths
        .iter()
        .map(|path| Trace::read(Path::new(path)))
        .collect::<Result<Vec<_>, _>>()?;
    if traces.is_empty() {
        return Err("no traces".into());
    }
    fs::create_dir_all(out)?;
    for number in 0..count.parse::<usize>()? {
        copy(
            &traces[number % traces.len()],
            number,
            &Path::new(out).join(format!("{number:06}.mcap")),
        )?;
    }
    Ok(())
}

fn copy(trace: &Trace, number: usize, path: &Path) -> Result<(), Box<dyn Error>> {
    let mut header = trace.header.clone();
    header.episode_id = format!("copy-{number:06}");
    let mut recorder = Recorder::create(path, &header, &trace.task, &trace.scene, Images::None)?;
    recorder.start(&trace.start, None)?;
    for record in &trace.steps {
        recorder.input(record.step, &record.input)?;
        recorder.step(record, None)?;
    }
    recorder.end(trace.end.as_ref().ok_or("a trace that breaks off")?)?;
    Ok(())
}
