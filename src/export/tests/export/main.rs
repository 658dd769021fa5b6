//! Training sets out of a store of played episodes: what a row holds, what is refused, equal
//! bytes, going on after a break, rollout groups, notes, and that the loaders get the frames
//! that are drawn again.

mod buckets;
mod gspo;
mod played;

use reel_vectors::episodes;
use std::{
    collections::BTreeMap,
    fs,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use episodes::{record_seeded, relink, tasks, write};
use played::{Played, play};
use reel_annotate::{Annotation, Entry, Provenance, notes_path, write_notes};
use reel_dataset::{Format, ImageOptions, Ratios, Split, Style, WriterOptions};
use reel_export::{
    AnnotationSource, ExportError, ExportOptions, ExportReport, RolloutOptions, Selection, SplitBy,
};
use reel_tables::Store;
use reel_trace::{Images, Trace};
use reel_world::record::{PolicyOutput, StepRecord};
use serde_json::Value;
use tempfile::TempDir;

fn options(format: Format) -> ExportOptions {
    ExportOptions {
        selection: Selection::default(),
        writer: WriterOptions {
            rows_max: 20,
            ..WriterOptions::new(format)
        },
        style: Style::SingleTurn,
        prompt: reel_prompt::Prompt::builtin(),
        words: AnnotationSource::Auto,
        split_by: SplitBy::Task,
        ratios: Ratios::new([1.0, 0.0, 0.0]).unwrap(),
        images: false,
        allow_unverified: false,
        replay: true,
        rollouts: None,
        tokenizer: None,
        name: "test".into(),
        licence: "MIT".into(),
        command: "reel export sft".into(),
    }
}

fn export(store: &Store, out: &Path, options: &ExportOptions) -> ExportReport {
    reel_export::export(store, out, options, &|_| (), &|_| ()).unwrap()
}

/// Every file of a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(
                    path.strip_prefix(folder).unwrap().display().to_string(),
                    fs::read(&path).unwrap(),
                );
            }
        }
    }
    found
}

/// The rows of a part, each a line of JSON.
fn rows(folder: &Path, split: &str) -> Vec<Value> {
    let files = files(&folder.join(split));
    files
        .values()
        .flat_map(|bytes| {
            String::from_utf8(bytes.clone())
                .unwrap()
                .lines()
                .map(line)
                .collect::<Vec<_>>()
        })
        .collect()
}

fn line(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn every_row_names_its_verified_trace_and_what_cannot_be_trusted_is_refused() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let good = play(&traces, "oracle", Images::None);
    // one whose outcome is not what its inputs give; and after ingest one that was changed, one
    // recorded anew, one that is gone
    let Played {
        diverging,
        changed,
        renewed,
        gone,
    } = Played::spoilt(&traces);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths: Vec<_> = good
        .iter()
        .chain([&diverging, &changed, &renewed, &gone])
        .cloned()
        .collect();
    let ingested = store.ingest(&paths, &|_, _| ()).unwrap();
    assert_eq!(
        (ingested.added, ingested.quarantined.len()),
        (8, 0),
        "{:?}",
        ingested.quarantined
    );
    fs::remove_file(&renewed).unwrap();
    record_seeded(&renewed, &tasks()[0], "oracle", 99, Images::None);
    let mut bytes = fs::read(&changed).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&changed, bytes).unwrap();
    fs::remove_file(&gone).unwrap();

    let report = export(&store, &dir.path().join("sft"), &options(Format::Trl));
    assert_eq!((report.episodes, report.unverified), (4, 0));
    let reason = |path: &Path| {
        let path = path.display().to_string();
        report
            .refused
            .iter()
            .find(|refusal| refusal.trace == path)
            .map(|refusal| refusal.reason.clone())
            .unwrap()
    };
    assert_eq!(report.refused.len(), 4, "{:?}", report.refused);
    assert!(
        reason(&renewed).starts_with("the file holds another recording"),
        "{}",
        reason(&renewed)
    );
    assert!(
        reason(&diverging).starts_with("diverged: DIVERGED"),
        "{}",
        reason(&diverging)
    );
    assert!(
        reason(&changed).starts_with("refused: "),
        "{}",
        reason(&changed)
    );
    assert!(
        reason(&gone).starts_with("the trace cannot be read"),
        "{}",
        reason(&gone)
    );
    let rows = rows(&dir.path().join("sft"), "train");
    assert_eq!(rows.len() as u64, report.examples[&Split::Train]);
    for row in &rows {
        let row = row["provenance"].as_object().unwrap();
        assert_eq!(
            (row["verdict"].as_str(), row["preset"].as_str()),
            (Some("exact"), Some("paper"))
        );
        assert_eq!(row["table_version"], store.version());
        assert!(
            good.iter()
                .any(|path| row["trace_uri"] == path.display().to_string())
        );
        for digest in ["trace_digest", "preset_digest"] {
            assert_eq!(row[digest].as_str().unwrap().len(), 64);
        }
    }

    // a second export replays nothing; asked for, the unverified come too, and say so
    assert_eq!(store.verdicts().unwrap().len(), 7);
    let known = ExportOptions {
        replay: false,
        ..options(Format::Trl)
    };
    assert_eq!(
        export(&store, &dir.path().join("known"), &known).episodes,
        4
    );
    assert_eq!(store.verdicts().unwrap().len(), 7);
    let all = ExportOptions {
        allow_unverified: true,
        ..options(Format::Trl)
    };
    let report = export(&store, &dir.path().join("all"), &all);
    assert_eq!((report.episodes, report.refused.len()), (8, 0));
    let unverified = self::rows(&dir.path().join("all"), "train")
        .iter()
        .filter(|row| row["provenance"]["verdict"] == "unverified")
        .count();
    assert!(unverified > 0 && report.unverified == unverified as u64);
}

