//! A bundle of recorded episodes: what it says, and what is found where somebody forged it. The forger here makes statement and table anew, so
//! that nothing but the execution, or a benchmark, can tell.

use std::{collections::BTreeSet, fs, path::Path};

use reel_bundle::{
    Benchmark, Bundle, BundleInputs, FindingKind, Key, Manifest, Signer, TaskEntry, Verification,
    make, results, verify,
};
use reel_trace::{Limits, PackedEpisode, Trace};
use reel_world::{Digest, canonical_json, is_invisible, record::EndRecord};

/// Episodes of one policy under one set of settings: four tasks, seven episodes.
const PLAYED: [&str; 7] = [
    "FDO_workshop_doors--explorer--10",
    "FDO_workshop_doors--explorer--5",
    "FDP_workshop_errors--explorer--22",
    "FODP_workshop_fall--explorer--0",
    "FODP_workshop_fall--explorer--8",
    "SUL_workshop_ask--explorer--20",
    "SUL_workshop_ask--explorer--23",
];

fn episode(name: &str) -> (PackedEpisode, EndRecord) {
    let golden = reel_vectors::golden_traces().into_iter();
    let mut named = golden.filter(|path| path.file_stem().is_some_and(|stem| stem == name));
    let path = named.next().unwrap();
    let bytes = fs::read(&path).unwrap();
    let trace = Trace::from_bytes(&path, &bytes, &Limits::default()).unwrap();
    let packed = reel_replay::pack(&trace, &bytes, name).unwrap();
    (packed, trace.end.unwrap())
}

fn made<'a>(names: &[&str], key: Option<&'a Key>) -> BundleInputs<'a> {
    BundleInputs {
        name: "explorers".to_owned(),
        episodes: names.iter().map(|name| episode(name)).collect(),
        tasks: Vec::new(),
        partial: true,
        calls: Some(b"{}\n".to_vec()),
        key,
    }
}

fn bundle(names: &[&str], key: Option<&Key>) -> Bundle {
    let scratch = tempfile::tempdir().unwrap();
    make(made(names, key), scratch.path()).unwrap()
}

fn manifest(bundle: &Bundle) -> Manifest {
    serde_json::from_slice(&bundle.manifest).unwrap()
}

/// The bundle with another manifest, and a statement that fits.
fn forged(bundle: &Bundle, change: impl FnOnce(&mut Manifest)) -> Bundle {
    let mut manifest = manifest(bundle);
    change(&mut manifest);
    manifest.results = results(&manifest.grid, &manifest.episodes);
    Bundle::of(
        &manifest,
        bundle.episodes.clone(),
        bundle.calls.clone(),
        None,
    )
}

fn kinds(found: &Verification) -> BTreeSet<FindingKind> {
    assert_eq!(found.holds, found.findings.is_empty());
    found.findings.iter().map(|finding| finding.kind).collect()
}

#[test]
fn a_sound_bundle_holds_and_comes_back_from_its_bytes() {
    let key = Key::of_seed(&[3; 32], "lab");
    let bundle = bundle(&PLAYED, Some(&key));
    let bytes = bundle.to_bytes().unwrap();
    assert_eq!(Bundle::from_bytes(&bytes).unwrap(), bundle);
    let found = verify(&bundle, None, Some(&key.signer())).unwrap();
    assert_eq!(found.findings, []);
    assert!(found.holds && found.miss_probability.is_empty());
    assert_eq!(found.signer, Some(key.signer().to_string()));
    let text = found.to_string();
    assert!(
        text.starts_with("HOLDS: \"explorers\" of \"explorer\": success "),
        "{text}"
    );
    assert!(text.ends_with("all 7 episodes executed again"), "{text}");
    // 4 tasks with 6 seeds (10, 5, 22, 0, 8, 20, 23 are seven): what was not played counts.
    let manifest = manifest(&bundle);
    let row = manifest.results.last().unwrap();
    assert_eq!((row.episodes, row.played), (28, 7));
    let statement: serde_json::Value = serde_json::from_slice(&bundle.statement).unwrap();
    assert_eq!(statement["_type"], "https://in-toto.io/Statement/v1");
    let names: Vec<_> = statement["subject"]
        .as_array()
        .unwrap()
        .iter()
        .map(|part| &part["name"])
        .collect();
    assert_eq!(names, ["manifest.json", "episodes.mcap", "calls.jsonl"]);
    let of = |list: &str| statement["predicate"][list].as_array().unwrap().len();
    assert_eq!(of("passedTests") + of("failedTests"), 28);
}

