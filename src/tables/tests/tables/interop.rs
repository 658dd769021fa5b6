//! Other people's tools on the store: PyPI readers of Delta Lake, and an S3-compatible server.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use reel_tables::{Store, Table};
use reel_trace::Images;
use reel_world::Family;
use tempfile::TempDir;

use crate::{ingest, play::success};

fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests")
        .join(name)
}

/// What each reader sees: its name and a JSON text.
fn readers(python: &Path, store: &str, environment: &[(&str, &str)]) -> Vec<(String, String)> {
    let mut command = Command::new(python);
    command.arg(script("check_readers.py")).arg(store);
    reel_vectors::run(command.envs(environment.iter().copied()))
        .lines()
        .map(|line| line.split_once(' ').unwrap())
        .map(|(name, seen)| (name.to_owned(), seen.to_owned()))
        .collect()
}

fn record(dir: &Path, seeds: std::ops::Range<u64>) -> Vec<PathBuf> {
    let record = |seed| {
        success("oracle", Family::FDP, seed)
            .record_as(&dir.join(format!("{seed}.mcap")), Images::None)
    };
    seeds.map(record).collect()
}

#[test]
fn deltalake_polars_and_duckdb_read_the_store() {
    let Some(python) = reel_vectors::python("deltalake, polars, duckdb, pyarrow") else {
        return;
    };
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("store");
    let mut store = Store::open_or_create(&folder).unwrap();
    ingest(&mut store, &record(dir.path(), 0..3));
    ingest(&mut store, &record(dir.path(), 3..5));
    let seen = readers(&python, folder.to_str().unwrap(), &[]);
    assert_eq!(
        seen.iter()
            .map(|(name, _)| name.as_str())
            .collect::<Vec<_>>(),
        ["deltalake", "polars", "duckdb", "tasks"]
    );
    let ids = (0..5)
        .map(|seed| format!("\"oracle-FDP-{seed}\""))
        .collect::<Vec<_>>()
        .join(", ");
    let steps = 6 * 5;
    for (reader, seen) in &seen[..3] {
        assert_eq!(*seen, format!("[[{ids}], {steps}]"), "{reader}");
    }
    assert_eq!(seen[3].1, "[1, true]");
}

/// A server that ends with this value.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_store_may_lie_in_a_bucket() {
    let modules = "moto.server, boto3, deltalake, polars, duckdb, pyarrow";
    let Some(python) = reel_vectors::python(modules) else {
        return;
    };
    let server = Command::new(&python)
        .arg(script("s3_server.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut server = Server(server);
    let mut port = String::new();
    BufReader::new(server.0.stdout.take().unwrap())
        .read_line(&mut port)
        .unwrap();
    let endpoint = format!("http://127.0.0.1:{}", port.trim());
    let environment = [
        ("AWS_ENDPOINT_URL", endpoint.as_str()),
        ("AWS_ACCESS_KEY_ID", "test"),
        ("AWS_SECRET_ACCESS_KEY", "test"),
        ("AWS_REGION", "us-east-1"),
        ("AWS_ALLOW_HTTP", "true"),
    ];
    let open = |version: Option<u64>| {
        let options = environment.map(|(name, value)| (name.to_owned(), value.to_owned()));
        let location = reel_tables::Location::parse_with("s3://reel/some/store", options).unwrap();
        Store::at(location, version)
    };
    let dir = TempDir::new().unwrap();
    let mut store = open(None).unwrap();
    assert_eq!(ingest(&mut store, &record(dir.path(), 0..3)), (3, 0, 0, 0));
    let version = store.version();
    assert_eq!(ingest(&mut store, &record(dir.path(), 0..5)), (2, 3, 0, 0));
    let seen = readers(&python, "s3://reel/some/store", &environment);
    assert!(
        seen.iter()
            .all(|(_, seen)| seen.contains("oracle-FDP-4") || seen == "[1, true]"),
        "{seen:?}"
    );
    store.compact().unwrap();
    assert_eq!(store.files(Table::Episodes).len(), 1);
    assert_eq!(open(Some(version)).unwrap().files(Table::Episodes).len(), 1);
    // two writers at a time
    std::thread::scope(|scope| {
        for part in [5..8, 7..10] {
            let (mut store, paths) = (open(None).unwrap(), record(dir.path(), part));
            scope.spawn(move || {
                for path in &paths {
                    ingest(&mut store, std::slice::from_ref(path));
                }
            });
        }
    });
    let seen = readers(&python, "s3://reel/some/store", &environment);
    let all = (0..10)
        .map(|seed| format!("\"oracle-FDP-{seed}\""))
        .collect::<Vec<_>>()
        .join(", ");
    assert!(seen[0].1.contains(&all), "{}", seen[0].1);
}
