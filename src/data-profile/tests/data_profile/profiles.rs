//! What a profile says of small sets whose answers are known.

use std::io::Write as _;

use polars::prelude::{
    DataFrame, DataType, IntoColumn as _, NamedFrom as _, ParquetWriter, Series, TimeUnit,
};
use reel_data_profile::{
    ColumnProfile, DiffOptions, Profile, ProfileOptions, Table, diff, profile,
};
use tempfile::TempDir;

use crate::write::{lines, parquet, table, text};

fn profiled(table: &Table) -> Profile {
    profile(table, &ProfileOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn column<'a>(profile: &'a Profile, name: &str) -> &'a ColumnProfile {
    let found = profile.columns.iter().find(|column| column.name == name);
    found.unwrap_or_else(|| {
        let names: Vec<&str> = profile.columns.iter().map(|it| it.name.as_str()).collect();
        panic!("no {name} in {names:?}")
    })
}

fn rows() -> Vec<String> {
    (0..100)
        .map(|row| {
            let score = if row % 10 == 0 {
                "null".to_owned()
            } else {
                format!("{}.5", row)
            };
            let tool = ["pick", "place", "open"][row % 3];
            format!(
                r#"{{"id": {row}, "score": {score}, "tool": "{tool}", "tags": [{}], "meta": {{"split": "train", "ok": {}}}}}"#,
                vec!["\"é\""; row % 4].join(", "),
                row < 25,
            )
        })
        .collect()
}

#[test]
fn the_columns_of_a_set_are_described() {
    let folder = TempDir::new().unwrap();
    let json = lines(folder.path(), "rows.jsonl", rows());
    for path in [json.clone(), parquet(&json, "id")] {
        let profile = profiled(&table(&path));
        assert_eq!(profile.rows, 100);
        assert_eq!(profile.duplicates.repeated, 0);
        assert_eq!(profile.duplicates.distinct, 100);
        let id = column(&profile, "id");
        assert_eq!((id.type_name.as_str(), id.distinct), ("i64", Some(100)));
        let numbers = id.numbers.as_ref().unwrap();
        assert_eq!((numbers.min, numbers.max, numbers.mean), (0.0, 99.0, 49.5));
        assert_eq!(numbers.quantiles[3], (0.5, 49.0));
        assert!(numbers.exact);
        let score = column(&profile, "score");
        assert_eq!((score.nulls, score.null_share), (10, 0.1));
        let tool = column(&profile, "tool");
        assert_eq!(tool.top[0].value, "pick");
        assert_eq!(tool.top[0].count, 34);
        assert_eq!(tool.lengths.as_ref().unwrap().max, 5.0);
        let tags = column(&profile, "tags");
        assert_eq!(tags.type_name, "list[text]");
        assert_eq!(tags.lengths.as_ref().unwrap().mean, 1.5);
        let ok = column(&profile, "meta.ok");
        assert_eq!(ok.top[0].count, 75);
        assert_eq!(column(&profile, "meta.split").distinct, Some(1));
    }
}

#[test]
fn lengths_count_characters_and_not_bytes() {
    let folder = TempDir::new().unwrap();
    let path = text(
        folder.path(),
        "a.jsonl",
        "{\"t\": \"äöü😀\"}\n{\"t\": null}\n{\"t\": \"\"}",
    );
    let profile = profiled(&table(&path));
    let lengths = column(&profile, "t").lengths.clone().unwrap();
    assert_eq!((lengths.count, lengths.min, lengths.max), (2, 0.0, 4.0));
}