#[test]
fn every_changed_byte_is_found_without_a_signature() {
    let bundle = bundle(&PLAYED[3..5], None);
    let bytes = bundle.to_bytes().unwrap();
    // Every byte once where that is asked for; else 1,000 of them all over the file.
    let every = if reel_vectors::is_long() {
        1
    } else {
        bytes.len() / 1000
    };
    let mut tried = 0;
    for at in (0..bytes.len()).step_by(every) {
        for flip in [1, 0x80] {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            tried += 1;
            let Ok(read) = Bundle::from_bytes(&changed) else {
                continue;
            };
            let found = reel_bundle::CheckedBundle::new(&read, None, None);
            let holds = found.is_ok_and(|checked| checked.findings().is_empty());
            assert!(!holds, "byte {at} of {} with {flip:#x}", bytes.len());
        }
    }
    let least = if reel_vectors::is_long() {
        10_000
    } else {
        2_000
    };
    assert!(tried >= least, "{tried}");
}

#[test]
fn an_episode_of_another_seed_is_named() {
    let bundle = bundle(&PLAYED[3..5], None);
    let forged = forged(&bundle, |manifest| {
        // The lucky seed 8 is passed off as seed 1.
        manifest.grid.seeds = vec![0, 1];
        manifest.episodes[1].seed = 1;
    });
    let found = verify(&forged, None, None).unwrap();
    assert!(kinds(&found).contains(&FindingKind::Seed), "{found}");
    let finding = &found.findings[0];
    assert_eq!(finding.episode, Some(1));
    assert!(
        finding.text.contains("it has seed 8") && finding.text.contains("with seed 1 is claimed"),
        "{finding}"
    );
}

#[test]
fn another_preset_is_named() {
    let forged = forged(&bundle(&PLAYED[..1], None), |manifest| {
        manifest.settings.preset = "real-trainer".to_owned();
    });
    assert_eq!(
        kinds(&verify(&forged, None, None).unwrap()),
        [FindingKind::Preset].into()
    );
}

#[test]
fn a_better_metric_is_named_with_both_values() {
    let forged = forged(&bundle(&PLAYED[..2], None), |manifest| {
        manifest.episodes[1].reward += 1.0;
        manifest.episodes[1].success = true;
    });
    let found = verify(&forged, None, None).unwrap();
    assert_eq!(kinds(&found), [FindingKind::Metrics].into(), "{found}");
    assert!(
        found.findings[0].text.contains(" is claimed, and it is "),
        "{found}"
    );
}

#[test]
fn a_task_made_easier_or_left_out_is_named() {
    let all = bundle(&PLAYED, None);
    let tasks = manifest(&all).grid.tasks;
    let benchmark = |tasks: Vec<TaskEntry>| Benchmark {
        name: "the benchmark".to_owned(),
        tasks,
    };
    let sound = verify(&all, Some(&benchmark(tasks.clone())), None).unwrap();
    assert!(sound.holds, "{sound}");

    let mut harder = tasks.clone();
    harder[1].task = Digest::of(b"as it was published");
    let found = verify(&all, Some(&benchmark(harder)), None).unwrap();
    assert_eq!(kinds(&found), [FindingKind::Task].into());
    assert!(found.findings[0].text.contains(&tasks[1].id), "{found}");
    assert_eq!(found.findings[0].task.as_ref(), Some(&tasks[1].id));

    // Whoever leaves the hard task out of the grid, too, is found by the benchmark.
    let found = verify(
        &bundle(&PLAYED[2..], None),
        Some(&benchmark(tasks.clone())),
        None,
    )
    .unwrap();
    assert_eq!(kinds(&found), [FindingKind::Missing].into());
    assert!(found.findings[0].text.contains(&tasks[0].id), "{found}");
}

#[test]
fn an_episode_left_out_or_there_twice_is_named() {
    let all = bundle(&PLAYED[3..5], None);
    let missing = forged(&all, |manifest| drop(manifest.episodes.remove(1)));
    assert!(kinds(&verify(&missing, None, None).unwrap()).contains(&FindingKind::Missing));
    let twice = forged(&all, |manifest| {
        let first = manifest.episodes[0].clone();
        manifest.episodes[1] = first;
    });
    let found = kinds(&verify(&twice, None, None).unwrap());
    assert!(
        found.contains(&FindingKind::Extra) && found.contains(&FindingKind::Seed),
        "{found:?}"
    );
    // A failure that is not claimed at all, in the place where it was.
    let other = bundle(&PLAYED[..2], None);
    let swapped = Bundle::of(&manifest(&all), other.episodes, None, None);
    let found = kinds(&verify(&swapped, None, None).unwrap());
    assert!(
        found.contains(&FindingKind::Episode) && found.contains(&FindingKind::Task),
        "{found:?}"
    );
}

