//! Random access in a large shard: packs a few traces many times, under other seeds and ids, then opens the
//! shard anew for each of a hundred episodes, by number and by id. What they hold was not played
//! under these seeds. Prints JSON.
//!
//! `cargo run --release -p reel-trace --example shard_access -- OUT COUNT TRACES...`

use std::{env, error::Error, fs, path::Path, time::Instant};

use reel_trace::{PackedEpisode, Shard, ShardWriter, Trace};

/// How many episodes are read.
const READS: u32 = 100;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [out, count, paths @ ..] = arguments.as_slice() else {
        return Err("usage: shard_access OUT COUNT TRACES...".into());
    };
    let (out, count) = (Path::new(out), count.parse::<u32>()?);
    let mut packed = Vec::new();
    for path in paths {
        let (trace, bytes) = (Trace::read(Path::new(path))?, fs::read(path)?);
        packed.push(PackedEpisode::of(&trace, &bytes, "trace.mcap")?);
    }
    if packed.is_empty() || count == 0 {
        return Err("no traces".into());
    }
    let before = Instant::now();
    let mut writer = ShardWriter::create(out)?;
    let mut wanted = Vec::new();
    for number in 0..count {
        let mut episode = packed[number as usize % packed.len()].clone();
        episode.header.seed = u64::from(number);
        episode.header = episode.header.identified();
        if number % count.div_ceil(READS) == 0 {
            // Far from the one before it.
            wanted.push((number, episode.header.episode_id.clone()));
        }
        writer.add(&episode)?;
    }
    let summary = writer.finish()?;
    let packed_s = before.elapsed().as_secs_f64();
    wanted.sort_by_key(|(number, _)| number.wrapping_mul(0x9e37_79b9));
    let read = |name: &str| -> Result<f64, Box<dyn Error>> {
        let before = Instant::now();
        let shard = Shard::open(out)?;
        shard.episode(shard.find(name)?)?;
        Ok(before.elapsed().as_secs_f64() * 1e3)
    };
    let times = |names: Vec<String>| -> Result<[f64; 2], Box<dyn Error>> {
        let mut times = names
            .iter()
            .map(|name| read(name))
            .collect::<Result<Vec<f64>, _>>()?;
        times.sort_by(f64::total_cmp);
        Ok([times[times.len() / 2], times[times.len() - 1]])
    };
    let by_number = times(
        wanted
            .iter()
            .map(|(number, _)| number.to_string())
            .collect(),
    )?;
    let by_id = times(wanted.into_iter().map(|(_, id)| id).collect())?;
    println!(
        "{{\"episodes\": {}, \"bytes\": {}, \"packed_s\": {packed_s:.1}, \"by_number_ms\": {by_number:?}, \"by_id_ms\": {by_id:?}}}",
        summary.episodes, summary.bytes
    );
    Ok(())
}
