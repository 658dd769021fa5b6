//! Each kind of damage is found, by the check and the kind that name it.

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow::{
    array::{
        ArrayRef, AsArray, Float32Array, Float64Array, Int64Array, ListArray, RecordBatch,
        UInt32Array,
    },
    buffer::OffsetBuffer,
    compute::{concat_batches, take},
    datatypes::{Field, Float32Type, Int64Type, Schema},
};
use parquet::arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder};
use reel_dataset::lint::Severity;
use reel_lerobot::{
    CAMERA,
    lint::{LeRobotLintError, is_lerobot, lint},
};
use serde_json::{Value, json};

use crate::export::{SETTINGS, export, traces};

const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";

/// What every damage begins from.
struct Datasets {
    folder: tempfile::TempDir,
    whole: PathBuf,
}

impl Datasets {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let traces = traces(folder.path());
        let whole = folder.path().join("whole");
        export(&whole, SETTINGS, [&traces[0], &traces[1], &traces[0]]);
        Self { folder, whole }
    }

    /// Damages a copy; the findings as `check/kind`, without the episode that is there twice.
    fn found(&self, name: &str, damage: impl FnOnce(&Path)) -> Vec<String> {
        let root = self.folder.path().join(name);
        copy(&self.whole, &root);
        damage(&root);
        assert!(is_lerobot(&root));
        let report = lint(&root, 2, |_| ()).unwrap();
        let kinds = report.checks.iter().flat_map(|check| {
            check
                .kinds
                .keys()
                .map(move |kind| format!("{}/{kind}", check.check))
        });
        kinds.filter(|kind| kind != "duplicates/episode").collect()
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

fn edit(path: PathBuf, change: impl FnOnce(&mut Value)) {
    let mut value: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut value);
    fs::write(path, value.to_string()).unwrap();
}

fn info(change: impl FnOnce(&mut Value)) -> impl FnOnce(&Path) {
    |root| edit(root.join("meta/info.json"), change)
}

/// Writes a table anew with one column changed.
fn column(
    file: &'static str,
    name: &'static str,
    change: impl Fn(&ArrayRef) -> ArrayRef,
) -> impl FnOnce(&Path) {
    move |root| rewrite(root, file, name, &change)
}

fn rewrite(root: &Path, file: &str, name: &str, change: &dyn Fn(&ArrayRef) -> ArrayRef) {
    let path = root.join(file);
    let reader = ParquetRecordBatchReaderBuilder::try_new(File::open(&path).unwrap()).unwrap();
    let schema = reader.schema().clone();
    let batches: Vec<RecordBatch> = reader.build().unwrap().map(Result::unwrap).collect();
    let mut writer =
        ArrowWriter::try_new(File::create(&path).unwrap(), schema.clone(), None).unwrap();
    for batch in batches {
        let index = schema.index_of(name).unwrap();
        let mut columns = batch.columns().to_vec();
        columns[index] = change(&columns[index]);
        writer
            .write(&RecordBatch::try_new(schema.clone(), columns).unwrap())
            .unwrap();
    }
    writer.close().unwrap();
}

fn integers(change: impl Fn(usize, i64) -> i64) -> impl Fn(&ArrayRef) -> ArrayRef {
    move |column| {
        let values = column
            .as_primitive::<Int64Type>()
            .values()
            .iter()
            .enumerate();
        Arc::new(
            values
                .map(|(row, value)| change(row, *value))
                .collect::<Int64Array>(),
        )
    }
}

fn floats(change: impl Fn(usize, f32) -> f32) -> impl Fn(&ArrayRef) -> ArrayRef {
    move |column| {
        let values = column
            .as_primitive::<Float32Type>()
            .values()
            .iter()
            .enumerate();
        Arc::new(
            values
                .map(|(row, value)| change(row, *value))
                .collect::<Float32Array>(),
        )
    }
}

/// Adds a column to the frames, and its feature to `info.json`.
fn add_column(
    root: &Path,
    name: &str,
    feature: Value,
    values: impl FnOnce(&RecordBatch) -> ArrayRef,
) {
    let path = root.join(DATA);
    let reader = ParquetRecordBatchReaderBuilder::try_new(File::open(&path).unwrap()).unwrap();
    let schema = reader.schema().clone();
    let batches: Vec<RecordBatch> = reader.build().unwrap().map(Result::unwrap).collect();
    let frames = concat_batches(&schema, &batches).unwrap();
    let added = values(&frames);
    let mut fields: Vec<Arc<Field>> = schema.fields().iter().cloned().collect();
    fields.push(Arc::new(Field::new(name, added.data_type().clone(), true)));
    let schema = Arc::new(Schema::new(fields));
    let mut columns = frames.columns().to_vec();
    columns.push(added);
    let mut writer =
        ArrowWriter::try_new(File::create(&path).unwrap(), schema.clone(), None).unwrap();
    writer
        .write(&RecordBatch::try_new(schema, columns).unwrap())
        .unwrap();
    writer.close().unwrap();
    edit(root.join("meta/info.json"), |info| {
        info["features"][name] = feature
    });
}

