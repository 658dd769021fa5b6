//! Reading and writing the Parquet files of a table: the mechanics
//! of [`super::Store`]. Decides nothing.

use std::{collections::BTreeSet, io::Cursor, sync::Arc};

use arrow::{
    array::{RecordBatch, new_null_array},
    datatypes::SchemaRef,
    error::ArrowError,
};
use deltalake::{
    DeltaTable,
    kernel::{Action, Remove},
    logstore::parquet_reader::ParquetObjectReader,
    writer::{DeltaWriter as _, RecordBatchWriter},
};
use futures_util::StreamExt as _;
use object_store::ObjectStoreExt as _;
use parquet::{
    arrow::{ParquetRecordBatchStreamBuilder, ProjectionMask, async_reader::AsyncFileReader},
    basic::{Compression, ZstdLevel},
    bloom_filter::Sbbf,
    errors::ParquetError,
    file::properties::WriterProperties,
    schema::types::ColumnPath,
};

use super::{Store, StoreError};
use crate::Table;

/// Rows in a Parquet row group: small enough that two cores share one file of a small store.
const ROWS_PER_GROUP: usize = 65_536;
/// Rows in a group of a file that an ingest merges: a writer holds about 10 KB a row of a group
/// that is not full.
const ROWS_PER_INGESTED_GROUP: usize = 4_096;
/// Rows that are read at a time.
const ROWS_AT_A_TIME: usize = 256;

/// Files up to this size are read at once, in bytes.
const WHOLE_BYTES_MAX: u64 = 16 << 20;

/// How often a Bloom filter says of a text that is not there that it may be.
const FALSE_POSITIVES: f64 = 0.01;

/// No file of a table grows beyond this, in bytes.
const FILE_BYTES_MAX: u64 = 256 << 20;

/// Columns by which single rows are looked up: they get Bloom filters.
const KEYS: [&str; 4] = ["episode_id", "trace", "task_digest", "scene_digest"];

type PartReader = ParquetRecordBatchStreamBuilder<Box<dyn AsyncFileReader>>;

/// How many small files make a merge, and what it writes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Merge {
    /// Fewer files than this are left alone.
    pub files_min: usize,
    /// Bytes from which on a file is not small.
    pub small_bytes: u64,
    rows_per_group: usize,
}

impl Merge {
    /// Within an ingest: in bounded memory, so that what it merged once is not small any more.
    pub(super) const INGESTED: Self = Self {
        files_min: 8,
        small_bytes: 8 << 20,
        rows_per_group: ROWS_PER_INGESTED_GROUP,
    };
    /// On demand: into files that are read at the least cost.
    pub(super) const COMPACT: Self = Self {
        files_min: 2,
        small_bytes: FILE_BYTES_MAX / 2,
        rows_per_group: ROWS_PER_GROUP,
    };
}

/// A Parquet file of a table.
pub(super) struct Part {
    /// Within the table's folder.
    pub path: String,
    /// When the file was written, in milliseconds since 1970.
    pub written_ms: i64,
    pub size: u64,
    pub rows: usize,
    /// The action that takes it out of the table.
    pub remove: Remove,
}

impl Part {
    fn failed(&self, source: ParquetError) -> StoreError {
        StoreError::Parquet {
            source,
            path: self.path.clone(),
        }
    }
}

impl Store {
    /// The files of a table at this version.
    pub(super) fn parts(&self, table: Table) -> Vec<Part> {
        parts(&self.tables[&table])
    }

    /// Reads some columns of a table (nested ones by their Parquet paths), batch by batch, in the
    /// order of its files.
    ///
    /// # Errors
    /// When the store cannot be read, and what `take` says.
    pub fn read(
        &self,
        table: Table,
        columns: &[&str],
        take: impl FnMut(RecordBatch) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        self.read_in(table, &self.file_names(table), columns, take)
    }

