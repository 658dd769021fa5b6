//! The service in a world that is made up: its disk fills, fails and loses power, its wires stall
//! and break, it is killed at any of its operations, and time is what the runtime says it is.
//! Whatever happens: what was acknowledged is on the disk, nothing is replaced, no world is shared.
//!
//! `REEL_SEEDS` says how many worlds (`make simulate`: 10,000), `REEL_SEED` the first. A seed gives
//! the same world again.

mod client;
mod disk;
mod ledger;
mod network;
mod rng;

use std::{
    collections::BTreeMap,
    env,
    panic::{self, AssertUnwindSafe},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use axum::body::Bytes;
use reel_live::{Host, Work};
use reel_replay::verify_trace;
use reel_server::{AnswerSources, Config, Limits, Play, Service};
use reel_trace::TraceFiles;
use tempfile::TempDir;
use tokio::{runtime::Builder, sync::oneshot, task::JoinSet};

use crate::{
    client::{Client, FORGOTTEN_AFTER},
    disk::{DiskFaults, SimulatedDisk},
    ledger::Ledger,
    network::network,
    rng::SeededRng,
};

/// Worlds of a daily run.
const DAILY: u64 = 120;
/// One in so many worlds has its traces replayed.
const REPLAYED_ONCE_IN: u64 = 20;
/// Number of the last process of a world, which has no faults, and calls of its one client.
const LAST: u64 = 99;
const LAST_CALLS: u64 = 3;
/// Task of the leases, one of those that are served.
const TASK: &str = "SUL/home_0001";

/// What is the same in all worlds.
struct Fixtures {
    folder: TempDir,
    samples: Vec<Bytes>,
}

/// One world, from the first process to the last.
struct World<'g> {
    seed: u64,
    fixtures: &'g Fixtures,
    rng: SeededRng,
    disk: SimulatedDisk,
    ledger: Arc<Mutex<Ledger>>,
    durability: &'static str,
    counts: Counts,
}

/// What happened in worlds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
struct Counts {
    processes: u64,
    killed: u64,
    powerless: u64,
    full: u64,
    failing: u64,
    operations: u64,
    acknowledged: u64,
    uploads: u64,
    replayed: u64,
}

/// How a process ends.
#[derive(Clone, Copy, Debug)]
enum Ending {
    /// When its clients are done, or after this time if that is sooner: it is asked to.
    Asked(Duration),
    /// Killed with this operation of the disk.
    Operation(u64),
    /// Killed after this time.
    Time(Duration),
    /// Killed when its tasks were awake so many times in turn.
    Turns(u64),
}

impl Ending {
    fn any(rng: &mut SeededRng) -> Self {
        match rng.below(6) {
            0 => Self::Asked(Duration::from_millis(rng.below(200_000))),
            1 => Self::Time(Duration::from_millis(rng.below(60_000))),
            2 => Self::Turns(rng.below(2_000)),
            _ => Self::Operation(1 + rng.below(250)),
        }
    }
}

#[test]
fn what_was_acknowledged_is_on_the_disk() {
    let fixtures = fixtures();
    let number = |name: &str| {
        env::var(name)
            .ok()
            .map(|value| value.parse().expect("a number"))
    };
    let (first, count): (u64, u64) = (
        number("REEL_SEED").unwrap_or(0),
        number("REEL_SEEDS").unwrap_or(DAILY),
    );
    let (next, begun) = (AtomicU64::new(first), Instant::now());
    let (counts, violations) = (Mutex::new(Counts::default()), Mutex::new(Vec::new()));
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + count {
                break;
            }
            let world = || World::new(seed, &fixtures).run();
            let Ok((happened, wrong, _)) = panic::catch_unwind(AssertUnwindSafe(world)) else {
                println!("seed {seed}: it panicked");
                violations.lock().unwrap().push(seed);
                continue;
            };
            counts.lock().unwrap().add(happened);
            for violation in wrong {
                println!("seed {seed}: {violation}");
                violations.lock().unwrap().push(seed);
            }
            if (seed - first + 1).is_multiple_of(1_000) {
                println!(
                    "{} worlds, {} s",
                    seed - first + 1,
                    begun.elapsed().as_secs()
                );
            }
        }
    };
    let workers = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| (0..workers).for_each(|_| drop(scope.spawn(work))));
    let counts = counts.into_inner().unwrap();
    println!(
        "{count} worlds in {:.0} s: {counts:?}",
        begun.elapsed().as_secs_f64()
    );
    let mut violations = violations.into_inner().unwrap();
    violations.sort_unstable();
    violations.dedup();
    assert!(
        violations.is_empty(),
        "worlds that broke a promise: {violations:?}; one again: REEL_SEED=N REEL_SEEDS=1 make simulate"
    );
    // A server that refuses everything keeps every promise.
    if count >= DAILY {
        assert!(
            counts.acknowledged > 0 && counts.uploads > 0 && counts.replayed > 0,
            "nothing was acknowledged: {counts:?}"
        );
    }
}