#[test]
fn repeated_rows_and_keys_are_counted() {
    let folder = TempDir::new().unwrap();
    let rows = [
        r#"{"id": 1, "k": "a", "v": [1, {"x": 2}]}"#,
        r#"{"id": 2, "k": "a", "v": null}"#,
        r#"{"v": [1, {"x": 2}], "id": 1, "k": "a"}"#,
        r#"{"id": 1, "k": "a", "v": [1, {"x": 3}]}"#,
        r#"{"id": 3, "k": null, "v": null}"#,
        r#"{"id": 1, "k": "a", "v": [1, {"x": 2}]}"#,
    ];
    let rows = rows.map(|row| row.replace("[1, ", "["));
    let path = lines(folder.path(), "rows.jsonl", rows);
    let options = ProfileOptions {
        keys: vec!["k".to_owned()],
        by: vec!["id".to_owned(), "k".to_owned()],
        ..ProfileOptions::default()
    };
    let profile = profile(&table(&path), &options).unwrap();
    assert_eq!(
        (profile.duplicates.repeated, profile.duplicates.groups),
        (2, 1)
    );
    assert_eq!(profile.duplicates.largest, [(0, 3)]);
    let keys = profile.key_duplicates.unwrap();
    assert_eq!((keys.repeated, keys.without_key), (4, 1));
    let classes: Vec<(&str, u64)> = profile.balance[1]
        .1
        .iter()
        .map(|class| (class.class.as_str(), class.count))
        .collect();
    assert_eq!(classes, [("a", 5), ("null", 1)]);
    assert_eq!(profile.balance[0].1[0].count, 4);
}

#[test]
fn lists_marks_and_compression_are_read_like_lines() {
    let folder = TempDir::new().unwrap();
    let plain = rows().join("\n");
    let list = format!("[\n{}\n]", rows().join(",\n"));
    let pretty = list.replace("\", \"tags", "\",\n\r\n \"tags");
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(plain.as_bytes()).unwrap();
    let gzip = gzip.finish().unwrap();
    // Two streams behind each other are one file.
    let half = plain.len() / 2;
    let mut zstd = zstd::encode_all(&plain.as_bytes()[..half], 1).unwrap();
    zstd.extend(zstd::encode_all(&plain.as_bytes()[half..], 1).unwrap());
    let plain_path = text(folder.path(), "plain.jsonl", &plain);
    let expected = serde_json::to_value(profiled(&table(&plain_path)).columns).unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let paths = [
        write("list.json", list.as_bytes()),
        write("pretty.json", pretty.as_bytes()),
        write("marked.jsonl", format!("\u{feff}{plain}").as_bytes()),
        write("rows.jsonl.gz", &gzip),
        write("rows.jsonl.zst", &zstd),
        write("with[brackets]*.jsonl", plain.as_bytes()),
    ];
    for path in paths {
        let found = profiled(&table(&path));
        assert_eq!(found.rows, 100, "{}", path.display());
        let found = serde_json::to_value(found.columns).unwrap();
        let columns = found.as_array().unwrap().iter();
        for (found, expected) in columns.zip(expected.as_array().unwrap()) {
            assert_eq!(found, expected, "{}", path.display());
        }
    }
}

