//! Memory does not follow the size of a set.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
    thread,
    time::Duration,
};

use reel_data_profile::{DiffOptions, JoinHow, JoinOptions, ProfileOptions, diff, join, profile};
use tempfile::TempDir;

use crate::write::{lines, table};

/// Names the file for the process whose memory is measured.
const FILE: &str = "REEL_TEST_DATA_PROFILE_FILE";
const ROWS: u64 = 15_000;

fn set(folder: &Path, name: &str, rows: u64) -> PathBuf {
    // Texts that neither repeat nor compress.
    let row = |id: u64| {
        let mut state = id;
        let words = (0..60).map(|_| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            format!("{state:016x}")
        });
        let text: String = words.collect();
        format!(r#"{{"id": {id}, "text": "{text}"}}"#)
    };
    lines(folder, name, (0..rows).map(row))
}

/// Anonymous memory of this process in KiB; mapped files are the system's to keep.
fn resident() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("RssAnon:"));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    number.unwrap_or_default()
}

/// Runs in a process of its own, started by the test below.
#[test]
fn child() {
    let Some(path) = env::var_os(FILE).map(PathBuf::from) else {
        return;
    };
    let (peak, over) = (AtomicU64::new(0), AtomicBool::new(false));
    thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                peak.fetch_max(resident(), Ordering::Relaxed);
                thread::sleep(Duration::from_millis(2));
            }
        });
        let set = table(&path);
        profile(&set, &ProfileOptions::default()).unwrap();
        diff(&set, &set, &DiffOptions::default()).unwrap();
        let options = JoinOptions {
            on: vec!["id".to_owned()],
            how: JoinHow::Semi,
            out: path.with_extension("out.parquet"),
        };
        let few = lines(
            path.parent().unwrap(),
            "few.jsonl",
            [r#"{"id": 7}"#.to_owned()],
        );
        join(&set, &table(&few), &options).unwrap();
        over.store(true, Ordering::Relaxed);
    });
    println!("peak {}", peak.load(Ordering::Relaxed));
}

#[test]
fn four_times_the_rows_take_little_more_memory() {
    if resident() == 0 {
        reel_vectors::skip("linux", "no /proc/self/status");
        return;
    }
    let folder = TempDir::new().unwrap();
    let peak = |name: &str, rows: u64| {
        let path = set(folder.path(), name, rows);
        let mut child = Command::new(env::current_exe().unwrap());
        child.args(["--exact", "memory::child", "--nocapture"]);
        let output = child.env(FILE, &path).output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        let peak = said
            .split("peak ")
            .nth(1)
            .and_then(|it| it.split_whitespace().next());
        let peak: u64 = peak.unwrap_or_else(|| panic!("{said}")).parse().unwrap();
        (peak, fs::metadata(&path).unwrap().len() >> 10)
    };
    let (small, small_set) = peak("small.jsonl", ROWS);
    let (large, large_set) = peak("large.jsonl", 4 * ROWS);
    let grown = large.saturating_sub(small);
    println!("{small} KiB for {small_set} KiB, {large} KiB for {large_set} KiB");
    assert!(
        grown < (large_set - small_set) / 2,
        "{small} KiB for {small_set} KiB, {large} KiB for {large_set} KiB"
    );
}
