//! A scheduler and executors as processes of this machine: commands give with them what
//! they give without. `make cluster` does the same on machines of their own, with a bucket,
//! and lets machines die.

use std::{
    fs,
    net::{TcpListener, TcpStream},
    path::Path,
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::{complaint, expect, reel};

/// A process that ends with this value.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An address that nobody listens at.
fn free() -> String {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .to_string()
}

/// Starts a process of a cluster and waits until it listens.
fn start(folder: &Path, listen: &str, arguments: &[&str]) -> Process {
    let mut command = Command::new(env!("CARGO_BIN_EXE_reel"));
    command
        .current_dir(folder)
        .arg("cluster")
        .args(arguments)
        .args(["--listen", listen]);
    let process = Process(
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let begun = Instant::now();
    while TcpStream::connect(listen).is_err() {
        assert!(
            begun.elapsed() < Duration::from_secs(60),
            "nobody listens at {listen}"
        );
        thread::sleep(Duration::from_millis(50));
    }
    process
}

fn executor(folder: &Path, scheduler: &str) -> Process {
    let traces = folder.join("traces");
    start(
        folder,
        &free(),
        &[
            "executor",
            "--scheduler",
            scheduler,
            "--threads",
            "1",
            "--traces",
            traces.to_str().unwrap(),
        ],
    )
}

#[test]
fn a_cluster_gives_what_one_machine_gives() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let is_long = reel_vectors::is_long();
    let tasks = if is_long { 4 } else { 2 };
    reel!(folder, "task draw --count {tasks} --seed 3 --out tasks");
    for policy in ["oracle", "wrong-object"] {
        reel!(
            folder,
            "run --tasks tasks --policy {policy} --out traces --no-images"
        );
    }
    let mut damaged = fs::read(crate::first_trace(folder)).unwrap();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    fs::write(folder.join("traces/damaged.mcap"), damaged).unwrap();

    let scheduler = free();
    let nobody = complaint(folder, 2, &format!("replay traces --cluster {scheduler}"));
    assert!(nobody.contains("no scheduler answers"), "{nobody}");
    // A busy executor is heard of every five seconds.
    let refused = complaint(folder, 2, "cluster scheduler --executor-timeout 4");
    assert!(refused.contains("10.."), "{refused}");
    let _scheduler = start(
        folder,
        &scheduler,
        &["scheduler", "--executor-timeout", "10"],
    );
    let (_one, two) = (executor(folder, &scheduler), executor(folder, &scheduler));
    let traces = folder.join("traces");
    let traces = traces.to_str().unwrap();
    let same = |code: i32, arguments: &[&str]| {
        let alone = expect(folder, code, arguments);
        assert_eq!(
            expect(
                folder,
                code,
                &[arguments, &["--cluster", &scheduler]].concat()
            ),
            alone,
            "reel {arguments:?}"
        );
    };

    let alone = expect(folder, 3, &format!("ingest {traces} --store alone --json"));
    let together = expect(
        folder,
        3,
        &format!("ingest {traces} --store store --json --cluster {scheduler}"),
    );
    assert_eq!(alone, together);
    assert!(
        alone.contains(&format!(r#""added":{}"#, 2 * tasks)) && alone.contains("damaged.mcap"),
        "{alone}"
    );
    same(1, &["replay", traces, "--json"]);
    same(1, &["blame", traces, "--json"]);
    same(0, &["store", "reward", "--store", "store", "--check"]);
    same(0, &["taxonomy", "--store", "store", "--dry-run", "--json"]);
    if is_long {
        same(1, &["replay", traces, "--outcomes"]);
        let reward = ["store", "reward", "--store", "store"];
        same(
            0,
            &[&reward[..], &["--diff", "paper", "real-repo"]].concat(),
        );
        let query = ["query", "--store", "store", "--format", "csv"];
        same(0, &[&query[..], &["--named", "failures"]].concat());
    }
    let questions = [
        // two relations that turn out empty, one of them beside another
        "SELECT component, count(*) FROM rewards WHERE version IS NULL GROUP BY component ORDER BY component",
        "SELECT policy FROM episodes WHERE false",
        "SELECT family, count(*) FROM episodes WHERE replay(trace).verdict = 'exact' GROUP BY family ORDER BY family",
        "SELECT episode_id, blame(trace).cause FROM episodes ORDER BY episode_id",
        "SELECT tool, count(*) FROM steps JOIN episodes USING (episode_id) GROUP BY tool ORDER BY tool",
    ];
    let asked = if is_long { questions.len() } else { 2 };
    for sql in &questions[..asked] {
        same(0, &["query", "--store", "store", "--format", "csv", sql]);
    }
    for sql in [
        "DROP TABLE episodes",
        "SELECT replay('/etc/passwd')",
        "SELECT nothing FROM episodes",
    ] {
        complaint(
            folder,
            2,
            &["query", "--store", "store", sql, "--cluster", &scheduler],
        );
    }
    fs::create_dir(folder.join("elsewhere")).unwrap();
    fs::copy(
        folder.join("traces/damaged.mcap"),
        folder.join("elsewhere/other.mcap"),
    )
    .unwrap();
    let refused = complaint(
        folder,
        2,
        &format!("replay elsewhere --cluster {scheduler}"),
    );
    assert!(
        refused.contains("may not open") && refused.contains("--traces"),
        "{refused}"
    );

    // with one of two gone, what it had begun is done by the other
    drop(two);
    same(1, &["replay", traces]);
    let kept = expect(
        folder,
        1,
        &format!("blame {traces} --branches here --json --cluster {scheduler}"),
    );
    let there = reel(folder, &format!("blame {traces} --branches there --json"));
    assert_eq!(
        kept.replace("here/", "there/"),
        String::from_utf8_lossy(&there.stdout)
    );
    let mut branches: Vec<_> = fs::read_dir(folder.join("here"))
        .unwrap()
        .map(|file| file.unwrap().file_name())
        .collect();
    branches.sort();
    assert!(!branches.is_empty());
    for branch in branches {
        let read = |place: &str| fs::read(folder.join(place).join(&branch)).unwrap();
        assert!(read("here") == read("there"), "{branch:?}");
    }
}

/// Strangers at each port of a cluster with identities.
#[test]
fn a_cluster_knows_its_members() {
    crate::service::script("cluster/identity.py", &[]);
}