#[test]
fn folders_and_patterns_are_one_table() {
    let folder = TempDir::new().unwrap();
    let root = folder.path();
    let first = lines(
        root,
        "sft/train/a.jsonl",
        [r#"{"id": 1, "a": 2}"#.to_owned()],
    );
    lines(
        root,
        "sft/test/b.jsonl",
        [r#"{"id": 2, "b": 0.5}"#.to_owned()],
    );
    text(root, "sft/manifest.json", "{\"files\": []}");
    text(root, "sft/config.json", "{\n \"lr\": 1\n}");
    parquet(&first, "id");
    let all = table(&root.join("sft"));
    let names: Vec<String> = all
        .columns()
        .iter()
        .map(|column| format!("{}: {}", column.name, column.type_name))
        .collect();
    assert_eq!(names, ["id: i64", "b: f64", "a: i64"]);
    assert!(all.notes()[0].contains("config.json"), "{:?}", all.notes());
    assert_eq!(profiled(&all).rows, 3);
    assert_eq!(table(&root.join("sft/*/*.jsonl")).files().len(), 2);
    // Named twice, read once.
    let twice = Table::open(&[first.clone(), first]).unwrap();
    assert_eq!(profiled(&twice).rows, 1);
}

#[test]
fn conversations_are_measured_in_every_format() {
    let folder = TempDir::new().unwrap();
    let swift = r#"{"messages": [{"role": "system", "content": "s"}, {"role": "user", "content": "<image>hi"}, {"role": "assistant", "content": "four"}, {"role": "user", "content": "?"}, {"role": "assistant", "content": "seventy"}], "images": ["a.png"]}"#;
    let qwen = r#"{"conversations": [{"from": "human", "value": "hi"}, {"from": "gpt", "value": "four"}, {"from": "gpt", "value": "seventy"}], "image": ["a.png"]}"#;
    let trl = r#"{"prompt": [{"role": "user", "content": "hi"}], "completion": [{"role": "assistant", "content": "four"}, {"role": "assistant", "content": "seventy"}], "images": ["a.png"]}"#;
    let parts = r#"{"messages": [{"role": "user", "content": [{"type": "text", "text": "hi"}]}, {"role": "assistant", "content": [{"type": "text", "text": "fo"}, {"type": "text", "text": "ur"}]}, {"role": "assistant", "content": [{"type": "text", "text": "seventy"}]}], "images": ["a.png"]}"#;
    for (name, row, turns) in [
        ("swift", swift, 5.0),
        ("qwen", qwen, 3.0),
        ("trl", trl, 3.0),
        ("parts", parts, 3.0),
    ] {
        let path = lines(
            folder.path(),
            &format!("{name}.jsonl"),
            vec![row.to_owned(); 3],
        );
        let profile = profiled(&table(&path));
        let found = profile.conversation.unwrap_or_else(|| panic!("{name}"));
        assert_eq!(found.turns.unwrap().mean, turns, "{name}");
        assert_eq!(found.answers.unwrap().mean, 2.0, "{name}");
        let characters = found.answer_characters.unwrap();
        assert_eq!((characters.min, characters.max), (4.0, 7.0), "{name}");
        assert_eq!(characters.count, 6, "{name}");
        assert_eq!(found.images.unwrap().mean, 1.0, "{name}");
    }
    let texts = r#"{"prompt": "hi", "completion": "four"}"#.to_owned();
    let path = lines(folder.path(), "texts.jsonl", [texts]);
    let found = profiled(&table(&path)).conversation.unwrap();
    assert_eq!(found.answer_characters.unwrap().mean, 4.0);
    assert_eq!(found.turns.unwrap().mean, 2.0);
}

#[test]
fn mixed_types_are_told_and_read_as_text() {
    let folder = TempDir::new().unwrap();
    let rows = [
        r#"{"messages": [{"role": "assistant", "content": "plain"}]}"#,
        r#"{"messages": [{"role": "assistant", "content": [{"text": "in parts"}]}]}"#,
    ];
    let path = lines(folder.path(), "rows.jsonl", rows.map(str::to_owned));
    let profile = profiled(&table(&path));
    let told = "column 'messages[].content' holds texts (first in line 1) and lists (first in line 2); it is read as text";
    assert!(
        profile.notes.iter().any(|note| note == told),
        "{:?}",
        profile.notes
    );
    assert_eq!(profile.conversation.unwrap().answers.unwrap().mean, 1.0);
}

#[test]
fn a_set_of_columns_without_rows_is_empty_and_no_error() {
    let folder = TempDir::new().unwrap();
    let rows = lines(folder.path(), "rows.jsonl", rows());
    let other = lines(folder.path(), "other.jsonl", [r#"{"id": 1000}"#.to_owned()]);
    let out = folder.path().join("none.parquet");
    let options = reel_data_profile::JoinOptions {
        on: vec!["id".to_owned()],
        how: reel_data_profile::JoinHow::Semi,
        out: out.clone(),
    };
    reel_data_profile::join(&table(&rows), &table(&other), &options).unwrap();
    let profile = profiled(&table(&out));
    assert_eq!((profile.rows, profile.columns.len()), (0, 6));
    assert!(profile.to_string().starts_with("0 rows"));
    // Nothing of nothing drifts, and yet all of the set is gone.
    let gone = diff(&table(&rows), &table(&out), &DiffOptions::default()).unwrap();
    assert!(gone.is_drifted(), "{gone}");
}

#[test]
fn wide_integers_and_odd_numbers_keep_their_values() {
    let folder = TempDir::new().unwrap();
    let rows = [
        r#"{"u": 18446744073709551615, "f": 1e308, "n": null, "e": {}, "l": []}"#,
        r#"{"u": 18446744073709551614, "f": -0.0, "n": null, "e": {}, "l": []}"#,
    ];
    let path = lines(folder.path(), "rows.jsonl", rows.map(str::to_owned));
    let profile = profiled(&table(&path));
    let wide = column(&profile, "u");
    assert_eq!((wide.type_name.as_str(), wide.distinct), ("u64", Some(2)));
    assert_eq!(wide.top[0].value, "18446744073709551614");
    assert_eq!(column(&profile, "n").type_name, "null");
    assert_eq!(column(&profile, "n").nulls, 2);
    assert_eq!(column(&profile, "f").numbers.as_ref().unwrap().max, 1e308);
}

#[test]
fn columns_of_every_type_are_profiled() {
    let folder = TempDir::new().unwrap();
    let numbers = Series::new("day".into(), [0_i32, 1, 1]);
    let cast = |name: &str, to: &DataType| {
        let mut column = numbers.cast(to).unwrap();
        column.rename(name.into());
        column.into_column()
    };
    let zone = polars::prelude::TimeZone::opt_try_new(Some("Europe/Berlin")).unwrap();
    let types = [
        ("i8", DataType::Int8),
        ("u16", DataType::UInt16),
        ("f16", DataType::Float16),
        ("f32", DataType::Float32),
        ("decimal", DataType::Decimal(20, 2)),
        ("date", DataType::Date),
        ("time", DataType::Time),
        ("stamp", DataType::Datetime(TimeUnit::Milliseconds, zone)),
        ("span", DataType::Duration(TimeUnit::Nanoseconds)),
        ("null", DataType::Null),
    ];
    let mut columns: Vec<_> = types[..9].iter().map(|(name, to)| cast(name, to)).collect();
    columns.push(Series::full_null("null".into(), 3, &DataType::Null).into_column());
    let texts = Series::new("kind".into(), ["a", "b", "b"]);
    let kinds = DataType::from_categories(polars::prelude::Categories::global());
    columns.push(texts.cast(&kinds).unwrap().into_column());
    columns.push(Series::new("image".into(), [&b"abc"[..], b"", b"x"]).into_column());
    let mut frame = DataFrame::new_infer_height(columns).unwrap();
    let path = folder.path().join("types.parquet");
    let file = std::fs::File::create(&path).unwrap();
    ParquetWriter::new(file).finish(&mut frame).unwrap();
    let profile = profiled(&table(&path));
    assert_eq!((profile.rows, profile.duplicates.repeated), (3, 0));
    assert_eq!(column(&profile, "kind").top[0].value, "b");
    assert_eq!(
        column(&profile, "decimal").numbers.as_ref().unwrap().max,
        1.0
    );
    let range = column(&profile, "date").range.clone().unwrap();
    assert_eq!(range, ("1970-01-01".to_owned(), "1970-01-02".to_owned()));
    assert_eq!(column(&profile, "image").lengths.as_ref().unwrap().max, 3.0);
    let again = reel_data_profile::diff(
        &table(&path),
        &table(&path),
        &reel_data_profile::DiffOptions::default(),
    );
    assert_eq!(again.unwrap().whole_rows.unchanged, 3);
}
