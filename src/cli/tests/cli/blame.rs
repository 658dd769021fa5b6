//! Why an episode failed and what would repair it, from outside.

use serde_json::Value;

use crate::{complaint, expect, failed_episode};

#[test]
fn a_failure_is_measured_explained_and_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = failed_episode(folder);
    let trace = trace.to_str().unwrap();
    let json = |text: String| -> Value { serde_json::from_str(&text).unwrap() };

    let told = reel!(folder, "blame {trace} --steps --branches better");
    assert!(
        told.contains("decisive  call") && told.contains("pick(marker_id="),
        "{told}"
    );
    assert!(
        told.contains("perception") && told.contains("a competent agent goes on and succeeds"),
        "{told}"
    );
    assert!(
        told.contains("replays exactly") && told.contains("  call  cost  after  regret"),
        "{told}"
    );
    let found = json(reel!(folder, "blame {trace} --json --branches better"));
    let better = found["alternative"]["trace"].as_str().unwrap();
    assert!(reel!(folder, "replay {better}").contains("exact"));
    let step = found["decisive"]["step"].as_u64().unwrap();
    assert!(
        reel!(folder, "branch {trace} --check {better}")
            .contains(&format!("branches at call {step}"))
    );
    let lean = json(reel!(folder, "blame {trace} --json --no-alternatives"));
    assert_eq!(
        (&lean["decisive"], &lean["alternative"]),
        (&found["decisive"], &Value::Null)
    );
    assert!(complaint(folder, 2, &format!("blame {trace} --labels")).contains("no label beside"));
    assert!(complaint(folder, 2, "blame").contains("required"));

    let repaired = json(reel!(folder, "repair {trace} --out repaired.mcap --json"));
    assert_eq!(
        (
            &repaired["verified"],
            repaired["edits"].as_array().unwrap().is_empty()
        ),
        (&true.into(), false),
        "{repaired}"
    );
    assert!(
        repaired["at"].as_u64().unwrap() >= step && repaired["presumed"].is_array(),
        "{repaired}"
    );
    assert!(reel!(folder, "blame repaired.mcap").contains("succeeded"));
    let nothing = complaint(folder, 1, "repair repaired.mcap");
    assert!(nothing.contains("nothing to repair"), "{nothing}");
    assert!(
        complaint(folder, 2, &format!("repair {trace} --out {trace}")).contains("another name")
    );
}

#[cfg(feature = "analytics")]
#[test]
fn a_store_keeps_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(
        folder,
        "run --tasks tasks --policy oracle --out traces --no-images"
    );
    reel!(folder, "ingest traces --store store");
    let told = reel!(folder, "blame --store store");
    assert!(
        told.contains("1 of 1 episodes failed") && told.contains("table `blame`"),
        "{told}"
    );
    let ask = |sql: &str| {
        expect(
            folder,
            0,
            &format!("query --store store --format csv | {sql}"),
        )
    };
    let kept = ask("SELECT tool, harm, cause, alternative FROM blame");
    assert_eq!(
        kept,
        "tool,harm,cause,alternative\npick,world,perception,planner\n"
    );
    let same = ask(
        "SELECT count(*) AS n FROM blame b JOIN episodes e ON b.episode_id = e.episode_id \
                    WHERE blame(e.trace).step = b.step AND blame(e.trace).explanation = b.explanation",
    );
    assert_eq!(same, "n\n1\n");
    let of_success = ask("SELECT blame(trace).step IS NULL AS none FROM episodes WHERE success");
    assert_eq!(of_success, "none\ntrue\n");
}