#[test]
fn equal_stores_and_options_give_equal_bytes() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store
        .ingest(&play(&traces, "oracle", Images::Full), &|_, _| ())
        .unwrap();
    let how = ExportOptions {
        images: true,
        ratios: Ratios::new([0.5, 0.25, 0.25]).unwrap(),
        writer: WriterOptions {
            images: ImageOptions::default(),
            ..options(Format::MsSwift).writer
        },
        ..options(Format::MsSwift)
    };
    let on = |threads: usize, name: &str, store: &Store| {
        let out = dir.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| export(store, &out, &how));
        files(&out)
    };
    let one = on(1, "one", &store);
    assert!(one.len() > 10, "{:?}", one.keys());
    assert!(one == on(2, "two", &store), "the number of threads shows");

    // the same version after more was ingested
    let version = store.version();
    store
        .ingest(
            &play(&dir.path().join("more"), "planner", Images::None),
            &|_, _| (),
        )
        .unwrap();
    assert!(store.version() > version);
    let before = Store::open_at(dir.path().join("store"), version).unwrap();
    assert!(one == on(2, "before", &before), "what came later shows");

    // broken off in the middle: the same call goes on
    let out = dir.path().join("broken");
    let written = AtomicUsize::new(0);
    let breaks = |_: usize| {
        assert!(
            written.fetch_add(1, Ordering::Relaxed) < 2,
            "broken off on purpose"
        )
    };
    catch_unwind(AssertUnwindSafe(|| {
        reel_export::export(&before, &out, &how, &|_| (), &breaks)
    }))
    .unwrap_err();
    let left = files(&out);
    assert!(
        left.keys().any(|name| name.starts_with("images/")) && !left.contains_key("manifest.json")
    );
    export(&before, &out, &how);
    assert!(one == files(&out), "the break shows");

    // killed before it was whole: with its last files there, with an image half written
    std::fs::write(out.join(".export.jsonl"), "").unwrap();
    std::fs::remove_file(out.join("manifest.json")).unwrap();
    let image = one.keys().find(|name| name.starts_with("images/")).unwrap();
    std::fs::write(out.join(image).with_file_name("7.part"), "half").unwrap();
    export(&before, &out, &how);
    assert!(one == files(&out), "the kill shows");

    // what is whole is not overwritten
    let error = reel_export::export(&before, &out, &how, &|_| (), &|_| ()).unwrap_err();
    assert!(matches!(error, ExportError::OtherDataset { .. }), "{error}");
}

