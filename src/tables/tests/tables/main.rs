//! Traces become rows, and rows stay in the store: whole, once, and whatever happens to an ingest.

mod episode_rows;
mod ingestion;
mod interop;
mod versions;

use std::{fs, path::PathBuf};

use arrow::array::{AsArray, RecordBatch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use reel_tables::{Store, Table};
use reel_vectors::play;

fn texts(batch: &RecordBatch, column: &str) -> Vec<Option<String>> {
    batch
        .column_by_name(column)
        .unwrap()
        .as_string::<i32>()
        .iter()
        .map(|text| text.map(str::to_owned))
        .collect()
}

/// What a list column holds in a row, as columns.
fn nested(batch: &RecordBatch, column: &str, row: usize) -> RecordBatch {
    RecordBatch::from(batch[column].as_list::<i32>().value(row).as_struct())
}

/// All rows of a table, file by file.
fn batches(store: &Store, table: Table) -> Vec<RecordBatch> {
    let read = |url: url::Url| {
        let file = fs::File::open(url.to_file_path().unwrap()).unwrap();
        ParquetRecordBatchReaderBuilder::try_new(file)
            .unwrap()
            .build()
            .unwrap()
            .map(Result::unwrap)
            .collect::<Vec<_>>()
    };
    store.files(table).into_iter().flat_map(read).collect()
}

fn rows(store: &Store, table: Table) -> usize {
    batches(store, table)
        .iter()
        .map(RecordBatch::num_rows)
        .sum()
}

fn ingest(store: &mut Store, paths: &[PathBuf]) -> (usize, usize, usize, usize) {
    let report = store.ingest(paths, &|_, _| ()).unwrap();
    (
        report.added,
        report.unchanged,
        report.superseded,
        report.quarantined.len(),
    )
}