/// Makes lists of so many values each.
fn lists(length: usize, values: ArrayRef) -> ArrayRef {
    let item = Arc::new(Field::new("element", values.data_type().clone(), true));
    let lengths = std::iter::repeat_n(length, values.len() / length);
    Arc::new(ListArray::new(
        item,
        OffsetBuffer::from_lengths(lengths),
        values,
        None,
    ))
}

#[test]
fn damage_of_the_metadata_is_found() {
    let datasets = Datasets::new();
    let found = |name: &str, change: fn(&mut Value)| datasets.found(name, info(change));
    assert_eq!(datasets.found("none", |_| ()), Vec::<String>::new());
    assert_eq!(
        found("frames", |info| info["total_frames"] = json!(7)),
        ["metadata/total"]
    );
    assert_eq!(
        found("tasks", |info| drop(
            info.as_object_mut().unwrap().remove("total_tasks")
        )),
        ["metadata/missing"]
    );
    assert_eq!(
        found("fps", |info| info["fps"] = json!(2)),
        [
            "frames/timestamp",
            "videos/fps",
            "videos/length",
            "videos/too-short"
        ]
    );
    assert_eq!(
        found("type", |info| info["features"]["action"]["dtype"] =
            json!("float64")),
        ["features/type"]
    );
    assert_eq!(
        found(
            "goal",
            |info| info["features"]["observation.state"]["names"][0] = json!("goal_x")
        ),
        ["leaks/name"]
    );
    assert_eq!(
        found("undeclared", |info| drop(
            info["features"]
                .as_object_mut()
                .unwrap()
                .remove("next.done")
        )),
        ["features/undeclared"]
    );
    assert_eq!(
        found("missing", |info| info["features"]["observation.force"] =
            json!({"dtype": "float32", "shape": [3]})),
        ["features/missing"]
    );
    let stats = datasets.found("stats", |root| {
        edit(root.join("meta/stats.json"), |stats| {
            stats["action"]["mean"][0] = json!(40.0)
        });
    });
    assert_eq!(stats, ["statistics/differs"]);
    for (name, quantile, value) in [("q50", "q50", -40.0), ("q99", "q99", 40.0)] {
        let quantiles = datasets.found(name, |root| {
            edit(root.join("meta/stats.json"), |stats| {
                stats["action"][quantile][0] = json!(value)
            });
        });
        assert_eq!(quantiles, ["statistics/quantiles"]);
    }
    let tasks = |name, change: fn(usize, i64) -> i64| {
        let change = column("meta/tasks.parquet", "task_index", integers(change));
        datasets.found(name, change)
    };
    assert_eq!(
        tasks("swapped-tasks", |_, task| 1 - task),
        ["metadata/task"]
    );
    assert_eq!(
        tasks("one-task", |_, _| 0),
        ["metadata/repeated-task", "metadata/task", "frames/task"]
    );
}

