//! GSPO from traces: a stand-in for a model under three names (checkpoints), its log-probabilities
//! in traces, tables, SQL, training rows and the objective.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use reel_reward::{
    Estimator,
    gspo::{ClipRange, KlEstimator, kl, objective, sequence_ratio},
};
use reel_trace::{ScoredTokens, Trace};
use serde_json::Value;

use crate::{
    agents::{Mock, files, plans},
    complaint,
    endpoint::{answering, completion},
    expect,
};

/// Plays two tasks at two seeds with the stand-in as each of these checkpoints.
fn play(here: &Path, checkpoints: &[&str]) {
    plans(here, "2");
    let mock = Mock::start(here, &[]);
    for checkpoint in checkpoints {
        let mut bench = vec![
            "bench",
            "--tasks",
            "tasks",
            "--agent",
            "real-agent",
            "--endpoint",
            &mock.url,
            "--no-images",
        ];
        bench.extend([
            "--model",
            checkpoint,
            "--logprobs",
            "--repeat",
            "2",
            "--out",
            checkpoint,
        ]);
        expect(here, 0, &bench);
    }
}

/// What `reel trace logprobs list` prints, by episode and policy: the log-probabilities of all
/// decisions behind one another.
fn listed(printed: &str) -> BTreeMap<(String, String), Vec<f64>> {
    let mut all: BTreeMap<(String, String), Vec<f64>> = BTreeMap::new();
    for line in ScoredTokens::read_lines(printed, Path::new("stdout")).unwrap() {
        all.entry((line.episode_id, line.policy))
            .or_default()
            .extend(line.logprobs);
    }
    all
}

#[track_caller]
fn near(found: &Value, expected: f64) {
    let found = found.as_f64().unwrap();
    assert!(
        (found - expected).abs() < 1e-9,
        "found {found}, expected {expected}"
    );
}

