//! Files, sled and redb: the only modules that know paths.
//!
//! - [`data_dir`]: the layout of a data directory; [`lock`], [`fence`]: one server at a time; [`contributor_key`]: what
//!   pseudonyms are hashed with; [`marker`], [`traces`]: what this store made.
//! - [`files`]: files that are whole or not there; [`objects`], [`segments`], [`manifest`]: what the store keeps in files.
//! - [`seed`]: a directory that begins as a copy of what servers share.
//! - [`tables`]: the tables of tiles; [`sled_table`] and [`sled_instance`]: one of them in sled; [`redb_table`]: one in redb;
//!   [`table_dir`]: its directory; [`fuse`]: when it takes no more; [`room`]: how much room a disk has left; [`ballast`]: some
//!   that is kept.

mod ballast;
mod contributor_key;
mod data_dir;
mod fence;
mod files;
mod fuse;
mod lock;
mod manifest;
mod marker;
mod objects;
mod redb_table;
mod room;
pub(in crate::store) mod seed;
mod segments;
pub(in crate::store) mod sled_instance;
mod sled_table;
mod table_dir;
mod tables;
mod traces;

use std::path::Path;
use std::sync::Arc;

use super::api::Error;
use super::backend::Backend;
use data_dir::DataDir;
pub use data_dir::journal_bytes;
pub use room::free as free_bytes;
pub use tables::TableEngine;

/// Opens a data directory, and locks it for as long as the backend is held.
pub(in crate::store) fn open(root: &Path, engine: TableEngine, cache_bytes: u64) -> Result<Backend, Error> {
    let dir = Arc::new(DataDir::open(root)?);
    Ok(Backend {
        objects: Arc::new(objects::LocalObjects::of(dir.root())),
        segments: Arc::new(segments::LocalSegments::of(&dir.journal())),
        manifests: Arc::new(manifest::LocalManifest(dir.clone())),
        tables: Arc::new(tables::LocalTables { dir: dir.clone(), engine, cache_bytes }),
        fence: Arc::new(dir.fence().clone()),
        pseudonyms: dir,
    })
}

#[cfg(test)]
mod tests {
    mod cost;

    use std::fs;

    use uuid::Uuid;

    use super::sled_instance::Sled;
    use super::*;
    use crate::store::backend::conformance::{Place, conforms};
    use crate::store::backend::tables::{TableId, TableUse};

    struct Directory(TableEngine, tempfile::TempDir);

    impl Place for Directory {
        fn open(&self) -> Backend {
            open(self.1.path(), self.0, 1 << 20).unwrap()
        }
    }

    mod with_sled {
        use super::*;
        conforms!(Directory(TableEngine::Sled, tempfile::tempdir().unwrap()));
    }

    /// Catches: a map that is whole and is folded anew, because a crash came before anything else was written.
    #[test]
    fn what_a_table_was_made_from_outlives_a_crash() {
        let place = tempfile::tempdir().unwrap();
        let backend = open(place.path(), TableEngine::Sled, 1 << 20).unwrap();
        let (id, journal) = (TableId { used: TableUse::Served, number: 1 }, Uuid::from_u128(7));
        let table = backend.tables.create(id, journal).unwrap();
        table.complete(journal).unwrap();
        // As a crash leaves it: nothing is closed.
        let crashed = tempfile::tempdir().unwrap();
        for file in fs::read_dir(place.path().join("tiles-1")).unwrap().map(Result::unwrap) {
            if file.path().is_file() {
                fs::copy(file.path(), crashed.path().join(file.file_name())).unwrap();
            }
        }
        let left = Sled::open(crashed.path(), 1 << 20).unwrap();
        assert_eq!(left.db().get("journal").unwrap().unwrap(), &journal.as_bytes()[..]);
    }

    mod with_redb {
        use super::*;
        conforms!(Directory(TableEngine::Redb, tempfile::tempdir().unwrap()));
    }
}