#[cfg(feature = "analytics")]
#[test]
fn failures_become_preferences_and_value_targets() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    failed_episode(folder);
    reel!(folder, "ingest traces --store store");
    let report = reel!(
        folder,
        "export preferences --store store --out pairs --json"
    );
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(
        (&report["failed"], &report["pairs"]),
        (&1.into(), &1.into()),
        "{report}"
    );
    let lines = |name: &str| -> Vec<Value> {
        let text = std::fs::read_to_string(folder.join("pairs").join(name)).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    };
    let pair = &lines("preferences.jsonl")[0];
    let said = |side: &str| {
        pair[side][0]["content"][0]["text"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    assert!(
        said("chosen") != said("rejected") && said("chosen").contains("next action"),
        "{pair}"
    );
    let origin = &pair["provenance"];
    assert_eq!(origin["chosen"]["verdict"], "exact");
    assert_eq!(
        (&origin["chosen"]["call"], &origin["rejected"]["call"]),
        (&origin["call"], &origin["call"])
    );
    for image in pair["images"].as_array().unwrap() {
        assert!(
            folder.join("pairs").join(image.as_str().unwrap()).exists(),
            "{image}"
        );
    }
    let values = lines("values.jsonl");
    assert_eq!(
        values.last().unwrap()["cost_to_go"],
        1,
        "the repaired episode ends with finish"
    );
    assert!(
        values
            .iter()
            .all(|row| (0.0..=1.0).contains(&row["value"].as_f64().unwrap()))
    );
    assert!(!folder.join("pairs/.store").exists() && !folder.join("pairs/.examples").exists());
    assert!(
        complaint(folder, 2, "export preferences --store store --out pairs").contains("not empty")
    );
    let of_others = reel!(
        folder,
        "export preferences --store store --out none --json --where | success OR family = 'none'"
    );
    let of_others: Value = serde_json::from_str(&of_others).unwrap();
    assert_eq!(
        (&of_others["failed"], &of_others["pairs"]),
        (&0.into(), &0.into())
    );
}

/// The short form of `make eval-preferences`.
#[cfg(feature = "analytics")]
#[test]
fn pairs_choose_what_is_possible_succeeds_and_asks_where_asking_was_missing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 12 --seed 8 --out tasks");
    let kinds = "missing_ask,wrong_attribute,missing_open,stale_marker,oscillation";
    reel!(
        folder,
        "agent faults run --tasks tasks --episodes 14 --seed 70 --kinds {kinds} --out traces"
    );
    reel!(folder, "ingest traces --store store");
    reel!(
        folder,
        "export preferences --store store --out pairs --no-images"
    );
    let text = std::fs::read_to_string(folder.join("pairs/preferences.jsonl")).unwrap();
    let pairs: Vec<Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(pairs.len() >= 8, "{} pairs", pairs.len());
    reel!(folder, "ingest pairs/traces --store chosen");
    let sql = "SELECT e.episode_id, e.success, s.step, s.tool, s.error_code FROM episodes e JOIN steps s USING (episode_id)";
    let steps = expect(
        folder,
        0,
        &format!("query --store chosen --format csv | {sql}"),
    );
    let mut questions = 0;
    for pair in pairs {
        let origin = &pair["provenance"];
        assert_ne!(origin["chosen_call"], origin["rejected_call"]);
        assert_ne!(pair["chosen"], pair["rejected"]);
        let (episode, step) = origin["chosen"]["example"]
            .as_str()
            .unwrap()
            .split_once('/')
            .unwrap();
        // it succeeds, and the chosen call is no error
        let row = format!("{episode},true,{step},");
        let row = steps
            .lines()
            .find(|line| line.starts_with(&row))
            .unwrap_or_else(|| panic!("no future that succeeds: {origin}"));
        assert!(row.ends_with(','), "the chosen call fails: {row}");
        if origin["cause"] == "communication" {
            assert!(row.contains(",ask,"), "{row}");
            questions += 1;
        }
    }
    assert!(questions > 0, "no missing question among them");
}