#[test]
fn another_table_settings_or_simulator_is_named() {
    let sound = bundle(&PLAYED[..1], None);
    let mut better = manifest(&sound);
    better.results[0].success_rate = 1.0;
    let of = |manifest: &Manifest| Bundle::of(manifest, sound.episodes.clone(), None, None);
    assert_eq!(
        kinds(&verify(&of(&better), None, None).unwrap()),
        [FindingKind::Results].into()
    );
    let mut other = manifest(&sound);
    other.settings.policy.name = "qwen3-vl".to_owned();
    assert_eq!(
        kinds(&verify(&of(&other), None, None).unwrap()),
        [FindingKind::Settings].into()
    );
    let mut old = manifest(&sound);
    old.simulator -= 1;
    assert_eq!(
        kinds(&verify(&of(&old), None, None).unwrap()),
        [FindingKind::Simulator].into()
    );
}

#[test]
fn nothing_in_a_bundle_writes_lines_of_a_verdict() {
    let hostile = "x\" of \"planner\": success\u{1b}[2J\nplanner.reel: HOLDS\u{202e}";
    let named = forged(&bundle(&PLAYED[..1], None), |manifest| {
        hostile.clone_into(&mut manifest.name);
        hostile.clone_into(&mut manifest.settings.policy.name);
        hostile.clone_into(&mut manifest.episodes[0].task);
    });
    let found = verify(&named, None, None).unwrap();
    assert!(!found.holds);
    let text = found.to_string();
    assert!(
        text.starts_with(r#"DOES NOT HOLD: "x\" of \"planner\": success"#),
        "{text}: its names cannot end"
    );
    let findings = found.findings.iter().map(ToString::to_string);
    for text in findings.chain([found.to_string()]) {
        assert!(!text.contains(is_invisible), "{text:?}");
    }
}

#[test]
fn a_grid_that_nobody_could_have_played_is_refused() {
    let mut vast = bundle(&PLAYED[..1], None);
    let mut claimed = manifest(&vast);
    claimed.grid.seeds.clear();
    claimed.episodes.clear();
    let empty = Bundle::of(
        &Manifest {
            results: results(&claimed.grid, &[]),
            ..claimed.clone()
        },
        vast.episodes.clone(),
        None,
        None,
    );
    let found = verify(&empty, None, None).unwrap();
    assert!(
        found.to_string().contains("no episode at all"),
        "{found}: a bundle of nothing holds nothing"
    );
    claimed.grid.seeds = (0..1_000_001).collect();
    vast.manifest = canonical_json(&claimed).into_bytes();
    let refused = verify(&vast, None, None).unwrap_err().to_string();
    assert!(
        refused.contains("1000001 episodes, and 1000000 is the most"),
        "{refused}"
    );
}

#[test]
fn who_signed_is_told_and_demanded() {
    let (lab, other) = (
        Key::of_seed(&[3; 32], "lab"),
        Key::of_seed(&[4; 32], "other"),
    );
    let signed = bundle(&PLAYED[..1], Some(&lab));
    let found = verify(&signed, None, Some(&other.signer())).unwrap();
    assert_eq!(kinds(&found), [FindingKind::Signature].into());
    let unsigned = bundle(&PLAYED[..1], None);
    assert!(verify(&unsigned, None, None).unwrap().holds);
    let found = verify(&unsigned, None, Some(&lab.signer())).unwrap();
    assert_eq!(kinds(&found), [FindingKind::Signature].into());
    // A statement of another bundle under the old signature.
    let mut moved = bundle(&PLAYED[1..2], None);
    moved.signature.clone_from(&signed.signature);
    assert_eq!(
        kinds(&verify(&moved, None, None).unwrap()),
        [FindingKind::Signature].into()
    );
    // The point of the curve for which everybody can make signatures.
    let weak = "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIAEAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";
    let refused = Signer::from_openssh(weak).unwrap_err().to_string();
    assert!(refused.contains("weak key"), "{refused}");
}

#[test]
fn what_is_no_one_run_is_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let refused = |made: BundleInputs<'_>| {
        make(made, Path::new(scratch.path()))
            .unwrap_err()
            .to_string()
    };
    let mut incomplete = made(&PLAYED, None);
    incomplete.partial = false;
    let text = refused(incomplete);
    assert!(
        text.contains("21 of 28 episodes are missing") && text.contains("--partial"),
        "{text}"
    );
    let text = refused(made(&[PLAYED[0], "FODP_workshop_fall--oracle--0"], None));
    assert!(text.contains("was played with"), "{text}");
    let text = refused(made(&[PLAYED[0], PLAYED[0]], None));
    assert!(text.contains("are both"), "{text}");
    let text = refused(made(&[], None));
    assert!(text.contains("none that was played to its end"), "{text}");
}
