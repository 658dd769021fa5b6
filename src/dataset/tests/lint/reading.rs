//! The six formats as other people write them, all read into the same turns.

use std::sync::Arc;

use arrow::{
    array::{ArrayRef, BinaryArray, ListArray, RecordBatch, StringArray, StructArray},
    buffer::OffsetBuffer,
    datatypes::{DataType, Field, Fields, Schema},
};
use parquet::arrow::ArrowWriter;
use reel_dataset::lint::{Dataset, Example, Format, ImageSource, Part, Role, show};
use serde_json::json;

use super::{Folder, count, linted, of, open, png};

/// Role and text of each turn, images as `[n]`, calls as they are.
fn turns(example: &Example) -> Vec<(Role, String)> {
    let text = |part: &Part| match part {
        Part::Text(text) => text.clone(),
        Part::Image(number) => format!("[{number}]"),
        Part::Call(call) => call.canonical(),
    };
    example
        .turns
        .iter()
        .map(|turn| (turn.role.clone(), turn.parts.iter().map(text).collect()))
        .collect()
}

fn only(dataset: &Dataset) -> Example {
    let rows: Vec<_> = dataset.rows().collect();
    assert_eq!(rows.len(), 1);
    rows.into_iter()
        .next()
        .expect("one")
        .unwrap_or_else(|error| panic!("{error}"))
}

fn seen_and_said() -> Vec<(Role, String)> {
    vec![
        (Role::User, "[0]what is it?".into()),
        (Role::Assistant, "a cup".into()),
    ]
}

#[test]
fn qwen_vl_as_a_list_and_as_lines() {
    let folder = Folder::new();
    folder.write("view.png", png(364, 273));
    let row = json!({
        "id": "a1",
        "image": "view.png",
        "conversations": [{ "from": "human", "value": "<image>what is it?" }, { "from": "gpt", "value": "a cup" }],
    });
    for (name, text) in [
        ("train.json", format!("[\n{row:#}\n]")),
        ("train.jsonl", row.to_string()),
    ] {
        let dataset = open(&folder.write(name, text));
        let example = only(&dataset);
        assert_eq!(
            (example.format, example.split.as_deref()),
            (Format::QwenVl, Some("train"))
        );
        assert_eq!(turns(&example), seen_and_said());
        assert_eq!(
            example.images[0].source,
            ImageSource::File(folder.path().join("view.png"))
        );
        assert_eq!(example.meta_text(&["id"]).as_deref(), Some("a1"));
        assert!(show(&example).contains("<image 1: 364x273 PNG, view.png>what is it?"));
    }
}

