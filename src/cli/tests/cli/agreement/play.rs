//! The episodes, and the ways that each comes in: played here, served to an agent, recorded on the
//! way, written as the evaluation client does and read back.

use std::{
    fs::{self, File},
    io::{BufRead as _, BufReader, Write as _},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use reel_agents::POLICIES;
use reel_trace::Trace;
use serde_json::{Value, json};

const FAMILIES: [&str; 4] = ["FDP", "FODP", "FDO", "SUL"];
/// The profiles whose servers the policies of the long test meet.
const PROFILES: [&str; 3] = ["paper", "real-repo", "real-gspo"];

/// Episodes of one profile and seed: who plays which tasks.
pub(super) struct Batch {
    profile: &'static str,
    seed: u64,
    /// Policies, and the files that each plays.
    plays: Vec<(&'static str, String)>,
}

impl Batch {
    fn name(&self) -> String {
        format!("{}-{}", self.profile, self.seed)
    }
}

/// Each policy once with the published server, and every other one with the paper's, too: together
/// they play all families. With these seeds the explorer asks for another task, and `gibberish`
/// gives arguments that are a list.
pub(super) fn short() -> Vec<Batch> {
    let of = |profile, seed, plays: &dyn Fn(usize) -> Option<usize>| {
        let play = |(index, (policy, _)): (usize, &(&'static str, &str))| {
            let family = FAMILIES[plays(index)? % 4];
            Some((*policy, format!("tasks/{}/{family}", super::SCENES[0])))
        };
        Batch {
            profile,
            seed,
            plays: POLICIES.iter().enumerate().filter_map(play).collect(),
        }
    };
    vec![
        of("real-repo", 1, &|index| {
            (index % 2 == 0).then_some(index + 1)
        }),
        of("real-repo", 2, &|index| {
            (index % 2 == 1).then_some(index + 1)
        }),
        of("paper", 1, &|index| {
            (index % 2 == 1).then_some(index / 2 + 3)
        }),
    ]
}

/// Every policy with every family, home, profile and seed.
pub(super) fn long(seeds: u64) -> Vec<Batch> {
    let all = |profile, seed| Batch {
        profile,
        seed,
        plays: POLICIES
            .iter()
            .map(|(policy, _)| (*policy, "tasks".to_owned()))
            .collect(),
    };
    let of_seed = |seed| PROFILES.map(|profile| all(profile, seed));
    (1..=seeds).flat_map(of_seed).collect()
}

/// The traces that a server would serve, and which are of the same episode.
pub(super) struct Archive<'a> {
    folder: &'a Path,
    pub(super) traces: Vec<Trace>,
    pub(super) pairs: Vec<Pair>,
}

/// Two traces of one episode.
pub(super) struct Pair {
    /// How the second one came in.
    pub(super) kind: &'static str,
    pub(super) one: usize,
    pub(super) other: usize,
    /// What was said when it came in.
    pub(super) notes: String,
}

/// The name of a trace in the archive.
pub(super) fn name(index: usize) -> String {
    format!("t{index:04}")
}

/// The place of a trace in the archive, by its path in a table.
pub(super) fn index_of(path: &str) -> usize {
    let stem = Path::new(path).file_stem().unwrap().to_str().unwrap();
    stem[1..].parse().unwrap()
}

impl<'a> Archive<'a> {
    pub(super) fn new(folder: &'a Path) -> Self {
        fs::create_dir_all(folder.join("data/traces")).unwrap();
        Self {
            folder,
            traces: Vec::new(),
            pairs: Vec::new(),
        }
    }

    fn add(&mut self, path: &Path) -> usize {
        let index = self.traces.len();
        let file = format!("data/traces/{}.mcap", name(index));
        fs::copy(path, self.folder.join(file)).unwrap();
        self.traces.push(Trace::read(path).unwrap());
        index
    }

    fn pair(&mut self, kind: &'static str, one: usize, other: usize, notes: String) {
        self.pairs.push(Pair {
            kind,
            one,
            other,
            notes,
        });
    }
}

/// The traces in a folder, by name.
fn traces(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "mcap"));
    paths.sort();
    paths
}

/// Plays a batch; sends it through the evaluation client's files and, if a published server plays
/// it, through a recorder.
pub(super) fn play(archive: &mut Archive<'_>, batch: &Batch) {
    let Batch {
        profile,
        seed,
        plays,
    } = batch;
    let (folder, name) = (archive.folder, batch.name());
    for (policy, tasks) in plays {
        reel!(
            folder,
            "run --tasks {tasks} --scene-dir tasks --policy {policy} --seed {seed} --profile {profile} --out own/{name} --no-images"
        );
    }
    let own: Vec<usize> = traces(&folder.join("own").join(&name))
        .iter()
        .map(|path| archive.add(path))
        .collect();
    import(archive, &format!("own/{name}"), &name, &own);
    if *profile != "paper" {
        record(archive, batch, &own);
    }
}

/// Plays episodes with injected faults, one for each kind and some with two. Each has files of its
/// own: they have one policy, and their tasks may hold an object more than their files.
pub(super) fn play_faults(archive: &mut Archive<'_>, seed: u64) {
    let folder = archive.folder;
    let out = format!("faulty/{seed}");
    reel!(
        folder,
        "agent faults run --tasks tasks --scene-dir tasks --episodes 48 --double-share 0.2 --repaired-share 0.2 --seed {seed} --out {out}"
    );
    for path in traces(&folder.join(out)) {
        let own = archive.add(&path);
        let path = path.to_str().unwrap();
        import(archive, path, &format!("fault-{own}"), &[own]);
    }
}