#[test]
fn a_seed_gives_the_same_world_again() {
    let fixtures = fixtures();
    for seed in 0..24 {
        let [one, other] = [(); 2].map(|()| World::new(seed, &fixtures).run());
        assert_eq!(one, other, "seed {seed}");
    }
}

fn is_trace(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "mcap")
}

fn fixtures() -> Fixtures {
    let folder = TempDir::new().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden");
    let mut traces: Vec<PathBuf> = golden
        .read_dir()
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| is_trace(path))
        .collect();
    traces.sort_by_key(|path| path.metadata().unwrap().len());
    let samples = traces[..3]
        .iter()
        .map(|path| std::fs::read(path).unwrap().into());
    Fixtures {
        samples: samples.collect(),
        folder,
    }
}

impl Counts {
    fn add(&mut self, other: Self) {
        self.processes += other.processes;
        self.killed += other.killed;
        self.powerless += other.powerless;
        self.full += other.full;
        self.failing += other.failing;
        self.operations += other.operations;
        self.acknowledged += other.acknowledged;
        self.uploads += other.uploads;
        self.replayed += other.replayed;
    }
}

impl<'g> World<'g> {
    fn new(seed: u64, fixtures: &'g Fixtures) -> Self {
        let mut rng = SeededRng::new(seed, "world");
        Self {
            seed,
            fixtures,
            disk: SimulatedDisk::new(seed),
            ledger: Arc::new(Mutex::new(Ledger::new(
                fixtures.samples.clone(),
                TASK.to_owned(),
            ))),
            durability: *rng.pick(&["write", "fsync"]),
            rng,
            counts: Counts::default(),
        }
    }

    /// What happened, what may not have, and a digest of all of it.
    fn run(mut self) -> (Counts, Vec<String>, [blake3::Hash; 2]) {
        let mut violations = Vec::new();
        let mut finished: BTreeMap<PathBuf, blake3::Hash> = BTreeMap::new();
        for generation in 0..=self.rng.below(3) {
            let mut faults = DiskFaults::default();
            if self.rng.once_in(4) {
                faults.room = Some(self.rng.below(400_000));
                self.counts.full += 1;
            }
            if self.rng.once_in(5) {
                faults.fails_once_in = Some(20 + self.rng.below(200));
                self.counts.failing += 1;
            }
            let ending = Ending::any(&mut self.rng);
            if let Ending::Operation(operation) = ending {
                faults.dies_at = Some(operation);
            }
            let killed = self.process(generation, faults, ending, &mut violations);
            if killed {
                self.counts.killed += 1;
                if self.rng.once_in(2) {
                    self.counts.powerless += 1;
                    if self.durability == "write" {
                        self.ledger.lock().unwrap().power_lost();
                    }
                    self.disk.power_lost();
                }
            }
            self.check_unchanged(&mut finished, &mut violations);
        }
        let before = self.ledger.lock().unwrap().answers();
        let ending = Ending::Asked(Duration::MAX);
        self.process(LAST, DiskFaults::default(), ending, &mut violations);
        if self.ledger.lock().unwrap().answers() - before != LAST_CALLS as usize {
            violations.push("after all faults a client without any was not answered".to_owned());
        }
        self.check_unchanged(&mut finished, &mut violations);
        self.disk.begin(DiskFaults::default());
        let files = TraceFiles::on(Arc::new(self.disk.clone()));
        let content = self.disk.files();
        let mut ledger = self.ledger.lock().unwrap();
        violations.extend(ledger.audit(&files, &content));
        if self.seed.is_multiple_of(REPLAYED_ONCE_IN) {
            for path in content.keys() {
                let Ok(trace) = files.read(path) else {
                    continue;
                };
                self.counts.replayed += 1;
                let verdict = verify_trace(&trace);
                if !verdict.is_exact() {
                    violations.push(format!("{}: {}", path.display(), verdict.name()));
                }
            }
        }
        self.counts.acknowledged = ledger.acknowledged() as u64;
        self.counts.uploads = ledger.kept() as u64;
        let digests = [ledger.events(), self.disk.history()];
        drop(ledger);
        (self.counts, violations, digests)
    }