#[test]
fn from_an_endpoint_to_the_objective() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    play(here, &["old", "new", "ref"]);
    assert!(reel!(here, "ingest old --store store").starts_with("4 added"));
    let early = complaint(here, 2, "dataset gspo --store store");
    assert!(
        early.contains("'old', 'new'") && early.contains("reel trace logprobs add"),
        "{early}"
    );

    let digests = |folder: &str| -> Vec<_> {
        files(&here.join(folder), "mcap")
            .iter()
            .map(|it| Trace::read(it).unwrap().chain())
            .collect()
    };
    let before = digests("old");
    for checkpoint in ["new", "ref"] {
        let added = reel!(
            here,
            "trace logprobs add old --from {checkpoint} --policy {checkpoint}"
        );
        assert!(added.contains("to 4 traces"), "{added}");
    }
    assert_eq!(digests("old"), before);
    assert!(reel!(here, "replay old").starts_with("4 of 4 traces replay exactly"));
    assert!(reel!(here, "ingest old --store store").starts_with("0 added, 4 replaced"));
    assert!(
        reel!(here, "ingest old --store store").starts_with("0 added, 0 replaced, 4 unchanged")
    );

    // the objective from the lines alone: groups are tasks, rewards are the sums of their episodes
    let lines = listed(&reel!(here, "trace logprobs list old"));
    assert_eq!(lines.len(), 4 * 3);
    let mut groups: BTreeMap<String, BTreeMap<String, f64>> = BTreeMap::new();
    for path in files(&here.join("old"), "mcap") {
        let trace = Trace::read(&path).unwrap();
        let rewards = trace.steps.iter().map(|step| step.reward_total()).sum();
        groups
            .entry(trace.header.task_digest.to_string())
            .or_default()
            .insert(trace.header.episode_id, rewards);
    }
    let (mut ratios, mut kls, mut advantages) = (Vec::new(), Vec::new(), Vec::new());
    for group in groups.values() {
        let returns: Vec<f64> = group.values().copied().collect();
        advantages.extend(
            Estimator::Ngrpo { virtual_max: None }
                .advantages(&[returns])
                .unwrap()
                .remove(0),
        );
        for episode in group.keys() {
            let of = |policy: &str| &lines[&(episode.clone(), policy.to_owned())];
            ratios.push(sequence_ratio(of("new"), of("old")).unwrap());
            kls.push(kl(KlEstimator::K3, of("new"), of("ref")).unwrap());
        }
    }
    let expected = objective(
        &ratios,
        &advantages,
        &kls,
        ClipRange::symmetric(0.001).unwrap(),
        0.04,
    )
    .unwrap();
    assert!(
        ratios.iter().all(|ratio| (ratio - 1.0).abs() > 1e-6),
        "the checkpoints differ: {ratios:?}"
    );

    let with = [
        "--ref",
        "ref",
        "--beta",
        "0.04",
        "--epsilon",
        "0.001",
        "--returns",
        "published",
    ];
    let gspo = |more: &[&str]| {
        expect(
            here,
            0,
            &[&["dataset", "gspo", "--store", "store"], &with[..], more].concat(),
        )
    };
    let told: Value = serde_json::from_str(&gspo(&["--json"])).unwrap();
    let report = &told["report"];
    near(&report["loss"], expected.loss);
    near(&report["surrogate"], expected.surrogate);
    near(&report["kl"], expected.kl);
    near(&report["clipped"]["low"], expected.clipped.low);
    near(&report["clipped"]["high"], expected.clipped.high);
    assert_eq!(
        told["options"]["rollouts"]["advantage"]["estimator"], "ngrpo",
        "the published default"
    );
    assert_eq!(
        (
            report["groups"].as_array().unwrap().len(),
            report["sequences"].as_array().unwrap().len()
        ),
        (2, 4)
    );
    let table = gspo(&[]);
    assert!(
        table.contains("policy 'new' over tokens of 'old'; returns published, advantage ngrpo"),
        "{table}"
    );
    assert!(table.contains("from 'ref'"), "{table}");
    let decisions: Value =
        serde_json::from_str(&gspo(&["--json", "--sequence", "decision"])).unwrap();
    let counted: usize = files(&here.join("old"), "mcap")
        .iter()
        .map(|path| Trace::read(path).unwrap().steps.len())
        .sum();
    assert_eq!(
        decisions["report"]["sequences"].as_array().unwrap().len(),
        counted
    );
    assert_eq!(decisions["report"]["tokens"], report["tokens"]);

    // the same in SQL
    let sql = "
        WITH scored AS (
          SELECT n.episode_id,
            sequence_ratio(flatten(array_agg(n.logprobs ORDER BY n.step)), flatten(array_agg(o.logprobs ORDER BY n.step))) AS ratio,
            kl(flatten(array_agg(n.logprobs ORDER BY n.step)), flatten(array_agg(r.logprobs ORDER BY n.step)), 'k3') AS kl
          FROM logprobs n
          JOIN logprobs o ON o.episode_id = n.episode_id AND o.step = n.step AND o.policy = 'old'
          JOIN logprobs r ON r.episode_id = n.episode_id AND r.step = n.step AND r.policy = 'ref'
          WHERE n.policy = 'new' GROUP BY n.episode_id),
        grouped AS (
          SELECT task_digest, array_agg(ratio ORDER BY s.episode_id) AS ratios, array_agg(kl ORDER BY s.episode_id) AS kls,
            array_agg(total_reward ORDER BY s.episode_id) AS returns
          FROM scored s JOIN episodes e ON e.episode_id = s.episode_id GROUP BY task_digest)
        SELECT avg(gspo(ratios, estimated_advantages([returns], 'ngrpo', 'group')[1], kls, 0.001, 0.001, 0.04).loss) AS loss FROM grouped";
    let asked = expect(
        here,
        0,
        &format!("query --store store --format csv | {sql}"),
    );
    near(
        &asked.lines().nth(1).unwrap().parse::<f64>().unwrap().into(),
        expected.loss,
    );

    // rows for a trainer
    reel!(
        here,
        "export rl --store store --out rl --image-format none --returns published"
    );
    let manifest: Value =
        serde_json::from_slice(&fs::read(here.join("rl/manifest.json")).unwrap()).unwrap();
    let rollouts = &manifest["options"]["rollouts"];
    assert_eq!(
        (
            &rollouts["returns"]["name"],
            &rollouts["returns"]["gamma"],
            &rollouts["returns"]["horizon"]
        ),
        (&"published".into(), &1.0.into(), &50.into())
    );
    let rows = files(&here.join("rl/train"), "jsonl")
        .iter()
        .map(|path| fs::read_to_string(path).unwrap())
        .collect::<String>();
    let rows: Vec<Value> = rows
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(rows.len(), counted);
    for row in &rows {
        let lengths =
            ["old", "new", "ref"].map(|policy| row["logprobs"][policy].as_array().unwrap().len());
        assert_eq!(lengths, [row["tokens"].as_array().unwrap().len(); 3]);
    }
}