    /// [`Store::read`] of some files.
    pub(crate) fn read_in(
        &self,
        table: Table,
        files: &[String],
        columns: &[&str],
        mut take: impl FnMut(RecordBatch) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut parts = self.parts(table);
        parts.retain(|part| files.contains(&part.path));
        self.read_parts(&self.tables[&table], &parts, Some(columns), |_, batch| {
            take(batch)
        })
    }

    /// The names of a table's files at this version, in the order in which they are read: for who
    /// reads part of them.
    pub fn file_names(&self, table: Table) -> Vec<String> {
        self.parts(table)
            .into_iter()
            .map(|part| part.path)
            .collect()
    }

    /// Reads some columns of some files; `take` gets each batch with the index of its file.
    pub(super) fn read_parts(
        &self,
        table: &DeltaTable,
        parts: &[Part],
        columns: Option<&[&str]>,
        mut take: impl FnMut(usize, RecordBatch) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        for (index, part) in parts.iter().enumerate() {
            let reader = self.open_part(table, part)?;
            self.read_part(part, reader, columns, |batch| take(index, batch))?;
        }
        Ok(())
    }

    /// [`Store::read_parts`] where only rows are wanted whose `column` is one of some texts: row
    /// groups that hold none of them, says their Bloom filter, are left out. `take` gets the other
    /// rows of a group, too.
    pub(super) fn read_parts_with(
        &self,
        table: &DeltaTable,
        parts: &[Part],
        (column, texts): (&str, &BTreeSet<String>),
        columns: Option<&[&str]>,
        mut take: impl FnMut(usize, RecordBatch) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        if texts.is_empty() {
            return Ok(());
        }
        for (index, part) in parts.iter().enumerate() {
            let mut reader = self.open_part(table, part)?;
            let groups = self
                .runtime
                .block_on(groups_with(&mut reader, column, texts));
            let groups = groups.map_err(|error| part.failed(error))?;
            self.read_part(part, reader.with_row_groups(groups), columns, |batch| {
                take(index, batch)
            })?;
        }
        Ok(())
    }

    fn open_part(&self, table: &DeltaTable, part: &Part) -> Result<PartReader, StoreError> {
        let objects = table.log_store().object_store(None);
        let path =
            object_store::path::Path::parse(&part.path).map_err(|error| StoreError::Location {
                reason: error.to_string(),
                location: part.path.clone(),
            })?;
        let reader: Box<dyn AsyncFileReader> = if part.size <= WHOLE_BYTES_MAX {
            // one request, where each column would be one
            let bytes = self
                .runtime
                .block_on(async { objects.get(&path).await?.bytes().await });
            Box::new(Cursor::new(
                bytes.map_err(|error| self.delta(error.into()))?,
            ))
        } else {
            Box::new(ParquetObjectReader::new(Arc::clone(&objects), path).with_file_size(part.size))
        };
        self.runtime
            .block_on(ParquetRecordBatchStreamBuilder::new(reader))
            .map_err(|error| part.failed(error))
    }

    fn read_part(
        &self,
        part: &Part,
        mut reader: PartReader,
        columns: Option<&[&str]>,
        mut take: impl FnMut(RecordBatch) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        if let Some(columns) = columns {
            let mask = ProjectionMask::columns(reader.parquet_schema(), columns.iter().copied());
            reader = reader.with_projection(mask);
        }
        let mut stream = reader
            .with_batch_size(ROWS_AT_A_TIME)
            .build()
            .map_err(|error| part.failed(error))?;
        while let Some(batch) = self.runtime.block_on(stream.next()) {
            take(batch.map_err(|error| part.failed(error))?)?;
        }
        Ok(())
    }

    /// Writes rows into new files and gives the actions that take them into the table.
    pub(super) fn write_parts(
        &self,
        table: &DeltaTable,
        batches: Vec<RecordBatch>,
    ) -> Result<Vec<Action>, StoreError> {
        let mut writer = self.writer(table, ROWS_PER_GROUP)?;
        self.wait(async {
            for batch in batches {
                writer.write(batch).await?;
            }
            Ok(writer.flush().await?.into_iter().map(Action::Add).collect())
        })
    }

