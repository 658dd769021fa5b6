//! Whether the ranges that a Parquet file names lie within it.
//!
//! Polars takes them from the file's metadata unchecked and reads memory beyond the file where they
//! are wrong, so no file gets to it before this check.

use std::{fs::File, path::Path};

use parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaDataReader};

use crate::DataError;

/// Checks the metadata of a file; gives its rows and their bytes before compression.
///
/// # Errors
/// Fails if the metadata cannot be read, or names rows or bytes that the file cannot have.
pub(crate) fn check(path: &Path) -> Result<(u64, u64), DataError> {
    let failed = |source| DataError::io("read", path, source);
    let file = File::open(path).map_err(failed)?;
    let end = file.metadata().map_err(failed)?.len();
    let broken = |message: String| DataError::Parquet {
        path: path.to_owned(),
        message,
    };
    let metadata = ParquetMetaDataReader::new()
        .parse_and_finish(&file)
        .map_err(|error| broken(error.to_string()))?;
    let (mut rows, mut bytes) = (0_i64, 0_u64);
    for (group, row_group) in metadata.row_groups().iter().enumerate() {
        if row_group.num_rows() < 0 {
            return Err(broken(format!(
                "row group {group} has a negative number of rows"
            )));
        }
        rows = rows.saturating_add(row_group.num_rows());
        let size = u64::try_from(row_group.total_byte_size()).unwrap_or_default();
        bytes = bytes.saturating_add(size);
        for column in row_group.columns() {
            if !lies_within(column, end) {
                return Err(broken(format!(
                    "column '{}' of row group {group} lies beyond the end of the file",
                    column.column_path().string()
                )));
            }
        }
    }
    let named = metadata.file_metadata().num_rows();
    if rows != named {
        return Err(broken(format!(
            "{named} rows are named, the row groups have {rows}"
        )));
    }
    Ok((u64::try_from(rows).unwrap_or_default(), bytes))
}

fn lies_within(column: &ColumnChunkMetaData, end: u64) -> bool {
    let data = column.data_page_offset();
    let start = column.dictionary_page_offset().unwrap_or(data).min(data);
    let length = column.compressed_size();
    let (Ok(start), Ok(length)) = (u64::try_from(start), u64::try_from(length)) else {
        return false;
    };
    let within = |offset: i64| u64::try_from(offset).is_ok_and(|offset| offset < end);
    let sizes = column.uncompressed_size() >= 0 && column.num_values() >= 0;
    let pages = within(data) && column.dictionary_page_offset().is_none_or(within);
    sizes && pages && start.checked_add(length).is_some_and(|last| last <= end)
}