#[test]
fn log_probabilities_of_other_tokens_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    play(here, &["old"]);
    let text = reel!(here, "trace logprobs list old");
    let lines = ScoredTokens::read_lines(&text, Path::new("stdout")).unwrap();
    let before: Vec<Vec<u8>> = files(&here.join("old"), "mcap")
        .iter()
        .map(|path| fs::read(path).unwrap())
        .collect();
    let refused = |change: &dyn Fn(&mut ScoredTokens)| {
        let mut changed: Vec<ScoredTokens> = lines
            .iter()
            .cloned()
            .map(|line| ScoredTokens {
                policy: "new".into(),
                ..line
            })
            .collect();
        change(changed.last_mut().unwrap());
        let text: String = changed
            .iter()
            .map(|line| serde_json::to_string(line).unwrap() + "\n")
            .collect();
        fs::write(here.join("new.jsonl"), text).unwrap();
        let told = complaint(here, 2, "trace logprobs add old --from new.jsonl");
        let after: Vec<Vec<u8>> = files(&here.join("old"), "mcap")
            .iter()
            .map(|path| fs::read(path).unwrap())
            .collect();
        assert!(before == after, "nothing is written unless everything fits");
        told
    };
    assert!(refused(&|line| _ = line.logprobs.pop()).contains("log-probabilities for"));
    assert!(refused(&|line| line.logprobs[1] = 0.5).contains("at most 0"));
    assert!(
        refused(&|line| line.tokens.as_mut().unwrap()[1].push('x'))
            .contains("must be of the recorded tokens")
    );
    assert!(refused(&|line| line.step = 99).contains("step 99"));
    fs::write(here.join("new.jsonl"), "{\"logprobs\": [NaN]}\n").unwrap();
    assert!(complaint(here, 2, "trace logprobs add old --from new.jsonl").contains("line 1"));
    fs::write(here.join("new.jsonl"), "").unwrap();
    assert!(
        complaint(here, 2, "trace logprobs add old --from new.jsonl")
            .contains("reel trace logprobs list")
    );

    // scored in part: the objective names the decision
    let first: Vec<&ScoredTokens> = lines
        .iter()
        .filter(|line| line.episode_id == lines[0].episode_id)
        .collect();
    let part = serde_json::to_string(&ScoredTokens {
        policy: "new".into(),
        ..first[0].clone()
    })
    .unwrap();
    fs::write(here.join("new.jsonl"), part).unwrap();
    reel!(here, "trace logprobs add old --from new.jsonl");
    reel!(here, "ingest old --store store");
    let told = complaint(here, 2, "dataset gspo --store store");
    assert!(
        told.contains(&lines[0].episode_id) && told.contains("step 1") && told.contains("'new'"),
        "{told}"
    );
    assert!(complaint(here, 2, "dataset gspo --store store --beta 0.04").contains("--ref"));
    assert!(complaint(here, 2, "dataset gspo --store store --epsilon -1").contains("radius"));
    assert!(
        complaint(
            here,
            2,
            "dataset gspo --store store --eps 1 --advantage grpo"
        )
        .contains("--advantage paper")
    );

    // without log-probabilities a run says so
    let plain = complaint(here, 1, "trace logprobs list plans");
    assert!(plain.contains("reel bench --logprobs"), "{plain}");
}