#[cfg(feature = "analytics")]
#[test]
fn the_taxonomy_takes_or_names_the_measured_step() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 4 --seed 3 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy oscillating --out traces --no-images"
    );
    reel!(folder, "ingest traces --store store");
    let others = || {
        reel!(folder, "taxonomy --store store");
        let sql = "SELECT count(*) FILTER (WHERE c.step <> blame(e.trace).step AND \
                   NOT coalesce(starts_with(c.explanation, 'call ' || blame(e.trace).step || ': '), false)) AS others, \
                   count(*) AS n FROM classes c JOIN episodes e ON c.episode_id = e.episode_id";
        let rows = expect(
            folder,
            0,
            &format!("query --store store --format csv | {sql}"),
        );
        let numbers: Vec<u32> = rows
            .lines()
            .nth(1)
            .unwrap()
            .split(',')
            .map(|number| number.parse().unwrap())
            .collect();
        (numbers[0], numbers[1])
    };
    let (by_rules, failed) = others();
    assert!(
        by_rules > 0,
        "rules and measure agree on all {failed}: nothing is tested"
    );
    reel!(folder, "blame --store store --no-alternatives");
    assert_eq!(others(), (0, failed));
}

#[test]
fn the_evaluation_counts_what_began_where() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 4 --seed 5 --out tasks");
    let kinds = "premature_finish,missing_pick";
    expect(
        folder,
        0,
        &format!(
            "agent faults run --tasks tasks --episodes 6 --seed 40 --kinds {kinds} --out \
faulty"
        ),
    );
    let told = reel!(folder, "blame faulty --labels --no-alternatives");
    let all = told.lines().find(|line| line.starts_with("all")).unwrap();
    let numbers: Vec<&str> = all.split_whitespace().collect();
    assert!(
        numbers[1].parse::<u32>().unwrap() >= 3 && numbers[1] == numbers[2],
        "{told}"
    );
    // A label that says otherwise is counted as such.
    for entry in std::fs::read_dir(folder.join("faulty")).unwrap() {
        let path = entry.unwrap().path();
        if path.to_string_lossy().ends_with(".label.json") {
            let mut label: Value =
                serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
            let step = label["faults"][0]["step"].as_u64().unwrap();
            label["faults"][0]["step"] = (step + 1).into();
            std::fs::write(&path, label.to_string()).unwrap();
        }
    }
    let told = reel!(folder, "blame faulty --labels --no-alternatives");
    let all = told.lines().find(|line| line.starts_with("all")).unwrap();
    let numbers: Vec<&str> = all.split_whitespace().collect();
    assert_eq!(
        (numbers[2], numbers[1]),
        ("0", numbers[4]),
        "all are found earlier: {told}"
    );
}

/// The short form of `make eval-insight`, on the half that may be looked at.
#[cfg(feature = "analytics")]
#[test]
fn perturbed_competent_play_is_explained() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let episodes = if reel_vectors::is_long() { 140 } else { 35 };
    let text = reel!(
        folder,
        "dev eval-insight --split development --episodes {episodes} --seed 4 --out insight --json"
    );
    let figures: Value = serde_json::from_str(&text).unwrap();
    let share = |name: &str| {
        let share = &figures["shares"][name];
        let number = |key: &str| {
            share[key]
                .as_f64()
                .unwrap_or_else(|| panic!("{name}: {share}"))
        };
        (number("hits"), number("of"))
    };
    let at_least = |name: &str, least: f64| {
        let (hits, of) = share(name);
        assert!(hits >= least * of, "{name}: {hits} of {of}\n{text}");
    };
    assert!(
        share("class, fair").1 >= f64::from(episodes) / 3.0,
        "{text}"
    );
    at_least("class, fair", 0.85);
    at_least("sub-class, fair", 0.75);
    at_least("step world, fair", 0.75);
    at_least("step ending, fair", 0.75);
    assert_eq!(share("successes explained away").0, 0.0);
    let refused = complaint(
        folder,
        2,
        "dev eval-insight --split report --episodes 2 --out no --examples 3",
    );
    assert!(refused.contains("development"), "{refused}");
}