    /// Writes the rows of some files into fewer ones, a batch at a time. The actions say
    /// that no data changed.
    pub(super) fn rewrite_parts(
        &self,
        table: &DeltaTable,
        parts: Vec<Part>,
        merge: Merge,
    ) -> Result<Vec<Action>, StoreError> {
        let mut writer = self.writer(table, merge.rows_per_group)?;
        let schema = writer.arrow_schema();
        self.read_parts(table, &parts, None, |_, batch| {
            self.wait(writer.write(with_columns_of(&schema, batch)?))
        })?;
        let mut actions = Vec::new();
        for mut add in self.wait(writer.flush())? {
            add.data_change = false;
            actions.push(Action::Add(add));
        }
        for Part { mut remove, .. } in parts {
            remove.data_change = false;
            actions.push(Action::Remove(remove));
        }
        Ok(actions)
    }

    fn writer(
        &self,
        table: &DeltaTable,
        rows_per_group: usize,
    ) -> Result<RecordBatchWriter, StoreError> {
        let writer = RecordBatchWriter::for_table(table).map_err(|error| self.delta(error))?;
        let mut properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_max_row_group_row_count(Some(rows_per_group));
        let schema = table
            .snapshot()
            .map_err(|error| self.delta(error))?
            .schema();
        for key in KEYS.into_iter().filter(|key| schema.field(key).is_some()) {
            let column = ColumnPath::from(key);
            properties = properties
                .set_column_bloom_filter_fpp(column.clone(), FALSE_POSITIVES)
                .set_column_bloom_filter_max_ndv(column, rows_per_group as u64);
        }
        let properties = properties.build();
        Ok(writer
            .with_writer_properties(properties)
            .with_target_file_size(FILE_BYTES_MAX))
    }
}

/// Rows of a file with the columns that its table got after it was written: they are null there.
fn with_columns_of(schema: &SchemaRef, rows: RecordBatch) -> Result<RecordBatch, ArrowError> {
    let columns = schema
        .fields()
        .iter()
        .map(|field| match rows.column_by_name(field.name()) {
            Some(column) => Arc::clone(column),
            None => new_null_array(field.data_type(), rows.num_rows()),
        });
    RecordBatch::try_new(Arc::clone(schema), columns.collect())
}

/// The row groups whose `column` may hold one of some texts. A file without Bloom filters, which an
/// earlier version wrote, gives all of its groups.
async fn groups_with(
    reader: &mut PartReader,
    column: &str,
    texts: &BTreeSet<String>,
) -> Result<Vec<usize>, ParquetError> {
    let mut columns = reader.parquet_schema().columns().iter();
    let column = columns.position(|leaf| leaf.path().string() == column);
    let mut groups = Vec::new();
    for group in 0..reader.metadata().num_row_groups() {
        let filter = match column {
            Some(column) => {
                reader
                    .get_row_group_column_bloom_filter(group, column)
                    .await?
            }
            None => None,
        };
        let may_hold = |filter: Sbbf| texts.iter().any(|text| filter.check(text.as_str()));
        if filter.is_none_or(may_hold) {
            groups.push(group);
        }
    }
    Ok(groups)
}

pub(super) fn parts(table: &DeltaTable) -> Vec<Part> {
    let Ok(state) = table.snapshot() else {
        return Vec::new();
    };
    let part = |file: deltalake::kernel::LogicalFileView| Part {
        path: file.object_store_path().to_string(),
        written_ms: file.modification_time(),
        size: file.size().max(0) as u64,
        rows: file.num_records().unwrap_or_default(),
        remove: file.remove_action(true),
    };
    let mut parts: Vec<Part> = state.log_data().into_iter().map(part).collect();
    // names are drawn: another store of the same traces is read in the same order only by
    // when files were written
    parts.sort_by(|one, other| (one.written_ms, &one.path).cmp(&(other.written_ms, &other.path)));
    parts
}