/// A policy is rewarded for what it said: rows of rollouts hold its answers as they came, also one that no call could be
/// read from, and the prompts that it had.
#[test]
fn rows_of_rollouts_are_what_was_asked_and_said() {
    const UNREAD: &str = "<think>Is it <tool_call>here?</think>\n{\"next action\": ";
    const FINISH: &str = "<think>Enough.</think>\n{\"next action\":{\"args\":{},\"tool_name\":\"finish\"}, \"mood\": 1}";
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "1");
    let asked = Arc::new(Mutex::new(Vec::<(String, &str)>::new()));
    let log = Arc::clone(&asked);
    let url = answering(move |request| {
        let prompt = request["messages"][0]["content"].as_str().unwrap();
        let answer = match prompt.contains("could not be read") {
            true => FINISH,
            false => UNREAD,
        };
        log.lock().unwrap().push((prompt.to_owned(), answer));
        completion(answer)
    });
    let bench = "bench --tasks tasks --agent real-agent --model m --no-images --repeat 2 --temperature 1 --out played";
    let mut arguments: Vec<&str> = bench.split(' ').collect();
    arguments.extend(["--endpoint", &url]);
    expect(here, 0, &arguments);
    reel!(here, "ingest played --store store");
    reel!(
        here,
        "export rl --store store --format ms-swift --image-format none --out rl"
    );
    let rows = |set: &str| -> Vec<(String, String)> {
        let read = |path: &PathBuf| fs::read_to_string(path).unwrap();
        let text: String = files(&here.join(set).join("train"), "jsonl")
            .iter()
            .map(read)
            .collect();
        let turns = |line: &str| {
            let row: Value = serde_json::from_str(line).unwrap();
            let content = |at: usize| row["messages"][at]["content"].as_str().unwrap().to_owned();
            (content(0), content(1))
        };
        let mut rows: Vec<_> = text.lines().map(turns).collect();
        rows.sort();
        rows
    };
    let asked = asked.lock().unwrap();
    let mut said: Vec<(String, String)> = asked
        .iter()
        .map(|(prompt, answer)| (prompt.clone(), (*answer).to_owned()))
        .collect();
    said.sort();
    assert_eq!(said.len(), 4);
    assert_eq!(rows("rl"), said);
    reel!(here, "dataset lint rl");
    // In other words, too, a decision after such an answer has the prompt that the policy had.
    reel!(
        here,
        "export sft --store store --format ms-swift --annotations rules --failed --mistakes --after-decisive --image-format none --out sft"
    );
    let prompts: Vec<String> = rows("sft").into_iter().map(|(prompt, _)| prompt).collect();
    let had = asked
        .iter()
        .filter(|(_, answer)| *answer == FINISH)
        .map(|(prompt, _)| prompt.clone());
    assert_eq!(prompts, had.collect::<Vec<_>>());
    let changes = reel!(here, "train changes store store --no-attribution");
    assert!(changes.contains("calls of (unreadable)"), "{changes}");
}