#[test]
fn swift_with_tools_and_calls() {
    let folder = Folder::new();
    let row = json!({
        "messages": [
            { "role": "user", "content": "<image>what is it?" },
            { "role": "tool_call", "content": "{\"name\": \"pick\", \"arguments\": {\"marker_id\": 1}}" },
            { "role": "tool_response", "content": "picked" },
            { "role": "assistant", "content": "a cup" },
        ],
        "images": [{ "path": "gone.png", "bytes": null }],
        "tools": "[{\"type\": \"function\", \"function\": {\"name\": \"pick\", \"parameters\": {}}}]",
    });
    let example = only(&open(&folder.lines("data.jsonl", &[row])));
    assert_eq!(example.format, Format::MsSwift);
    let said = turns(&example);
    assert_eq!(said[1], (Role::ToolCall, r#"pick({"marker_id":1})"#.into()));
    assert_eq!(said[2].0, Role::ToolResult);
    assert!(example.tools.expect("tools").is_array());
}

#[test]
fn sharegpt_as_its_dataset_info_says() {
    let folder = Folder::new();
    let info = json!({ "mine": {
        "file_name": "rows.json", "formatting": "sharegpt",
        "columns": { "messages": "dialogue", "images": "pictures", "system": "instructions" },
        "tags": { "role_tag": "who", "content_tag": "says", "user_tag": "me", "assistant_tag": "robot" },
    }});
    folder.write("dataset_info.json", info.to_string());
    folder.write("view.png", png(28, 28));
    let row = json!([{
        "dialogue": [{ "who": "me", "says": "<image>what is it?" }, { "who": "robot", "says": "a cup" }],
        "pictures": ["view.png"], "instructions": "be brief",
    }]);
    let path = folder.write("rows.json", row.to_string());
    for dataset in [open(&path), open(folder.path())] {
        let example = only(&dataset);
        assert_eq!(example.format, Format::LlamaFactory);
        let said = turns(&example);
        assert_eq!(said[0], (Role::System, "be brief".into()));
        assert_eq!(said[1..], seen_and_said());
        assert_eq!(example.images.len(), 1);
    }
}

#[test]
fn trl_in_its_three_ways() {
    let folder = Folder::new();
    let parts = json!({
        "messages": [
            { "role": "user", "content": [{ "type": "image" }, { "type": "text", "text": "what is it?" }] },
            { "role": "assistant", "content": [{ "type": "text", "text": "a cup" }] },
        ],
        "images": ["a.png"],
    });
    let plain = json!({
        "messages": [{ "role": "user", "content": "what is it?" }, { "role": "assistant", "content": "a cup" }],
        "images": ["a.png"],
    });
    let pair = json!({
        "prompt": [{ "role": "user", "content": "what is it?" }],
        "completion": [{ "role": "assistant", "content": "a cup" }],
        "images": ["a.png"],
    });
    for row in [parts, plain, pair] {
        let example = only(&open(&folder.lines("a.jsonl", &[row])));
        assert_eq!(
            (example.format, turns(&example)),
            (Format::Trl, seen_and_said())
        );
    }
    let words = json!({ "prompt": "one and one", "completion": "two", "rejected": "three" });
    let example = only(&open(&folder.lines("b.jsonl", &[words])));
    assert_eq!(
        turns(&example),
        [
            (Role::User, "one and one".into()),
            (Role::Assistant, "two".into())
        ]
    );
}

#[test]
fn preference_pairs_with_and_without_a_prompt() {
    let folder = Folder::new();
    let said = |text: &str| json!({ "role": "assistant", "content": text });
    let question = json!({ "role": "user", "content": "what is it?" });
    let apart = json!({
        "prompt": [question], "chosen": [said("a cup")], "rejected": [said("a jug")], "images": ["a.png"],
    });
    let whole = json!({
        "chosen": [question, said("a cup")], "rejected": [question, said("a jug")], "images": ["a.png"],
    });
    for (row, before) in [(apart, 0), (whole, 1)] {
        let example = only(&open(&folder.lines("a.jsonl", &[row])));
        assert_eq!(
            (example.format, turns(&example)),
            (Format::Trl, seen_and_said())
        );
        assert_eq!(example.rejected.len(), before + 1);
        let other = example.rejected.last().unwrap();
        assert_eq!(other.parts, [Part::Text("a jug".into())]);
        assert!(example.warnings.is_empty(), "{:?}", example.warnings);
        assert!(show(&example).ends_with("== assistant, rejected ==\na jug\n"));
    }
    let words =
        |chosen: &str| json!({ "prompt": "one and one", "chosen": chosen, "rejected": "three" });
    let report = linted(&folder.lines("b.jsonl", &[words("two"), words("three")]));
    assert_eq!(count(&report, "loader", "pair"), 1, "{report}");
    let half = json!({ "prompt": "one and one", "chosen": "two" });
    let report = linted(&folder.lines("c.jsonl", &[words("two"), half]));
    assert_eq!((report.rows, report.unreadable), (1, 1), "{report}");
}

#[test]
fn openai_with_calls_and_data_urls() {
    let folder = Folder::new();
    let url = "data:image/png;base64,iVBORw0KGgo=";
    let row = json!({ "messages": [
        { "role": "user", "content": [
            { "type": "image_url", "image_url": { "url": url } }, { "type": "text", "text": "what is it?" } ] },
        { "role": "assistant", "content": null, "tool_calls": [
            { "id": "c1", "type": "function", "function": { "name": "pick", "arguments": "{\"marker_id\":1}" } } ] },
        { "role": "tool", "tool_call_id": "c1", "content": "picked" },
        { "role": "assistant", "content": "a cup" },
    ]});
    let path = folder.lines("chat.jsonl", &[row]);
    let example = only(&open(&path));
    assert_eq!(example.format, Format::OpenAi);
    assert_eq!(turns(&example)[0], seen_and_said()[0]);
    assert_eq!(turns(&example)[1].1, r#"pick({"marker_id":1})"#);
    assert!(
        matches!(&example.images[0].source, ImageSource::Bytes(bytes) if bytes.starts_with(b"\x89PNG"))
    );
    assert_eq!(of(&linted(&path), "loader").findings, 0);
}

#[test]
fn parquet_with_images_inside() {
    let folder = Folder::new();
    let path = folder.path().join("test-00000-of-00001.parquet");
    let fields = Fields::from(vec![
        Field::new("role", DataType::Utf8, true),
        Field::new("content", DataType::Utf8, true),
    ]);
    let texts = |items: &[&str]| Arc::new(StringArray::from(items.to_vec())) as ArrayRef;
    let turns_of = vec![
        texts(&["user", "assistant"]),
        texts(&["<image>what is it?", "a cup"]),
    ];
    let item = |fields: &Fields| {
        Arc::new(Field::new(
            "element",
            DataType::Struct(fields.clone()),
            true,
        ))
    };
    let list = |fields: &Fields, columns, count| {
        let items = StructArray::new(fields.clone(), columns, None);
        Arc::new(ListArray::new(
            item(fields),
            OffsetBuffer::from_lengths([count]),
            Arc::new(items),
            None,
        )) as ArrayRef
    };
    let frame_fields = Fields::from(vec![
        Field::new("bytes", DataType::Binary, true),
        Field::new("path", DataType::Utf8, true),
    ]);
    let frame = png(640, 480);
    let frames: Vec<ArrayRef> = vec![
        Arc::new(BinaryArray::from(vec![frame.as_slice()])),
        texts(&["view.png"]),
    ];
    let schema = Arc::new(Schema::new(vec![
        Field::new("task_id", DataType::Utf8, true),
        Field::new("messages", DataType::List(item(&fields)), true),
        Field::new("images", DataType::List(item(&frame_fields)), true),
    ]));
    let columns = vec![
        texts(&["FDP/1"]),
        list(&fields, turns_of, 2),
        list(&frame_fields, frames, 1),
    ];
    let batch = RecordBatch::try_new(schema.clone(), columns).expect("a batch");
    let file = std::fs::File::create(&path).expect("a file");
    let mut writer = ArrowWriter::try_new(file, schema, None).expect("a writer");
    writer
        .write(&batch)
        .and_then(|()| writer.close())
        .expect("written");

    let example = only(&open(&path));
    assert_eq!(
        (example.format, example.split.as_deref()),
        (Format::Parquet, Some("test"))
    );
    assert_eq!(turns(&example), seen_and_said());
    assert_eq!(example.images[0].source, ImageSource::Bytes(frame));
    assert_eq!(example.meta_text(&["task_id"]).as_deref(), Some("FDP/1"));
    // Its images are nowhere declared.
    assert_eq!(count(&linted(&path), "loader", "features"), 1);
    std::fs::write(&path, b"PAR1 torn").expect("a file");
    assert!(Dataset::open(&[path], None, None).is_err());
}

#[test]
fn a_folder_of_shards_goes_by_its_names() {
    let folder = Folder::new();
    let row = |text: &str| json!({ "prompt": text, "completion": "yes" });
    folder.lines("train/part-1.jsonl", &[row("a"), row("b")]);
    folder.lines("train/part-2.jsonl", &[row("c")]);
    folder.lines("val/part-1.jsonl", &[row("d")]);
    folder.write("other.json", r#"{"files": 3}"#);
    folder.write("manifest.json", r#"{"files": 3}"#);
    let dataset = open(folder.path());
    let splits: Vec<_> = dataset
        .rows()
        .map(|row| row.expect("a row").split.expect("a split"))
        .collect();
    assert_eq!(splits, ["train", "train", "train", "validation"]);
    assert_eq!(dataset.skipped().len(), 1);
    assert!(
        dataset.skipped()[0].1.contains("`files`"),
        "{}",
        dataset.skipped()[0].1
    );
    let places: Vec<_> = dataset
        .rows()
        .map(|row| row.expect("a row").location)
        .map(|it| (it.index, it.file, it.line))
        .collect();
    assert_eq!(places, [(0, 0, 1), (1, 0, 2), (2, 1, 1), (3, 2, 1)]);
}

#[test]
fn broken_rows_are_told_and_the_rest_is_read() {
    let folder = Folder::new();
    let good = json!({ "prompt": "a", "completion": "b" });
    let text = format!(
        "{good}\n{{\"prompt\": oops}}\n{{\"prompt\": \"a\"}}\n{good}\n{{\"prompt\": \"a\", \"compl"
    );
    let path = folder.write("rows.jsonl", text);
    let report = linted(&path);
    assert_eq!(
        (report.rows, report.unreadable, report.is_bad()),
        (2, 3, true)
    );
    let told: Vec<_> = of(&report, "rows")
        .examples
        .iter()
        .map(|it| (it.examples[0].line, it.message.clone()))
        .collect();
    assert_eq!(told[0].0, 2);
    assert!(
        told[0].1.starts_with("column 12: not JSON: expected value"),
        "{}",
        told[0].1
    );
    assert!(
        told[1]
            .1
            .contains("no turns: expected a list under `messages`"),
        "{}",
        told[1].1
    );
    assert!(
        told[2].1.contains("the last line is torn off"),
        "{}",
        told[2].1
    );
}
