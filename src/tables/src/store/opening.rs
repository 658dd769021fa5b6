//! The Delta tables of a store as they are made and opened, and the columns that an earlier version
//! of Reel did not have.

use std::collections::BTreeMap;

use arrow::error::ArrowError;
use deltalake::{
    DeltaTable,
    kernel::{StructField, StructType, engine::arrow_conversion::TryIntoKernel},
    operations::create::CreateBuilder,
};

use super::{ADDED_LATER, Location, SIDE, StoreError, UNBOUND};
use crate::Table;

/// Makes the tables that are not there yet.
pub(super) async fn create(location: &Location) -> Result<(), StoreError> {
    for table in SIDE.into_iter().chain(UNBOUND).chain([Table::Episodes]) {
        if location.commit(table.name(), 0).await?.is_some() {
            continue;
        }
        let delta = |source| StoreError::Delta {
            source: Box::new(source),
            location: location.to_string(),
        };
        let schema: StructType = table.schema().as_ref().try_into_kernel()?;
        let made = CreateBuilder::new()
            .with_log_store(location.log(table.name())?)
            .with_table_name(table.name())
            .with_comment(table.description())
            .with_columns(schema.fields().cloned())
            .with_configuration_property(
                deltalake::TableProperty::DataSkippingNumIndexedCols,
                Some("12"),
            )
            .await;
        match made {
            Ok(_) => {}
            // another process made it meanwhile
            Err(_) if location.commit(table.name(), 0).await?.is_some() => {}
            Err(error) => return Err(delta(error)),
        }
    }
    Ok(())
}

/// Every table at the version that a commit of `episodes` names.
pub(super) async fn load(
    location: &Location,
    version: Option<u64>,
) -> Result<BTreeMap<Table, DeltaTable>, StoreError> {
    if location.commit(Table::Episodes.name(), 0).await?.is_none() {
        return Err(StoreError::NoStore {
            location: location.to_string(),
        });
    }
    let delta = |source| StoreError::Delta {
        source: Box::new(source),
        location: location.to_string(),
    };
    let episodes = open(location, Table::Episodes, None).await?;
    let newest = episodes.version().unwrap_or_default();
    let episodes = match version {
        // Looking for one that is not there takes the longer the larger its number is.
        Some(version) if version > newest => {
            return Err(StoreError::NoVersion {
                version,
                newest,
                location: location.to_string(),
            });
        }
        Some(version) if version < newest => open(location, Table::Episodes, Some(version)).await?,
        _ => episodes,
    };
    let state = episodes.snapshot().map_err(delta)?.snapshot().clone();
    let mut tables = BTreeMap::new();
    for table in SIDE {
        let named = state
            .transaction_version(episodes.log_store().as_ref(), table.name())
            .await
            .map_err(delta)?;
        let version = named
            .and_then(|version| u64::try_from(version).ok())
            .unwrap_or(0);
        tables.insert(table, open(location, table, Some(version)).await?);
    }
    for table in UNBOUND {
        tables.insert(table, open(location, table, None).await?);
    }
    tables.insert(Table::Episodes, episodes);
    Ok(tables)
}

/// A table at a version, or its newest.
pub(super) async fn open(
    location: &Location,
    table: Table,
    version: Option<u64>,
) -> Result<DeltaTable, StoreError> {
    let delta = |source| StoreError::Delta {
        source: Box::new(source),
        location: location.to_string(),
    };
    if ADDED_LATER.contains(&table) && location.commit(table.name(), 0).await?.is_none() {
        return Err(StoreError::OtherColumns {
            table: table.name(),
            location: location.to_string(),
        });
    }
    let mut opened = DeltaTable::new(location.log(table.name())?);
    let loaded = match version {
        Some(version) => opened.load_version(version as _).await,
        None => opened.load().await,
    };
    loaded.map_err(delta)?;
    let schema = opened.snapshot().map_err(delta)?.schema();
    let added = added_columns(&schema, table)?;
    if added.is_none_or(|added| table == Table::Episodes && !added.is_empty()) {
        return Err(StoreError::OtherColumns {
            table: table.name(),
            location: location.to_string(),
        });
    }
    Ok(opened)
}

/// The columns of a table that a stored schema lacks and that read as null there: an earlier
/// version of Reel wrote it. None where the stored columns are others than ours.
pub(super) fn added_columns(
    stored: &StructType,
    table: Table,
) -> Result<Option<Vec<StructField>>, ArrowError> {
    let ours: StructType = table.schema().as_ref().try_into_kernel()?;
    let is_ours = |field: &StructField| ours.field(field.name()) == Some(field);
    let added: Vec<StructField> = ours
        .fields()
        .filter(|field| stored.field(field.name()).is_none())
        .cloned()
        .collect();
    let fits = stored.fields().all(is_ours) && added.iter().all(|field| field.nullable);
    Ok(fits.then_some(added))
}
