//! A run in one file, from `reel bench` to `reel verify`: what holds, what does not, and what a stranger's tools say of it.

use std::{fs, path::Path, process::Command};

use serde_json::Value;

use crate::{complaint, expect};

/// Four tasks that the planner played, and the bundle of them, signed.
fn bundled(folder: &Path) {
    reel!(folder, "task generate --count 4 --seed 7 --out tasks");
    reel!(
        folder,
        "bench --tasks tasks --agent planner --out bench/planner"
    );
    reel!(folder, "key new lab --comment laboratory");
    reel!(
        folder,
        "bundle bench/planner --tasks tasks --key lab --out planner.reel"
    );
}

fn verified(folder: &Path, code: i32, arguments: &str) -> Vec<Value> {
    let lines = expect(folder, code, &format!("verify --json {arguments}"));
    let json = |line: &str| serde_json::from_str(line).unwrap();
    lines.lines().map(json).collect()
}

#[test]
fn a_run_is_bundled_and_whoever_has_it_verifies_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    bundled(folder);
    let text = reel!(folder, "verify planner.reel --tasks tasks --signer lab.pub");
    assert!(
        text.starts_with("planner.reel: HOLDS: \"planner\" of \"planner\": success "),
        "{text}"
    );
    assert!(
        text.contains("all 4 episodes executed again") && text.contains("Not proven: "),
        "{text}"
    );

    // A sample is drawn anew each time, and by its seed once more.
    let sampled = &verified(folder, 0, "planner.reel --sample 50%")[0];
    assert_eq!(sampled["executed"]["episodes"].as_array().unwrap().len(), 2);
    assert_eq!(sampled["miss_probability"]["1"], 0.5);
    let seed = &sampled["executed"]["seed"];
    let again = &verified(
        folder,
        0,
        &format!("planner.reel --sample 0.5 --seed {seed}"),
    )[0];
    assert_eq!(again["executed"], sampled["executed"]);

    // Signed by another key than demanded.
    reel!(folder, "key new other");
    let other = &verified(folder, 1, "planner.reel --signer other.pub")[0];
    assert_eq!(other["findings"][0]["kind"], "signature");
    let refused = complaint(folder, 2, "key new lab");
    assert!(refused.contains("a key is not written over"), "{refused}");
    by_ssh_keygen(folder);
}

/// The signature in OpenSSH's own words.
fn by_ssh_keygen(folder: &Path) {
    if Command::new("ssh-keygen").arg("-?").output().is_err() {
        reel_vectors::skip("ssh-keygen", "there is no ssh-keygen");
        return;
    }
    let bundle =
        reel_bundle::Bundle::from_bytes(&fs::read(folder.join("planner.reel")).unwrap()).unwrap();
    fs::write(folder.join("statement.json.sig"), bundle.signature.unwrap()).unwrap();
    let public = fs::read_to_string(folder.join("lab.pub")).unwrap();
    fs::write(folder.join("allowed"), format!("lab {public}")).unwrap();
    let mut check = Command::new("ssh-keygen");
    check.args("-Y verify -f allowed -I lab -n reel-bundle -s statement.json.sig".split(' '));
    fs::write(folder.join("statement.json"), bundle.statement).unwrap();
    let statement = fs::File::open(folder.join("statement.json")).unwrap();
    let output = check.current_dir(folder).stdin(statement).output().unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );

    // No half of a key is written over, nor left alone.
    fs::rename(folder.join("lab"), folder.join("moved")).unwrap();
    assert!(complaint(folder, 2, "key new lab").contains("lab.pub is there already"));
    assert!(!folder.join("lab").exists());
    fs::rename(folder.join("moved"), folder.join("lab")).unwrap();

    // And a key that OpenSSH made signs here.
    let mut made = Command::new("ssh-keygen");
    made.args(["-q", "-t", "ed25519", "-N", "", "-f", "theirs"]);
    assert!(made.current_dir(folder).status().unwrap().success());
    reel!(
        folder,
        "bundle bench/planner --key theirs --out theirs.reel"
    );
    reel!(folder, "verify theirs.reel --signer theirs.pub --sample 1%");
}