#[test]
fn statistics_of_arrays_are_compared_over_the_axis_that_lerobot_keeps() {
    let datasets = Datasets::new();
    let found = |name: &str, statistics: &dyn Fn(f64) -> Value| {
        datasets.found(name, |root| {
            let feature = json!({"dtype": "float64", "shape": [2, 3], "names": null});
            add_column(root, "observation.touch", feature, |frames| {
                let values = (0..6 * frames.num_rows()).map(|at| (at / 6 * 10 + at % 6) as f64);
                lists(2, lists(3, Arc::new(values.collect::<Float64Array>())))
            });
            edit(root.join("meta/stats.json"), |stats| {
                let count = stats["action"]["count"][0].as_f64().unwrap();
                stats["observation.touch"] = statistics(count);
            });
        })
    };
    let variance_of_frames = |count: f64| 100.0 * (count * count - 1.0) / 12.0;
    let last_axis = |count: f64| {
        let last = 10.0 * (count - 1.0);
        let deviation = (variance_of_frames(count) + 2.25).sqrt();
        json!({
            "min": [0.0, 1.0, 2.0],
            "max": [last + 3.0, last + 4.0, last + 5.0],
            "mean": [last / 2.0 + 1.5, last / 2.0 + 2.5, last / 2.0 + 3.5],
            "std": [deviation, deviation, deviation],
            "count": [count],
            "q50": [last / 2.0, last / 2.0 + 1.0, last / 2.0 + 2.0],
        })
    };
    assert_eq!(found("last-axis", &last_axis), Vec::<String>::new());
    let wrong = |count: f64| {
        let mut statistics = last_axis(count);
        statistics["mean"][1] = json!(-1.0);
        statistics
    };
    assert_eq!(found("wrong", &wrong), ["statistics/differs"]);
    // So LeRobot writes episodes of one frame.
    let each_number = |count: f64| {
        let last = 10.0 * (count - 1.0);
        let deviation = variance_of_frames(count).sqrt();
        let numbers = |first: f64| {
            json!([
                [first, first + 1.0, first + 2.0],
                [first + 3.0, first + 4.0, first + 5.0]
            ])
        };
        json!({
            "min": numbers(0.0),
            "max": numbers(last),
            "mean": numbers(last / 2.0),
            "std": [[deviation, deviation, deviation], [deviation, deviation, deviation]],
            "count": [count],
        })
    };
    assert_eq!(found("each-number", &each_number), Vec::<String>::new());
}

#[test]
fn statistics_of_bookkeeping_columns_are_warnings() {
    let datasets = Datasets::new();
    let report = |name: &str, columns: &[&str]| {
        let root = datasets.folder.path().join(name);
        copy(&datasets.whole, &root);
        edit(root.join("meta/stats.json"), |stats| {
            for column in columns {
                stats[column]["max"][0] = json!(1e6);
                stats[column]["q99"][0] = json!(1e6);
            }
        });
        lint(&root, 2, |_| ()).unwrap()
    };
    let bookkeeping = [
        "timestamp",
        "frame_index",
        "episode_index",
        "index",
        "task_index",
    ];
    let cut = report("cut", &bookkeeping);
    let statistics = cut.check("statistics").unwrap();
    assert_eq!(statistics.worst, Some(Severity::Warning));
    assert_eq!(
        Vec::from_iter(statistics.kinds.clone()),
        [("bookkeeping", 10)]
    );
    let message = &statistics.examples[0].message;
    assert!(message.contains("no trainer reads it"), "{message}");
    assert!(!cut.is_bad());
    let action = report("action", &["index", "action"]);
    assert_eq!(
        action.check("statistics").unwrap().worst,
        Some(Severity::Error)
    );
    assert!(action.is_bad());
}

#[test]
fn splits_that_cross_are_found() {
    let datasets = Datasets::new();
    let found =
        |name: &str, splits: Value| datasets.found(name, info(move |info| info["splits"] = splits));
    assert_eq!(
        found("overlap", json!({"train": "0:3", "test": "2:3"})),
        [
            "splits/overlap",
            "splits/shared-task",
            "duplicates/across-splits"
        ]
    );
    assert_eq!(
        found("left-out", json!({"train": "0:2"})),
        ["splits/left-out", "duplicates/across-splits"]
    );
    assert_eq!(
        found("range", json!({"train": "0:3", "test": "3:9"})),
        ["splits/range"]
    );
    assert_eq!(
        found("repeated", json!({"train": "0:2", "test": "2:3"})),
        ["splits/shared-task", "duplicates/across-splits"]
    );
    assert_eq!(found("none", json!({})), ["splits/missing"]);
}