#[test]
fn another_store_of_the_same_traces_gives_the_same_bytes() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    // a file of the table each, whose names are drawn
    let of = |name: &str| {
        let mut store = Store::open_or_create(dir.path().join(name)).unwrap();
        for trace in &traces {
            store
                .ingest(std::slice::from_ref(trace), &|_, _| ())
                .unwrap();
        }
        export(
            &store,
            &dir.path().join(name).with_extension("sft"),
            &options(Format::Trl),
        );
        files(&dir.path().join(name).with_extension("sft"))
    };
    let first = of("first");
    assert!(
        first == of("second") && first == of("third"),
        "which store it was shows"
    );
}

#[test]
fn mistakes_are_no_examples_but_recoveries_are() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store
        .ingest(
            &play(&dir.path().join("traces"), "wrong-object", Images::None),
            &|_, _| (),
        )
        .unwrap();
    let count = |name: &str, selection: Selection| {
        let report = export(
            &store,
            &dir.path().join(name),
            &ExportOptions {
                selection,
                ..options(Format::Trl)
            },
        );
        (
            report.episodes,
            report.examples.values().sum::<u64>(),
            report.excluded,
        )
    };
    let all = Selection {
        failed: true,
        mistakes: true,
        ..Selection::default()
    };
    let (episodes, everything, left_out) = count("all", all.clone());
    assert!(episodes > 0 && left_out.is_empty(), "{left_out:?}");
    let (_, without, left_out) = count(
        "without",
        Selection {
            mistakes: false,
            ..all.clone()
        },
    );
    let mistakes = left_out["decisions that were mistakes"];
    assert!(mistakes > 0);
    assert_eq!(without + mistakes, everything);
    let (_, fewer, left_out) = count(
        "fewer",
        Selection {
            mistakes: false,
            recoveries: false,
            ..all.clone()
        },
    );
    assert_eq!(
        fewer + mistakes + left_out["decisions right after a mistake"],
        everything
    );
    let (episodes, none, left_out) = count("won", Selection::default());
    assert_eq!(
        left_out
            .get("episodes that did not succeed")
            .copied()
            .unwrap_or(0)
            + episodes,
        4,
        "{none}"
    );
    // at most one a task, and no tool beyond the median
    let (_, balanced, left_out) = count(
        "balanced",
        Selection {
            balance_tools: true,
            ..all
        },
    );
    assert_eq!(
        balanced + left_out["decisions beyond the median tool's"],
        everything
    );
}

#[test]
fn the_loaders_get_the_frames_that_are_drawn_again() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces[..2], &|_, _| ()).unwrap();
    let sets = dir.path().join("sets");
    for format in Format::ALL {
        let unscaled = ImageOptions {
            pixels_max: None,
            ..ImageOptions::default()
        };
        let writer = WriterOptions {
            images: unscaled,
            ..options(format).writer
        };
        let report = export(
            &store,
            &sets.join(format.as_str()),
            &ExportOptions {
                images: true,
                writer,
                ..options(format)
            },
        );
        assert_eq!(report.episodes, 2, "{}", format.as_str());
    }
    assert!(!sets.join("parquet/images").exists() && !sets.join("parquet/.images").exists());
    // every row's frame, drawn again; the first decision of an episode is shown none,
    // as with REAL's trainer
    let frames: Vec<u8> = rows(&sets.join("trl"), "train")
        .iter()
        .filter(|row| row["provenance"]["call"] != 0)
        .flat_map(|row| {
            let provenance = &row["provenance"];
            let trace = Trace::read(Path::new(provenance["trace_uri"].as_str().unwrap())).unwrap();
            let before =
                |step: &&StepRecord| u64::from(step.step) < provenance["call"].as_u64().unwrap();
            let latest = trace
                .steps
                .iter()
                .filter(before)
                .rfind(|step| step.digests.frame.is_some());
            let frame = reel_replay::frame_at(&trace, latest.map(|step| step.step), None);
            frame.unwrap().rgb
        })
        .collect();
    let file = dir.path().join("frames.rgb");
    fs::write(&file, frames).unwrap();
    let mut command = reel_vectors::script("bash", "loaders/run.sh");
    let said = reel_vectors::run(command.arg(&sets).env("REEL_FRAMES", &file));
    for format in Format::ALL {
        assert!(
            said.contains(&format!(" {}: ", format.as_str())),
            "{} was asked of no loader: {said}",
            format.as_str()
        );
    }
    assert!(
        !said.contains("decoded\n"),
        "images that were compared with nothing: {said}"
    );
}

