//! A data folder that was moved: its tables learn where the traces are, and lose nothing.

use std::{
    fs,
    thread::sleep,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{expect, server::Server};

#[test]
fn a_moved_data_folder_serves_what_it_held() {
    let home = tempfile::tempdir().unwrap();
    let (before, after) = (home.path().join("before"), home.path().join("after"));
    fs::create_dir(&before).unwrap();
    reel!(&before, "task draw --count 2 --seed 5 --out tasks");
    reel!(
        &before,
        "run --tasks tasks --policy oracle --out data/traces"
    );
    reel!(&before, "ingest data/traces --store data/store");
    reel!(&before, "replay data/traces --store data/store");
    let episodes = "SELECT e.episode_id, e.trace, v.verdict, r.text FROM episodes e \
                    LEFT JOIN verdicts v ON v.trace_digest = e.trace_digest \
                    LEFT JOIN remarks r ON r.episode_id = e.episode_id ORDER BY e.episode_id";
    let rows = |folder| -> Vec<Value> {
        let text = expect(
            folder,
            0,
            &["query", "--store", "data/store", "--json", episodes],
        );
        serde_json::from_str(&text).unwrap()
    };
    let episode = rows(&before)[0]["episode_id"].as_str().unwrap().to_owned();
    reel!(
        &before,
        "store remark tag {episode} --text kept --author ann --store data/store"
    );
    let old = rows(&before);
    fs::rename(&before, &after).unwrap();

    let (server, began) = (Server::start(&after), Instant::now());
    let here = after.join("data/traces").canonicalize().unwrap();
    let known = |row: &Value| {
        let trace = row["trace"].as_str().unwrap();
        trace.starts_with(here.to_str().unwrap())
    };
    let moved = loop {
        let moved = rows(&after);
        if moved.iter().all(known) {
            break moved;
        }
        assert!(began.elapsed() < Duration::from_secs(90), "{moved:?}");
        sleep(Duration::from_millis(300));
    };
    drop(server);
    let name = |row: &Value| {
        let trace = row["trace"].as_str().unwrap();
        trace.rsplit('/').next().map(str::to_owned)
    };
    let facts = |rows: &[Value]| -> Vec<Value> {
        let facts = rows.iter().map(|row| {
            let (verdict, text) = (&row["verdict"], &row["text"]);
            json!([row["episode_id"], name(row), verdict, text])
        });
        facts.collect()
    };
    assert_eq!(facts(&moved), facts(&old));
    assert_eq!(old[0]["text"], "kept");
    assert!(old.iter().all(|row| row["verdict"] == "exact"), "{old:?}");
    let replayed = "SELECT count(*) AS n FROM episodes WHERE replay(trace).verdict = 'exact'";
    let counted = reel!(&after, "query --store data/store --format csv | {replayed}");
    assert_eq!(counted.lines().nth(1), Some("2"));
}