    /// What is finished and synced stays as it is, byte for byte, as long as nobody deletes it.
    fn check_unchanged(
        &self,
        finished: &mut BTreeMap<PathBuf, blake3::Hash>,
        violations: &mut Vec<String>,
    ) {
        let files = self.disk.files();
        for (path, digest) in &*finished {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            match files.get(path) {
                Some(bytes) if blake3::hash(bytes) == *digest => {}
                None if name.starts_with("own-") => {}
                // Another upload took its name after a deletion.
                Some(_) if name.starts_with("own-") => {}
                Some(_) => violations.push(format!("{name} was replaced")),
                None => violations.push(format!("{name} is gone")),
            }
        }
        let durable = self.disk.durable_files().into_iter();
        *finished = durable
            .filter(|(path, _)| is_trace(path))
            .map(|(path, bytes)| (path, blake3::hash(&bytes)))
            .collect();
    }

    fn config(&mut self, generation: u64) -> Config {
        let run = if self.rng.once_in(2) {
            "sim".to_owned()
        } else {
            format!("sim{generation}")
        };
        Config {
            // The folder is on a disk that no other process sees.
            ingest_new: Some(false),
            data: self
                .fixtures
                .folder
                .path()
                .join(format!("data-{}", self.seed)),
            log_filter: "off".to_owned(),
            play: Play {
                seed: 1,
                run: Some(run),
                images: self.rng.once_in(8),
                durability: self.durability.to_owned(),
                ..Play::default()
            },
            limits: Limits {
                sessions: 6,
                simulators: 1 + self.rng.below(3) as usize,
                workers: 1 + self.rng.below(2) as usize,
                suspend_after_s: 10,
                close_after_s: FORGOTTEN_AFTER.as_secs(),
                ..Limits::default()
            },
            ..Config::default()
        }
    }

    /// A process of the server with its clients; whether it was killed.
    fn process(
        &mut self,
        generation: u64,
        faults: DiskFaults,
        ending: Ending,
        violations: &mut Vec<String>,
    ) -> bool {
        self.counts.processes += 1;
        let is_last = generation == LAST;
        self.ledger.lock().unwrap().faults = !is_last;
        self.disk.begin(faults);
        let config = self.config(generation);
        let runtime = Builder::new_current_thread()
            .enable_time()
            .start_paused(true)
            .build()
            .unwrap();
        let host = Host {
            disk: Arc::new(self.disk.clone()),
            work: Work::Tasks,
        };
        let clients = if is_last { 1 } else { 1 + self.rng.below(4) };
        let client = |network, number: u64| Client {
            network,
            ledger: self.ledger.clone(),
            rng: SeededRng::new(self.seed, &format!("client {generation} {number}")),
            faults: !is_last,
        };
        let disk = self.disk.clone();
        let killed = runtime.block_on(async {
            let (network, connections) = network();
            let listen = async { Ok(connections) };
            let service = Service::start_on(
                host,
                config,
                TraceFiles::default(),
                AnswerSources::default(),
                listen,
            )
            .await
            .expect("the configuration is right");
            // Clients are shown every trace from now on.
            if faults.fails_once_in.is_none() && faults.dies_at.is_none() {
                let (shown, durable) = (disk.files(), disk.durable_files());
                let traces = shown.into_keys().filter(|path| is_trace(path));
                violations.extend(
                    traces
                        .filter(|path| !durable.contains_key(path))
                        .map(|path| format!("{} is shown, not synced", path.display())),
                );
            }
            let (stop, stopped) = oneshot::channel::<()>();
            let mut served = tokio::spawn(service.run(async { drop(stopped.await) }));
            let mut playing = JoinSet::new();
            for number in 0..clients {
                let client = client(network.clone(), number);
                if number % 2 == 1 {
                    playing.spawn(client.keep_traces(format!("own-{number}"), 8));
                } else {
                    let policy = format!("agent-{generation:02}");
                    let calls = if is_last { LAST_CALLS } else { 7 };
                    playing.spawn(client.play(format!("a{number}"), policy, calls));
                }
            }
            let asked = async {
                let patience = match ending {
                    Ending::Asked(after) => after,
                    _ => Duration::MAX,
                };
                let all = async { while playing.join_next().await.is_some() {} };
                let _ = tokio::time::timeout(patience, all).await;
                drop(stop);
                (&mut served).await.expect("the server ends in order");
            };
            tokio::select! {
                biased;
                () = disk.died() => true,
                () = comes(ending) => true,
                () = asked => false,
            }
        });
        // Nothing that is dropped now reaches the disk.
        self.disk.end();
        self.counts.operations += self.disk.operations();
        drop(runtime);
        killed
    }
}

/// Waits until a process is to be killed.
async fn comes(ending: Ending) {
    match ending {
        Ending::Time(after) => tokio::time::sleep(after).await,
        Ending::Turns(turns) => {
            for _ in 0..turns {
                tokio::task::yield_now().await;
            }
        }
        Ending::Asked(_) | Ending::Operation(_) => std::future::pending().await,
    }
}