/// What a trainer logged is what the traces of its rollouts give, and a log that says otherwise is named.
#[test]
fn a_log_of_a_training_is_held_against_its_traces() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    play(here, &["old", "new", "ref"]);
    for checkpoint in ["new", "ref"] {
        reel!(
            here,
            "trace logprobs add old --from {checkpoint} --policy {checkpoint}"
        );
    }
    reel!(here, "ingest old --store old.store");
    let gspo = "dataset gspo --store old.store --ref ref --beta 0.04 --epsilon 0.9 --advantage ngrpo --json";
    let told: Value = serde_json::from_str(&reel!(here, "{gspo}")).unwrap();
    let report = &told["report"];
    let objective = serde_json::json!({
        "old": "old", "new": "new", "reference": "ref", "epsilon": 0.9, "epsilon_high": 0.9, "beta": 0.04, "returns": "paper",
        "advantage": "ngrpo", "group_size": null, "preset": null,
    });
    let about = serde_json::json!({ "objective": objective, "seed": 3 });
    fs::write(here.join("training.json"), about.to_string()).unwrap();
    let line = |loss: f64| {
        let step = serde_json::json!({
            "step": 7, "weights_before": "aa", "weights": "bb", "store": "old.store",
            "updates": [{
                "episodes": 4, "gradient_norm": 0.5, "loss": loss, "ratio": report["ratio"][1], "kl": report["kl"],
                "low": report["clipped"]["low"], "high": report["clipped"]["high"],
            }],
        });
        fs::write(here.join("steps.jsonl"), format!("{step}\n")).unwrap();
    };
    line(report["loss"].as_f64().unwrap());
    let steps = reel!(here, "train log .");
    assert!(
        steps.contains("equal") && steps.contains("100.0%"),
        "{steps}"
    );
    let step: Value = serde_json::from_str(&reel!(here, "train log . --step 7 --json")).unwrap();
    let episodes = step["steps"][0]["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 4);
    let shares: f64 = episodes
        .iter()
        .map(|one| one["share"].as_f64().unwrap())
        .sum();
    assert!((shares - 1.0).abs() < 1e-9, "{shares}");
    for one in episodes {
        let trace = Trace::read(&here.join(one["trace"].as_str().unwrap())).unwrap();
        let paid: f64 = trace.steps.iter().map(|step| step.reward_total()).sum();
        let terms: f64 = one["terms"]
            .as_object()
            .unwrap()
            .values()
            .map(|value| value.as_f64().unwrap())
            .sum();
        assert!(
            (paid - terms).abs() < 1e-9,
            "{paid} is the sum of {}",
            one["terms"]
        );
        let weight = (one["ratio"].as_f64().unwrap() * one["advantage"].as_f64().unwrap()).abs();
        assert_eq!(
            weight > 0.0 && one["clipped"].is_null(),
            one["share"].as_f64().unwrap() > 0.0
        );
    }
    let table = reel!(here, "train log . --step 7");
    assert!(
        table.contains("weights aa -> bb") && table.contains("succeeded: "),
        "{table}"
    );

    line(report["loss"].as_f64().unwrap() + 0.001);
    let off = expect(here, 1, &["train", "log", ".", "--step", "7"]);
    assert!(
        off.contains("off by 1.00e-3") && off.contains("the traces give loss"),
        "{off}"
    );

    assert!(complaint(here, 2, "train log . --step 8").contains("no step 8; it has 7 to 7"));
    fs::write(here.join("steps.jsonl"), "{\"step\": 1}\n").unwrap();
    let broken = complaint(here, 2, "train log .");
    assert!(
        broken.contains("steps.jsonl, line 1") && broken.contains("store"),
        "{broken}"
    );
    fs::write(here.join("steps.jsonl"), "").unwrap();
    assert!(complaint(here, 2, "train log .").contains("no step yet"));
    fs::remove_file(here.join("training.json")).unwrap();
    assert!(complaint(here, 2, "train log .").contains("training.json"));
}

