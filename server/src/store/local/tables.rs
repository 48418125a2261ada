//! The tables of a data directory.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::ballast;
use super::data_dir::DataDir;
use super::redb_table::RedbTable;
use super::sled_table::SledTable;
use super::table_dir::TableDir;
use crate::store::api::Error;
use crate::store::backend::tables::{TableId, TileTable, TileTables};

/// What tiles are stored in. Tiles that lie in another one are folded anew.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TableEngine {
    /// sled: a log whose pages are mostly kept in memory.
    #[default]
    Sled,
    /// redb: a B-tree in one file, with a cache that is bounded.
    Redb,
}

/// Makes and opens them.
pub(super) struct LocalTables {
    pub(super) dir: Arc<DataDir>,
    pub(super) engine: TableEngine,
    /// Memory for the cache of each.
    pub(super) cache_bytes: u64,
}

impl LocalTables {
    fn opened(&self, dir: TableDir) -> Result<Box<dyn TileTable>, Error> {
        Ok(match self.engine {
            TableEngine::Sled => Box::new(SledTable::open(dir, self.cache_bytes)?),
            TableEngine::Redb => Box::new(RedbTable::open(dir, self.cache_bytes)?),
        })
    }
}

impl TileTables for LocalTables {
    fn create(&self, id: TableId, journal: Uuid) -> Result<Box<dyn TileTable>, Error> {
        let table = self.opened(TableDir::create(&self.dir.table(id), journal)?)?;
        ballast::keep(self.dir.root());
        Ok(table)
    }

    fn open(&self, id: TableId) -> Result<Option<Box<dyn TileTable>>, Error> {
        let path = self.dir.table(id);
        if !path.exists() {
            return Ok(None);
        }
        // A table that runs out of room while it opens may leave what it cannot read again: it must not come to that.
        if ballast::is_needed(self.dir.root()) && ballast::release(self.dir.root()) {
            tracing::warn!("the disk is full: the tiles are opened with the room that was kept for this");
        }
        let table = match self.opened(TableDir::of(&path)) {
            Err(error) if error.may_pass() && ballast::release(self.dir.root()) => {
                tracing::warn!(%error, "the tiles do not open; trying again with the room that was kept for this");
                return self.opened(TableDir::of(&path)).map(Some);
            }
            opened => opened?,
        };
        ballast::keep(self.dir.root());
        Ok(Some(table))
    }

    fn next_number(&self) -> Result<u64, Error> {
        self.dir.next_generation()
    }

    fn clean(&self, journal: Uuid, served: Option<u64>, replaced: bool) -> Result<(), Error> {
        self.dir.clean(journal, served, replaced)
    }
}
