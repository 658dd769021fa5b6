//! SQL that means harm, made at random from what it is made of: joins, subqueries, recursion,
//! windows, texts, arrays, regular expressions, functions of ours. Whatever comes, the answer comes
//! within the limits, and two seconds later the processor is idle and the memory is back.
//!
//! `REEL_SEEDS` says how many (`make hostile-sql`: 2,000), `REEL_SEED` the first; a line names the
//! worst. Alone in its process: others would be measured, too.

mod questions;

use std::{
    fs,
    time::{Duration, Instant},
};

use reel_query::{Limits, QuerySession};
use reel_tables::Store;
use reel_vectors::play::{self, success};
use reel_world::Family;
use tempfile::TempDir;

/// What a question may cost here.
const LIMITS: Limits = Limits {
    memory_bytes: 64 << 20,
    time: Duration::from_secs(2),
    rows: 100_000,
};
/// How long after its limit on time a question may answer: what plans it cannot be stopped. It is
/// late if both the clock and the processor say so: on a busy machine the clock runs ahead.
const LATE: Duration = Duration::from_secs(8);
/// How long each thread may compute after an answer, in ticks of the processor: time of this
/// process, so that other programs on the machine do not count.
const QUIET_TICKS: u64 = 200;
/// How much larger the process may stay: four times the memory of a question, what the allocator
/// keeps, and a batch of each thread.
fn growth_max() -> u64 {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    (512 + 128 * threads as u64) << 20
}
/// Seeds of a daily run.
const DAILY: u64 = 60;

/// Few enough rows to be begun, too many to end, and nothing is read once they are paired: only
/// what stands between the operators stops them.
const LONG: [&str; 3] = [
    "SELECT max(a.value + b.value) FROM generate_series(1, 300000) a, generate_series(1, 300000) b",
    "SELECT count(*) FROM generate_series(1, 300000) a JOIN generate_series(1, 300000) b ON a.value * b.value % 7 < b.value % 5",
    "SELECT max(a.value + t0.step + t1.step) FROM steps t0, steps t1, generate_series(1, 3000000) a",
];

#[test]
fn every_question_has_an_end() {
    let dir = TempDir::new().unwrap();
    let plays: Vec<_> = (1..=20)
        .map(|seed| success("oracle", Family::FDP, seed))
        .collect();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths = play::record_all(dir.path(), &plays);
    store.ingest(&paths, &|_, _| ()).unwrap();
    let session = QuerySession::with_limits(store, LIMITS).unwrap();
    session.run("SELECT count(*) FROM steps").unwrap();
    let seeds = std::env::var("REEL_SEEDS").map_or(DAILY, |seeds| seeds.parse().unwrap());
    let resident = resident_bytes();
    let (mut slowest, mut largest) = ((Duration::ZERO, String::new()), (0, String::new()));
    let (mut answered, mut wrong) = (0, Vec::new());
    let first = std::env::var("REEL_SEED").map_or(0, |seed| seed.parse().unwrap());
    let long = LONG
        .iter()
        .map(|sql| ("long".to_owned(), (*sql).to_owned()));
    let made =
        (first..first + seeds).map(|seed| (format!("seed {seed}"), questions::question(seed)));
    for (name, sql) in long.chain(made) {
        if seeds > DAILY {
            // What kills the process is named, too.
            eprintln!("{name}: {sql:.200}");
        }
        let (begun, ticks) = (Instant::now(), processor_ticks());
        let answer = session.run(&sql);
        let took = begun.elapsed();
        let computed = Duration::from_millis(10 * (processor_ticks() - ticks));
        answered += u64::from(answer.is_ok());
        let quiet = becomes_quiet();
        let grown = resident_bytes().saturating_sub(resident);
        slowest = slowest.max((took, name.clone()));
        largest = largest.max((grown, name.clone()));
        if took.min(computed) > LIMITS.time + LATE || !quiet || grown > growth_max() {
            let said = answer.map_or_else(|error| error.to_string(), |_| "answered".to_owned());
            wrong.push(format!(
                "{name}: {took:.1?}, quiet {quiet}, {} MiB larger, {said:.200}: {sql:.300}",
                grown >> 20
            ));
            // What goes on would be blamed on the next one.
            if !quiet || grown > growth_max() {
                break;
            }
        }
    }
    println!(
        "{seeds} questions, {answered} answered; slowest {:.1?} ({}), largest {} MiB more ({})",
        slowest.0,
        slowest.1,
        largest.0 >> 20,
        largest.1
    );
    assert!(
        wrong.is_empty(),
        "{} questions:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// Whether this process stops computing soon.
fn becomes_quiet() -> bool {
    let threads = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    let until = processor_ticks() + QUIET_TICKS * threads;
    loop {
        let before = processor_ticks();
        std::thread::sleep(Duration::from_millis(100));
        // A tick is 10 ms.
        if processor_ticks() - before <= 2 {
            return true;
        }
        if processor_ticks() > until {
            return false;
        }
    }
}

/// Ticks of the processor that this process took so far.
fn processor_ticks() -> u64 {
    let text = fs::read_to_string("/proc/self/stat").unwrap();
    let fields = text.rsplit(')').next().unwrap().split_whitespace();
    fields
        .skip(11)
        .take(2)
        .map(|ticks| ticks.parse::<u64>().unwrap())
        .sum()
}

fn resident_bytes() -> u64 {
    let text = fs::read_to_string("/proc/self/statm").unwrap();
    text.split_whitespace()
        .nth(1)
        .unwrap()
        .parse::<u64>()
        .unwrap()
        * 4096
}