/// Writes traces as the evaluation client does, and reads its files.
fn import(archive: &mut Archive<'_>, from: &str, name: &str, own: &[usize]) {
    let folder = archive.folder;
    reel!(
        folder,
        "export real-eval {from} --out eval/{name} --run-tag t"
    );
    let reports = reel!(
        folder,
        "import real-eval eval/{name} --out imported/{name} --run {name} --tasks tasks --scene-dir tasks --json"
    );
    assert_eq!(reports.lines().count(), own.len(), "{name}\n{reports}");
    for report in reports.lines() {
        let report: Value = serde_json::from_str(report).unwrap();
        let path = folder.join(report["trace"].as_str().unwrap());
        let other = archive.add(&path);
        let of = |trace: &Trace| {
            (
                trace.header.task_id.clone(),
                trace.header.policy.name.clone(),
            )
        };
        let known = of(&archive.traces[other]);
        let one = own.iter().find(|one| of(&archive.traces[**one]) == known);
        let one = *one.unwrap_or_else(|| panic!("nobody played {known:?} in {name}"));
        archive.pair("imported", one, other, report["notes"].to_string());
    }
}

/// Makes the calls of a batch to a server, through a recorder.
fn record(archive: &mut Archive<'_>, batch: &Batch, own: &[usize]) {
    let (folder, name) = (archive.folder, batch.name());
    let log = folder.join(format!("{name}.log"));
    let mut agent = Agent::start(folder, batch, &log);
    for index in own {
        let trace = &archive.traces[*index];
        agent.call("finish_with_id", &json!({ "task_id": trace.task.task_id }));
        for step in &trace.steps {
            agent.call(&step.input.call.name, &step.input.call.arguments);
        }
    }
    agent.end();
    // A `finish` begins the next episode, which is given up for the one that is wanted.
    let mut played = |folder: PathBuf| -> Vec<(PathBuf, usize)> {
        let mut paths = traces(&folder);
        paths.retain(|path| !Trace::read(path).unwrap().steps.is_empty());
        let added = paths
            .iter()
            .map(|path| archive.add(path))
            .collect::<Vec<_>>();
        paths.into_iter().zip(added).collect()
    };
    let served = played(folder.join(format!("served/{name}/traces")));
    let recorded = played(folder.join(format!("recorded/{name}")));
    assert_eq!(
        (served.len(), recorded.len()),
        (own.len(), own.len()),
        "{name}"
    );
    let log = fs::read_to_string(&log).unwrap();
    for ((own, (_, served)), (path, recorded)) in own.iter().zip(&served).zip(&recorded) {
        let file = path.file_name().unwrap().to_str().unwrap();
        let notes: String = log.lines().filter(|line| line.contains(file)).collect();
        archive.pair("recorded", *served, *recorded, notes);
        // A session has no decision where the call was for the session, or was none.
        if calls(&archive.traces[*own]) == calls(&archive.traces[*served]) {
            archive.pair("served", *own, *served, String::new());
        }
    }
}

fn calls(trace: &Trace) -> Vec<(&str, &Value)> {
    let steps = trace.steps.iter().map(|step| &step.input.call);
    steps
        .map(|call| (call.name.as_str(), &call.arguments))
        .collect()
}

/// An agent over standard input and output, with a recorder between it and a server.
struct Agent {
    child: Child,
    calls: ChildStdin,
    answers: BufReader<ChildStdout>,
    id: u64,
}

impl Agent {
    fn start(folder: &Path, batch: &Batch, log: &Path) -> Self {
        let reel = env!("CARGO_BIN_EXE_reel");
        let (name, profile, seed) = (batch.name(), batch.profile, batch.seed);
        let recorder = format!(
            "record --out recorded/{name} --run {name} --policy agent --profile {profile} \
             --tasks tasks --scene-dir tasks --no-images --stdio --"
        );
        let server = format!(
            "mcp --data served/{name} --run {name} --policy agent --profile {profile} \
             --tasks tasks --seed {seed} --no-images"
        );
        let mut child = Command::new(reel)
            .current_dir(folder)
            .env_remove("REEL_CONFIG")
            .args(recorder.split_whitespace())
            .arg(reel)
            .args(server.split_whitespace())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(File::create(log).unwrap())
            .spawn()
            .unwrap();
        let (calls, answers) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let mut agent = Self {
            child,
            calls,
            answers: BufReader::new(answers),
            id: 0,
        };
        agent.ask(
            "initialize",
            &json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "agent", "version": "1"}}),
        );
        agent.send(&json!({"jsonrpc": "2.0", "method": "notifications/initialized"}));
        agent
    }

    fn send(&mut self, message: &Value) {
        writeln!(self.calls, "{message}").unwrap();
        self.calls.flush().unwrap();
    }

    /// Asks, and reads until the answer has come.
    fn ask(&mut self, method: &str, params: &Value) {
        self.id += 1;
        let id = self.id;
        self.send(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        loop {
            let mut line = String::new();
            let read = self.answers.read_line(&mut line).unwrap();
            assert!(read > 0, "the recorder ended during {method} {params}");
            let message: Value = serde_json::from_str(&line).unwrap();
            if message["id"] == id {
                return;
            }
        }
    }

    fn call(&mut self, tool: &str, arguments: &Value) {
        self.ask("tools/call", &json!({"name": tool, "arguments": arguments}));
    }

    fn end(self) {
        let Self {
            mut child,
            calls,
            answers,
            ..
        } = self;
        drop(calls);
        assert!(child.wait().unwrap().success());
        drop(answers);
    }
}
