//! The columns of a dataset: what `info.json` says of them, and their types in Parquet.

use std::{collections::HashMap, sync::Arc};

use arrow::datatypes::{DataType, Field, Fields, Schema};
use reel_world::ToolSpec;
use serde_json::{Map, Value, json};

use crate::episode::ExportSettings;

/// The video of the head camera.
pub const CAMERA: &str = "observation.images.head";
/// What state and action hold, in this order: pose of base and head in the scene's frame, and the gripper.
pub const VECTOR: [&str; 5] = [
    "base_x_m",
    "base_y_m",
    "base_yaw_rad",
    "head_pitch_rad",
    "gripper_holds",
];
/// What a frame shows of its call, by number.
pub const PHASES: [&str; 3] = ["decision", "driving", "physics"];
/// Columns with statistics, in the order of the files.
pub(crate) const NUMERIC: [&str; 12] = [
    "observation.state",
    "action",
    "call.index",
    "call.tool",
    "call.phase",
    "next.reward",
    "next.done",
    "timestamp",
    "frame_index",
    "episode_index",
    "index",
    "task_index",
];
/// The statistics of a column, in the order of `stats.json`.
pub(crate) const STATISTICS: [&str; 10] = [
    "min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99",
];

/// The features of `info.json`.
pub(crate) fn features(settings: &ExportSettings) -> Map<String, Value> {
    let tools: Vec<&str> = ToolSpec::POLICY
        .iter()
        .map(|spec| spec.paper_name)
        .collect();
    let one = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
    let vector = json!({"dtype": "float32", "shape": [VECTOR.len()], "names": VECTOR});
    let video = json!({
        "dtype": "video", "shape": [settings.height, settings.width, 3], "names": ["height", "width", "channels"],
        "info": {
            "video.height": settings.height, "video.width": settings.width, "video.codec": "av1",
            "video.pix_fmt": "yuv420p", "video.fps": settings.fps(), "video.channels": 3,
            "is_depth_map": false, "has_audio": false,
        },
    });
    let named = |names: &[&str]| json!({"dtype": "int64", "shape": [1], "names": null, "info": {"values": names}});
    let mut features = Map::new();
    let mut add = |name: &str, feature: Value| features.insert(name.to_owned(), feature);
    add(CAMERA, video);
    add("observation.state", vector.clone());
    add("action", vector);
    add("call.index", one("int64"));
    add("call.tool", named(&tools));
    add("call.phase", named(&PHASES));
    add("next.reward", one("float32"));
    add("next.done", one("bool"));
    if settings.language {
        let language = json!({"dtype": "language", "shape": [1], "names": null});
        add("language_persistent", language.clone());
        add("language_events", language);
    }
    add("timestamp", one("float32"));
    for name in ["frame_index", "episode_index", "index", "task_index"] {
        add(name, one("int64"));
    }
    features
}

/// The columns of the files below `data`.
pub(crate) fn frame_schema(settings: &ExportSettings) -> Schema {
    let vector = || list(DataType::Float32);
    let fields = [
        ("observation.state", vector()),
        ("action", vector()),
        ("call.index", DataType::Int64),
        ("call.tool", DataType::Int64),
        ("call.phase", DataType::Int64),
        ("next.reward", DataType::Float32),
        ("next.done", DataType::Boolean),
        ("language_persistent", language_rows(true)),
        ("language_events", language_rows(false)),
        ("timestamp", DataType::Float32),
        ("frame_index", DataType::Int64),
        ("episode_index", DataType::Int64),
        ("index", DataType::Int64),
        ("task_index", DataType::Int64),
    ];
    let written = |name: &str| settings.language || !name.starts_with("language_");
    let written = fields.into_iter().filter(|(name, _)| written(name));
    Schema::new(
        written
            .map(|(name, data_type)| Field::new(name, data_type, true))
            .collect::<Vec<_>>(),
    )
}

/// The columns of the files below `meta/episodes`.
pub(crate) fn episode_schema() -> Schema {
    let int = |name: &str| Field::new(name, DataType::Int64, true);
    let float = |name: &str| Field::new(name, DataType::Float64, true);
    let text = |name: &str| Field::new(name, DataType::Utf8, true);
    let mut fields = vec![
        int("episode_index"),
        Field::new("tasks", list(DataType::Utf8), true),
        int("length"),
        int("data/chunk_index"),
        int("data/file_index"),
        int("dataset_from_index"),
        int("dataset_to_index"),
        int(&format!("videos/{CAMERA}/chunk_index")),
        int(&format!("videos/{CAMERA}/file_index")),
        float(&format!("videos/{CAMERA}/from_timestamp")),
        float(&format!("videos/{CAMERA}/to_timestamp")),
        int("meta/episodes/chunk_index"),
        int("meta/episodes/file_index"),
    ];
    fields.extend(
        [
            "episode_id",
            "task_id",
            "scene_id",
            "policy",
            "trace_digest",
            "verdict",
        ]
        .map(|name| text(&format!("reel/{name}"))),
    );
    fields.push(Field::new("reel/success", DataType::Boolean, true));
    for (column, nested) in NUMERIC
        .map(|name| (name, false))
        .into_iter()
        .chain([(CAMERA, true)])
    {
        for statistic in STATISTICS {
            let data_type = match (statistic, nested) {
                ("count", _) => list(DataType::Int64),
                (_, true) => list(list(list(DataType::Float64))),
                _ => list(DataType::Float64),
            };
            fields.push(Field::new(
                format!("stats/{column}/{statistic}"),
                data_type,
                true,
            ));
        }
    }
    Schema::new(fields)
}

/// The columns of `meta/tasks.parquet`; the task is the index of the frame that pandas makes of it.
pub(crate) fn task_schema() -> Schema {
    let column = |name: &str, kind: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": null});
    let pandas = json!({
        "index_columns": ["task"], "column_indexes": [],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "reel", "version": env!("CARGO_PKG_VERSION")}, "pandas_version": "2.0.0",
    });
    let fields = vec![
        Field::new("task_index", DataType::Int64, true),
        Field::new("task", DataType::Utf8, true),
    ];
    let metadata = HashMap::from([("pandas".to_owned(), pandas.to_string())]);
    Schema::new_with_metadata(fields, metadata)
}

fn list(data_type: DataType) -> DataType {
    DataType::List(Arc::new(Field::new("element", data_type, true)))
}

/// Rows of a language column; those that stay have a time of their own.
fn language_rows(persistent: bool) -> DataType {
    let text = |name: &str, nullable| Field::new(name, DataType::Utf8, nullable);
    let mut fields = vec![
        text("role", true),
        text("content", true),
        text("style", true),
    ];
    if persistent {
        fields.push(Field::new("timestamp", DataType::Float32, true));
    }
    fields.push(text("camera", true));
    let json_type = ("ARROW:extension:name", "arrow.json");
    let metadata = [json_type, ("ARROW:extension:metadata", "")]
        .map(|(key, value)| (key.to_owned(), value.to_owned()));
    let call = Field::new("element", DataType::Utf8, true).with_metadata(HashMap::from(metadata));
    fields.push(Field::new(
        "tool_calls",
        DataType::List(Arc::new(call)),
        true,
    ));
    list(DataType::Struct(Fields::from(fields)))
}