#[test]
fn rollouts_are_worth_what_they_are_better_than_their_group() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let folder = dir.path().join("traces");
    fs::create_dir_all(&folder).unwrap();
    let mut paths = Vec::new();
    for (task, count) in [(0, 3), (1, 1)] {
        for seed in 0..count {
            let path = folder.join(format!("{task}-{seed}.mcap"));
            paths.push(record_seeded(
                &path,
                &tasks()[task],
                "explorer",
                seed,
                Images::None,
            ));
        }
    }
    store.ingest(&paths, &|_, _| ()).unwrap();
    let rl = |name: &str, rollouts: RolloutOptions| {
        let selection = Selection {
            failed: true,
            mistakes: true,
            after_decisive: true,
            contradictions: true,
            ..Selection::default()
        };
        let how = ExportOptions {
            selection,
            rollouts: Some(rollouts),
            ..options(Format::Trl)
        };
        export(&store, &dir.path().join(name), &how)
    };
    let report = rl("all", RolloutOptions::default());
    let rows = rows(&dir.path().join("all"), "train");
    assert_eq!(
        (report.episodes, &report.excluded),
        (
            3,
            &BTreeMap::from([("episodes of groups with too few rollouts", 1)])
        )
    );
    let task: Vec<String> =
        serde_json::from_slice(&fs::read(dir.path().join("all/tasks.json")).unwrap()).unwrap();
    assert_eq!(task, [rows[0]["provenance"]["task"].as_str().unwrap()]);
    // rewards, returns and advantages by hand
    let mut episodes: BTreeMap<&str, Vec<&Value>> = BTreeMap::new();
    rows.iter().for_each(|row| {
        episodes
            .entry(row["provenance"]["episode"].as_str().unwrap())
            .or_default()
            .push(row)
    });
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap();
    let returns: Vec<f64> = episodes
        .values()
        .map(|rows| {
            rows.iter()
                .map(|row| number(row, "reward") * 0.99_f64.powi(number(row, "step") as i32))
                .sum()
        })
        .collect();
    let mean = returns.iter().sum::<f64>() / 3.0;
    let deviation = (returns
        .iter()
        .map(|it| (it - mean) * (it - mean))
        .sum::<f64>()
        / 3.0)
        .sqrt();
    assert!(deviation > 0.1, "{returns:?}");
    for ((rows, worth), rollout) in episodes.values().zip(&returns).zip(0..) {
        for row in rows {
            assert_eq!(
                (row["group_size"].as_u64(), row["rollout"].as_u64()),
                (Some(3), Some(rollout))
            );
            assert_eq!(row["steps"].as_u64().unwrap() as usize, rows.len());
            assert!((number(row, "return") - worth).abs() < 1e-9, "{row}");
            assert!(
                (number(row, "advantage") - (worth - mean) / (deviation + 1e-6)).abs() < 1e-9,
                "{row}"
            );
        }
    }
    let report = rl(
        "two",
        RolloutOptions {
            group_size: Some(2),
            ..RolloutOptions::default()
        },
    );
    assert_eq!(
        (
            report.episodes,
            report.excluded["episodes beyond the size of their group"]
        ),
        (2, 1)
    );
    let report = rl(
        "seeds",
        RolloutOptions {
            same_seed: true,
            ..RolloutOptions::default()
        },
    );
    assert_eq!(report.episodes, 0, "no two have the same seed");
}