/// Two policies over the same tasks and seeds: what differs is named on both sides.
#[test]
fn changes_of_a_training_are_told_by_task_and_call() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "3");
    for (policy, out) in [("oscillating", "before"), ("oracle", "after")] {
        reel!(
            here,
            "run --tasks tasks --policy {policy} --no-images --out {out}"
        );
        reel!(here, "ingest {out} --store {out}.store");
    }
    let told: Value = serde_json::from_str(&reel!(
        here,
        "train changes before.store after.store --json"
    ))
    .unwrap();
    let [before, after] = [0, 1].map(|side| &told["sides"][side]);
    assert_eq!(
        (&before["episodes"], &after["episodes"]),
        (&3.into(), &3.into())
    );
    assert_eq!(after["success"], 1.0);
    let wins = before["success"].as_f64().unwrap() * 3.0;
    let flips = told["tasks"].as_array().unwrap();
    assert_eq!(flips.len(), 3 - wins.round() as usize, "{told}");
    assert!(!flips.is_empty(), "the two policies differ");
    let failures: u64 = before["failures"]
        .as_object()
        .unwrap()
        .values()
        .map(|count| count.as_u64().unwrap())
        .sum();
    assert_eq!(failures as usize, flips.len());
    assert_eq!(told["attribution"].as_array().unwrap().len(), 2);
    assert_eq!(told["attribution"][1].as_array().unwrap().len(), 4);
    let text = reel!(
        here,
        "train changes before.store after.store --no-attribution"
    );
    assert!(
        text.contains("calls of finish") && text.contains("tasks flip"),
        "{text}"
    );
    assert!(!text.contains("capability perfect"), "{text}");
    reel!(here, "task generate --count 1 --seed 99 --out others");
    reel!(
        here,
        "run --tasks others --policy oracle --no-images --out others.traces"
    );
    reel!(here, "ingest others.traces --store others.store");
    let nothing = complaint(
        here,
        2,
        "train changes before.store others.store --no-attribution",
    );
    assert!(nothing.contains("no task and seed is in both"), "{nothing}");
}

/// The learning loop of `python/loop`: unit tests, and in the long form the loop itself, some minutes of it.
#[test]
fn the_learning_loop_is_whole() {
    let mut loop_tests = reel_vectors::script("bash", "../python/loop/tests/run.sh");
    loop_tests
        .args(reel_vectors::form())
        .env("REEL", env!("CARGO_BIN_EXE_reel"));
    reel_vectors::run(&mut loop_tests);
}