#[test]
fn what_does_not_hold_is_named_with_exit_code_1() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    bundled(folder);
    // One run under two names.
    reel!(
        folder,
        "bench --tasks tasks --agent planner --run other --out bench/other"
    );
    reel!(folder, "bundle bench/other --out other.reel");
    let twice = complaint(folder, 1, "verify planner.reel other.reel --sample 1%");
    assert!(twice.contains("one run under two names"), "{twice}");

    // Played on tasks made easier, under their names.
    reel!(folder, "task generate --count 4 --seed 8 --out easier");
    let other = &verified(folder, 1, "planner.reel --tasks easier --sample 1%")[0];
    assert_eq!(other["findings"][0]["kind"], "task");

    // An episode that was deleted, and a trace that does not replay.
    let traces = reel_vectors::traces_in(&folder.join("bench/planner"));
    let first = fs::read(&traces[0]).unwrap();
    fs::remove_file(&traces[0]).unwrap();
    let missing = complaint(
        folder,
        2,
        "bundle bench/planner --tasks tasks --out less.reel",
    );
    assert!(
        missing.contains("1 of 4 episodes are missing") && missing.contains("--partial"),
        "{missing}"
    );
    reel!(
        folder,
        "bundle bench/planner --tasks tasks --partial --out less.reel"
    );
    let less = &verified(folder, 0, "less.reel --tasks tasks")[0];
    assert_eq!(
        (&less["result"]["episodes"], &less["result"]["played"]),
        (&4.into(), &3.into())
    );
    fs::write(&traces[0], &first[..first.len() / 2]).unwrap();
    let torn = complaint(
        folder,
        2,
        "bundle bench/planner --tasks tasks --out torn.reel",
    );
    assert!(torn.contains("cannot be bundled"), "{torn}");

    // What is no bundle at all.
    fs::write(folder.join("no.reel"), b"hello").unwrap();
    let text = expect(folder, 1, "verify no.reel planner.reel --sample 1%");
    assert!(
        text.contains("no.reel: DOES NOT HOLD: this is no bundle"),
        "{text}"
    );
    assert!(text.contains("planner.reel: HOLDS"), "{text}");
}

#[test]
fn a_build_without_a_player_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = crate::failed_episode(folder);
    fs::write(folder.join("other.html"), "<html></html>").unwrap();
    let arguments = format!("share {} --player other.html", trace.display());
    let text = complaint(folder, 2, &arguments);
    assert!(
        text.contains("no player's page") && text.contains("make web"),
        "{text}"
    );
    fs::write(folder.join("player.html"), "<main></main><!-- episode -->").unwrap();
    let arguments = format!(
        "share {} --player player.html --out page.html",
        trace.display()
    );
    let text = expect(folder, 0, &arguments);
    assert!(text.contains("here it is exact"), "{text}");
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(
        page.starts_with("<main></main><script type=\"application/octet-stream\" id=\"episode\"")
    );
}

#[test]
fn a_folder_of_bundles_becomes_ranked_pages() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    bundled(folder);
    fs::create_dir(folder.join("all")).unwrap();
    fs::copy(folder.join("planner.reel"), folder.join("all/planner.reel")).unwrap();
    for (agent, flags) in [("explorer", ""), ("planner", "--run twin"), ("no-ask", "")] {
        reel!(
            folder,
            "bench --tasks tasks --agent {agent} --out bench/{agent}-2 {flags}"
        );
        reel!(
            folder,
            "bundle bench/{agent}-2 --name <{agent}> --out all/{agent}-2.reel"
        );
    }
    fs::write(folder.join("all/torn.reel"), b"PK").unwrap();
    fs::write(folder.join("player.html"), "<!-- episode -->").unwrap();
    let text = expect(
        folder,
        3,
        "leaderboard all --tasks tasks --player player.html --out site",
    );
    assert!(text.contains("3 of 5 bundles ranked"), "{text}");
    let results: Value =
        serde_json::from_str(&fs::read_to_string(folder.join("site/results.json")).unwrap())
            .unwrap();
    let board = results["boards"][0].as_array().unwrap();
    let rates: Vec<f64> = board
        .iter()
        .map(|row| row["result"]["success_rate"].as_f64().unwrap())
        .collect();
    assert!(
        rates.len() == 3 && rates.is_sorted_by(|a, b| a >= b),
        "{rates:?}"
    );
    let left: Vec<&str> = results["not_ranked"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row["bundle"].as_str().unwrap())
        .collect();
    assert!(left.contains(&"torn.reel") && left.len() == 2, "{left:?}");
    let page = fs::read_to_string(folder.join("site/index.html")).unwrap();
    assert!(page.contains("&lt;explorer&gt;") && !page.contains("<explorer>"));
    assert!(page.contains("href=\"player.html#bundles/explorer-2.reel\""));
    assert!(folder.join("site/bundles/explorer-2.reel").is_file());
    assert!(page.contains("one run under two names") && page.contains("Not proven: "));
}
