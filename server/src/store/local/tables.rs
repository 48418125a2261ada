//! The tables of a data directory.

use std::fs;
use std::sync::Arc;

use uuid::Uuid;

use super::data_dir::DataDir;
use super::marker::mark;
use super::sled_table::SledTable;
use crate::store::api::{Error, io_error};
use crate::store::backend::tables::{TableId, TileTable, TileTables};

/// Makes and opens them.
pub(super) struct LocalTables {
    pub(in crate::store) dir: Arc<DataDir>,
    /// Memory for the cache of each.
    pub(in crate::store) cache_bytes: u64,
}

impl TileTables for LocalTables {
    fn create(&self, id: TableId, journal: Uuid) -> Result<Box<dyn TileTable>, Error> {
        let path = self.dir.table(id);
        fs::create_dir(&path)
            .and_then(|()| mark(&path, journal))
            .map_err(io_error("making a directory for tiles"))?;
        Ok(Box::new(SledTable::create(&path, self.cache_bytes)?))
    }

    fn open(&self, id: TableId) -> Result<Option<Box<dyn TileTable>>, Error> {
        let path = self.dir.table(id);
        if !path.exists() {
            return Ok(None);
        }
        Ok(Some(Box::new(SledTable::open(&path, self.cache_bytes)?)))
    }

    fn next_number(&self) -> Result<u64, Error> {
        self.dir.next_generation()
    }

    fn clean(&self, journal: Uuid, served: Option<u64>, replaced: bool) -> Result<(), Error> {
        self.dir.clean(journal, served, replaced)
    }
}