/// A preset may be done with an episode before the agent is: what comes later counts for nothing,
/// in the objective and in the log of a training.
#[test]
fn decisions_after_the_preset_is_done_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    play(here, &["old"]);
    reel!(here, "ingest old --store old.store");
    let told = |more: &str| -> Value {
        let command = "dataset gspo --store old.store --new old --ref old --advantage ngrpo --json --epsilon 0.9";
        serde_json::from_str(&reel!(here, "{command} {more}")).unwrap()
    };
    let (recorded, other) = (told(""), told("--preset real-trainer"));

    // The trainer is done when no target remains: the `finish` of an episode that succeeded is not its.
    let printed = reel!(here, "trace logprobs list old");
    let lines = ScoredTokens::read_lines(&printed, Path::new("stdout")).unwrap();
    let mut kept = BTreeMap::new();
    let mut left_out = 0;
    for path in files(&here.join("old"), "mcap") {
        let trace = Trace::read(&path).unwrap();
        let last = trace.steps.len() as u32 - 1;
        let succeeded = trace.end.as_ref().unwrap().metrics.success;
        left_out += u64::from(succeeded);
        let id = trace.header.episode_id;
        let counted = lines
            .iter()
            .filter(|line| line.episode_id == id && !(succeeded && line.step == last));
        let count: usize = counted.map(|line| line.logprobs.len()).sum();
        kept.insert(id, count);
    }
    assert!(left_out > 0, "an episode succeeded");
    let tokens = |told: &Value| -> BTreeMap<String, usize> {
        let sequences = told["report"]["sequences"].as_array().unwrap().iter();
        let of = |one: &Value| {
            let id = one["episode_id"].as_str().unwrap().to_owned();
            (id, one["tokens"].as_u64().unwrap() as usize)
        };
        sequences.map(of).collect()
    };
    assert_eq!(tokens(&other), kept);
    assert_ne!(tokens(&recorded), kept);

    let update = |told: &Value| {
        let report = &told["report"];
        serde_json::json!({
            "episodes": 4, "loss": report["loss"], "ratio": report["ratio"][1], "kl": report["kl"],
            "low": report["clipped"]["low"], "high": report["clipped"]["high"],
        })
    };
    let objective = serde_json::json!({
        "old": "old", "new": "old", "reference": "old", "epsilon": 0.9, "epsilon_high": 0.9, "beta": 0.04, "returns": "paper",
        "advantage": "ngrpo", "group_size": null, "preset": "real-trainer",
    });
    let about = serde_json::json!({ "objective": objective });
    fs::write(here.join("training.json"), about.to_string()).unwrap();
    let log = |told: &Value| {
        let step =
            serde_json::json!({ "step": 1, "store": "old.store", "updates": [update(told)] });
        fs::write(here.join("steps.jsonl"), format!("{step}\n")).unwrap();
    };
    log(&other);
    assert!(reel!(here, "train log .").contains("equal"));
    let unpaid = complaint(here, 2, "train log . --step 1");
    assert!(
        unpaid.contains("reel store reward --store") && unpaid.contains("--preset real-trainer"),
        "{unpaid}"
    );
    reel!(here, "store reward --store old.store --preset real-trainer");
    let step: Value = serde_json::from_str(&reel!(here, "train log . --step 1 --json")).unwrap();
    for one in step["steps"][0]["episodes"].as_array().unwrap() {
        let id = one["episode_id"].as_str().unwrap();
        let sql = format!(
            "SELECT total_reward FROM rescored WHERE preset = 'real-trainer' AND episode_id = '{id}'"
        );
        let paid = expect(here, 0, &["query", "--store", "old.store", "--json", &sql]);
        let paid: Value = serde_json::from_str(&paid).unwrap();
        let terms = one["terms"].as_object().unwrap().values();
        near(
            &paid[0]["total_reward"],
            terms.map(|value| value.as_f64().unwrap()).sum(),
        );
    }
}

/// A preset that goes on to the end of an episode counts every answer of it, also those at the end
/// that no call could be read from.
#[test]
fn unreadable_answers_at_the_end_count_under_a_preset() {
    const READ: &str =
        "<think>Look.</think>\n{\"next action\":{\"args\":{},\"tool_name\":\"show_receptacles\"}}";
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "1");
    let mut first = None;
    let url = answering(move |request| {
        let prompt = request["messages"].clone();
        let text = match *first.get_or_insert_with(|| prompt.clone()) == prompt {
            true => READ,
            false => "<think>Hm.\n",
        };
        let token = |word: &str| serde_json::json!({ "token": word, "logprob": -0.5 });
        let content: Vec<Value> = text.split_inclusive(' ').map(token).collect();
        let mut answer = completion(text);
        answer["choices"][0]["logprobs"] = serde_json::json!({ "content": content });
        answer
    });
    let bench = "bench --tasks tasks --agent real-agent --model old --no-images --repeat 2 --logprobs --out played";
    let mut arguments: Vec<&str> = bench.split(' ').collect();
    arguments.extend(["--endpoint", &url]);
    expect(here, 0, &arguments);
    reel!(here, "ingest played --store store");
    let tokens = |preset: &str| -> Value {
        let command = "dataset gspo --store store --new old --advantage ngrpo --json";
        let told: Value = serde_json::from_str(&reel!(here, "{command} {preset}")).unwrap();
        told["report"]["tokens"].clone()
    };
    let printed = reel!(here, "trace logprobs list played");
    let all: usize = listed(&printed).values().map(Vec::len).sum();
    assert!(all > 3, "{printed}");
    for preset in ["", "--preset paper", "--preset real-trainer"] {
        assert_eq!(tokens(preset), all, "{preset}");
    }
}
