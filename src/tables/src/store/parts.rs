//! Reading and writing the Parquet files of a table: the mechanics
//! of [`super::Store`]. Decides nothing.

use std::{io::Cursor, sync::Arc};

use arrow::array::RecordBatch;
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
    file::properties::WriterProperties,
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

/// No file of a table grows beyond this, in bytes.
const FILE_BYTES_MAX: u64 = 256 << 20;

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
    /// The action that takes it out of the table.
    pub remove: Remove,
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
        let objects = table.log_store().object_store(None);
        for (index, part) in parts.iter().enumerate() {
            let failed = |source| StoreError::Parquet {
                source,
                path: part.path.clone(),
            };
            let path = object_store::path::Path::parse(&part.path).map_err(|error| {
                StoreError::Location {
                    reason: error.to_string(),
                    location: part.path.clone(),
                }
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
                Box::new(
                    ParquetObjectReader::new(Arc::clone(&objects), path).with_file_size(part.size),
                )
            };
            let mut builder = self
                .runtime
                .block_on(ParquetRecordBatchStreamBuilder::new(reader))
                .map_err(failed)?;
            if let Some(columns) = columns {
                let mask =
                    ProjectionMask::columns(builder.parquet_schema(), columns.iter().copied());
                builder = builder.with_projection(mask);
            }
            let mut stream = builder
                .with_batch_size(ROWS_AT_A_TIME)
                .build()
                .map_err(failed)?;
            while let Some(batch) = self.runtime.block_on(stream.next()) {
                take(index, batch.map_err(failed)?)?;
            }
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
        self.read_parts(table, &parts, None, |_, batch| {
            self.wait(writer.write(batch))
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
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_max_row_group_row_count(Some(rows_per_group))
            .build();
        Ok(writer
            .with_writer_properties(properties)
            .with_target_file_size(FILE_BYTES_MAX))
    }
}

pub(super) fn parts(table: &DeltaTable) -> Vec<Part> {
    let Ok(state) = table.snapshot() else {
        return Vec::new();
    };
    let part = |file: deltalake::kernel::LogicalFileView| Part {
        path: file.object_store_path().to_string(),
        written_ms: file.modification_time(),
        size: file.size().max(0) as u64,
        remove: file.remove_action(true),
    };
    let mut parts: Vec<Part> = state.log_data().into_iter().map(part).collect();
    // names are drawn: another store of the same traces is read in the same order only by
    // when files were written
    parts.sort_by(|one, other| (one.written_ms, &one.path).cmp(&(other.written_ms, &other.path)));
    parts
}