#[test]
fn damage_of_the_frames_is_found() {
    let datasets = Datasets::new();
    let found = |name: &str, damage: Box<dyn FnOnce(&Path)>| datasets.found(name, damage);
    let shifted = column(
        DATA,
        "frame_index",
        integers(|row, value| value + i64::from(row == 1)),
    );
    assert_eq!(
        found("frame", Box::new(shifted)),
        ["frames/frame-index", "statistics/bookkeeping"]
    );
    let task = column(
        DATA,
        "task_index",
        integers(|row, value| if row == 0 { 9 } else { value }),
    );
    assert_eq!(
        found("task", Box::new(task)),
        ["frames/task", "statistics/bookkeeping"]
    );
    let late = column(
        DATA,
        "timestamp",
        floats(|row, value| if row == 2 { value + 0.01 } else { value }),
    );
    assert_eq!(
        found("late", Box::new(late)),
        ["frames/timestamp", "statistics/bookkeeping"]
    );
    let nan = column(
        DATA,
        "next.reward",
        floats(|row, value| if row == 2 { f32::NAN } else { value }),
    );
    assert_eq!(
        found("nan", Box::new(nan)),
        ["frames/not-finite", "statistics/differs"]
    );
    let length = column(
        EPISODES,
        "length",
        integers(|row, value| value + i64::from(row == 1)),
    );
    assert_eq!(
        found("length", Box::new(length)),
        ["episodes/frame-count", "episodes/length", "videos/length"]
    );
    let gap = column(
        EPISODES,
        "dataset_from_index",
        integers(|row, value| value + i64::from(row == 2)),
    );
    assert_eq!(
        found("gap", Box::new(gap)),
        ["episodes/first-index", "episodes/length", "episodes/range"]
    );
    let torn = |root: &Path| {
        let bytes = fs::read(root.join(DATA)).unwrap();
        fs::write(root.join(DATA), &bytes[..bytes.len() / 2]).unwrap();
    };
    assert!(found("torn", Box::new(torn)).contains(&"episodes/unreadable".to_owned()));
    // An observation that is the reward under another name.
    let told = |root: &Path| {
        let feature = json!({"dtype": "float32", "shape": [1], "names": null});
        add_column(root, "observation.sensor", feature, |frames| {
            frames.column_by_name("next.reward").unwrap().clone()
        });
    };
    assert_eq!(
        found("told", Box::new(told)),
        ["statistics/missing", "leaks/equal"]
    );
}

#[test]
fn damage_of_the_videos_is_found() {
    let datasets = Datasets::new();
    let video = |root: &Path| {
        root.join("videos")
            .join(CAMERA)
            .join("chunk-000/file-000.mp4")
    };
    let gone = datasets.found("gone", |root| fs::remove_file(video(root)).unwrap());
    assert_eq!(gone, ["videos/missing"]);
    let torn = datasets.found("torn", |root| {
        let bytes = fs::read(video(root)).unwrap();
        fs::write(video(root), &bytes[..bytes.len() / 2]).unwrap();
    });
    assert_eq!(torn, ["videos/unreadable"]);
    // The video of fewer episodes.
    let short = datasets.found("short", |root| {
        let traces = traces(datasets.folder.path());
        let other = datasets.folder.path().join("other");
        export(&other, SETTINGS, &traces);
        fs::copy(video(&other), video(root)).unwrap();
    });
    assert_eq!(short, ["videos/too-short"]);
    // Images of another size than info.json gives, with names of the sides and without.
    let size = |name: &str, change: fn(&mut Value)| {
        datasets.found(name, info(|info| change(&mut info["features"][CAMERA])))
    };
    let narrow = |camera: &mut Value| camera["shape"][1] = json!(7);
    assert_eq!(size("size", narrow), ["videos/size"]);
    assert_eq!(
        size("unnamed", |camera| {
            camera["names"] = Value::Null;
            camera["shape"][1] = json!(7);
        }),
        ["videos/size"]
    );
    let unnamed = |camera: &mut Value| camera["names"] = Value::Null;
    assert_eq!(size("right", unnamed), Vec::<String>::new());
    // The first and the last episode are one trace: their places exchanged are as long as before.
    let from = format!("videos/{CAMERA}/from_timestamp");
    let to = format!("videos/{CAMERA}/to_timestamp");
    let swapped = datasets.found("swapped", |root| {
        for name in [from, to] {
            rewrite(root, EPISODES, &name, &|column| {
                let last = column.len() - 1;
                let order = (0..column.len()).map(|row| match row {
                    0 => last as u32,
                    row if row == last => 0,
                    row => row as u32,
                });
                take(column, &UInt32Array::from_iter_values(order), None).unwrap()
            });
        }
    });
    assert_eq!(swapped, ["videos/order"]);
}

#[test]
fn what_cannot_be_checked_at_all_is_said() {
    let folder = tempfile::tempdir().unwrap();
    assert!(!is_lerobot(folder.path()));
    assert!(matches!(
        lint(folder.path(), 1, |_| ()),
        Err(LeRobotLintError::Read { .. })
    ));
    fs::create_dir(folder.path().join("meta")).unwrap();
    fs::write(
        folder.path().join("meta/info.json"),
        r#"{"codebase_version": "v3.0", "fps": 0}"#,
    )
    .unwrap();
    assert!(is_lerobot(folder.path()));
    assert!(matches!(
        lint(folder.path(), 1, |_| ()),
        Err(LeRobotLintError::Info { .. })
    ));
}