#[test]
fn words_come_from_the_notes_beside_the_traces() {
    let dir = TempDir::new().unwrap();
    let traces = play(&dir.path().join("traces"), "oracle", Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&traces[..2], &|_, _| ()).unwrap();
    let trace = Trace::read(&traces[0]).unwrap();
    let note = Annotation {
        reasoning: "I wonder.".into(),
        history: "I went on.".into(),
        schedule: "All of it.".into(),
        subtask: "This.".into(),
    };
    let (version, steps) = (reel_world::Digest::of(b"prompt"), trace.steps.len());
    let provenance = Provenance {
        request: None,
        trace: trace.chain(),
        steps,
        annotator: "a-model".into(),
        version,
        seed: 0,
    };
    let entries = vec![Entry::from(note); steps];
    write_notes(&notes_path(&traces[0]), &provenance, &entries).unwrap();
    let report = export(
        &store,
        &dir.path().join("notes"),
        &ExportOptions {
            words: AnnotationSource::Notes,
            ..options(Format::MsSwift)
        },
    );
    assert_eq!((report.episodes, report.refused.len()), (1, 1));
    assert!(
        report.refused[0]
            .reason
            .contains("annotate the trace first"),
        "{:?}",
        report.refused
    );
    for row in rows(&dir.path().join("notes"), "train") {
        assert_eq!(
            row["provenance"]["annotator"],
            format!("a-model-{}", version.short())
        );
        assert!(
            row["messages"][1]["content"]
                .as_str()
                .unwrap()
                .starts_with("<think>I wonder.</think>")
        );
    }
}

#[test]
fn a_models_own_history_is_mended_left_out_or_left_alone() {
    let dir = TempDir::new().unwrap();
    let traces = dir.path().join("traces");
    let path = play(&traces, "oracle", Images::None).remove(0);
    // a model said of the third decision what never happened, and of the fourth what did
    let mut trace = Trace::read(&path).unwrap();
    let said = |history: &str| PolicyOutput {
        raw: "as it came".into(),
        history: history.into(),
        ..PolicyOutput::default()
    };
    trace.steps[2].input.policy = Some(said("I looked around. I placed the object on bed_1."));
    trace.steps[3].input.policy = Some(said("I looked around."));
    relink(&mut trace);
    fs::remove_file(&path).unwrap();
    write(&path, &trace);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    store.ingest(&[path], &|_, _| ()).unwrap();
    let export = |name: &str, how: ExportOptions| {
        let report = export(&store, &dir.path().join(name), &how);
        let row = rows(&dir.path().join(name), "train")
            .into_iter()
            .find(|row| row["provenance"]["call"] == 2);
        (
            report,
            row.map(|row| {
                row["completion"][0]["content"][0]["text"]
                    .as_str()
                    .unwrap()
                    .to_owned()
            }),
        )
    };
    let (report, row) = export("left-out", options(Format::Trl));
    assert_eq!(
        (
            report.excluded["decisions whose History contradicts the record"],
            row
        ),
        (1, None)
    );
    // it is kept under the checker's version, and not found twice
    let checked = store.checked_traces().unwrap();
    let claims: Vec<_> = checked.iter().flat_map(|trace| &trace.claims).collect();
    assert_eq!((checked.len(), claims.len(), claims[0].step), (1, 1, 2));
    reel_export::check_histories(&store, |_| ()).unwrap();
    assert_eq!(store.checked_traces().unwrap(), checked);
    let all = Selection {
        contradictions: true,
        ..Selection::default()
    };
    let (report, row) = export(
        "mended",
        ExportOptions {
            selection: all.clone(),
            ..options(Format::Trl)
        },
    );
    assert_eq!(report.history.corrected + report.history.dropped, 1);
    assert!(
        row.as_ref()
            .is_some_and(|row| row.contains("I looked around.") && !row.contains("bed_1")),
        "{row:?}"
    );
    // words that nobody exports are no reason
    let (report, row) = export(
        "rules",
        ExportOptions {
            words: AnnotationSource::Rules,
            ..options(Format::Trl)
        },
    );
    assert!(
        !report
            .excluded
            .contains_key("decisions whose History contradicts the record"),
        "{:?}",
        report.excluded
    );
    assert!(row.is_some_and(|row| !row.contains("bed_1")));
    // what is rewarded is what was said
    let alone = RolloutOptions {
        group_size: Some(1),
        ..RolloutOptions::default()
    };
    let (report, row) = export(
        "rollouts",
        ExportOptions {
            selection: all,
            rollouts: Some(alone),
            ..options(Format::Trl)
        },
    );
    assert_eq!(report.history.corrected + report.history.dropped, 0);
    assert!(row.is_some_and(|row| row.contains("I placed the object on bed_1.")));
}
