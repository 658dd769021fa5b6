//! Ingests that are killed, and two at a time: nothing is lost, nothing stands there in part.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Duration,
};

use crate::expect;

/// How many golden traces there are.
const GOLDEN: u64 = 68;

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden")
}

fn count(folder: &Path, sql: &str) -> u64 {
    let text = expect(folder, 0, &format!("query --format csv | {sql}"));
    text.lines()
        .nth(1)
        .expect("a row")
        .parse()
        .expect("a number")
}

/// Every episode is whole: its task and scene are there, and its steps and terms are
/// those of its length.
fn whole(folder: &Path) -> u64 {
    let episodes = count(folder, "SELECT count(*) FROM episodes");
    let joined = "SELECT count(*) FROM episodes e JOIN tasks t ON t.task_digest = e.task_digest \
                  JOIN scenes s ON s.scene_digest = e.scene_digest WHERE array_length(e.steps) = e.length";
    assert_eq!(count(folder, joined), episodes);
    assert_eq!(
        count(folder, "SELECT count(DISTINCT episode_id) FROM episodes"),
        episodes
    );
    assert_eq!(
        count(
            folder,
            "SELECT count(*) - count(DISTINCT task_digest) FROM tasks"
        ),
        0
    );
    episodes
}

#[test]
fn a_killed_ingest_leaves_nothing_in_part_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let traces = golden();
    let mut seen = std::collections::BTreeSet::new();
    for round in 0..24_u64 {
        if round % 6 == 0 {
            let _ = std::fs::remove_dir_all(folder.join("store"));
        }
        let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .args(["ingest", traces.to_str().unwrap()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(Duration::from_millis(20 + round * 23));
        child.kill().unwrap();
        child.wait().unwrap();
        if folder
            .join("store/episodes/_delta_log/00000000000000000000.json")
            .exists()
        {
            seen.insert(whole(folder));
        }
    }
    expect(folder, 0, &["ingest", traces.to_str().unwrap()]);
    assert_eq!(whole(folder), GOLDEN);
    assert!(
        seen.iter().all(|count| [0, GOLDEN].contains(count)),
        "one commit, whole or not at all: {seen:?}"
    );
    reel!(folder, "store reward --check");
}

#[test]
fn ingests_at_a_time_lose_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let traces = golden();
    let ingest = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_reel"));
        command
            .current_dir(folder)
            .args(["ingest", traces.to_str().unwrap()])
            .stdout(Stdio::null());
        command.spawn().unwrap()
    };
    let mut children = [ingest(), ingest(), ingest()];
    for child in &mut children {
        assert!(child.wait().unwrap().success());
    }
    assert_eq!(whole(folder), GOLDEN);
    assert!(reel!(folder, "store history").lines().count() >= 2);
    assert!(reel!(folder, "store compact").contains("version"));
    assert!(reel!(folder, "store vacuum --dry-run").contains("would be deleted"));
    assert_eq!(whole(folder), GOLDEN);
}

#[test]
fn one_weight_changes_the_episodes_in_which_it_paid() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    expect(folder, 0, &["ingest", golden().to_str().unwrap()]);
    std::fs::write(
        folder.join("mine.toml"),
        "name = \"mine\"\nbase = \"paper\"\n[weights]\nask = 0.25\n",
    )
    .unwrap();
    let listed = reel!(folder, "store reward --diff paper mine.toml --json");
    let paid = count(
        folder,
        "SELECT count(DISTINCT episode_id) FROM rewards WHERE component = 'ask'",
    );
    assert!(
        paid > 0 && listed.lines().count() as u64 == paid,
        "{paid}: {listed}"
    );
    assert!(
        listed
            .lines()
            .all(|line| line.contains(r#""components":{"ask":"#)),
        "{listed}"
    );
    assert!(
        reel!(folder, "store reward --preset mine.toml")
            .starts_with(&format!("{GOLDEN} episodes scored"))
    );
    assert!(
        reel!(folder, "store reward --preset mine.toml")
            .contains(&format!("{GOLDEN} had it already"))
    );
    let sums = "SELECT count(*) FROM rescored WHERE preset = 'mine'";
    assert_eq!(count(folder, sums), GOLDEN);
    // the same terms are not kept twice
    let recorded = count(
        folder,
        "SELECT count(*) FROM episodes WHERE preset = 'paper'",
    );
    let rows = count(
        folder,
        "SELECT count(*) FROM rewards WHERE preset = 'paper'",
    );
    assert!(
        recorded > 0
            && reel!(folder, "store reward --preset paper")
                .contains(&format!("{recorded} had it already"))
    );
    assert_eq!(
        count(
            folder,
            "SELECT count(*) FROM rewards WHERE preset = 'paper'"
        ),
        rows
    );
    // from tables as from traces
    reel!(folder, "store reward --preset real-trainer");
    let equal = "SELECT count(*) FROM rescored r JOIN episodes e ON e.episode_id = r.episode_id \
                 WHERE r.preset = 'real-trainer' AND r.total_reward = reward(e.trace, 'real-trainer')['total_reward']";
    let ended = "SELECT count(*) FROM episodes WHERE end_reason IS NOT NULL";
    assert_eq!(count(folder, equal), count(folder, ended));
    let listed = reel!(folder, "store reward --list");
    assert!(
        ["paper", "real-repo", "real-trainer"]
            .iter()
            .all(|preset| listed.contains(preset)),
        "{listed}"
    );
    expect(folder, 2, "store reward --preset nobody");
}
