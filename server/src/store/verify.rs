//! Is what is stored sound, and is the map what the journal says?

use std::sync::Arc;

use echofix_core::tile;

use super::embedded::EmbeddedStore;
use super::fold::unreadable;
use super::generation::Generation;
use super::{Error, MapProgress, entry};

/// What a verification found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verified {
    /// Records of the journal that were read.
    pub records: u64,
    /// Tiles of the checkpoint that were read.
    pub checkpoint_tiles: u64,
    /// Tiles that were read.
    pub tiles: u64,
    /// Tiles that were compared with a replay; `None` when none was asked for.
    pub compared: Option<u64>,
    /// One sentence for each defect; empty when all is sound.
    pub damage: Vec<String>,
}

impl EmbeddedStore {
    pub(super) fn verified(&self, replay: bool) -> Result<Verified, Error> {
        let mut found = Verified::default();
        self.verify_journal(&mut found);
        self.verify_checkpoint(&mut found);
        found.damage.extend(self.shared.dir.key_damage());
        verify_tiles(&*self.shared.readable()?, &mut found);
        if replay {
            self.compare(&mut found)?;
        }
        Ok(found)
    }

    fn verify_journal(&self, found: &mut Verified) {
        let checkpoint = self.shared.checkpoint();
        let (mut at, mut reader) = (checkpoint.last, self.shared.journal.reader());
        let newest = self.shared.index.newest();
        while at < newest {
            let group = self.shared.index.records(at, newest);
            let Some(last) = group.last() else { return };
            at = last.number;
            for written in group {
                let sound = reader.payload(written.at).and_then(|payload| {
                    entry::decode(&payload).map(|_| ()).ok_or_else(|| unreadable(written.number))
                });
                found.records += 1;
                found.damage.extend(sound.err().map(|error| error.to_string()));
            }
        }
    }

    fn verify_checkpoint(&self, found: &mut Verified) {
        let mut tiles = 0;
        let outcome = self.shared.checkpoint().visit(|id, _, encoded| {
            tiles += 1;
            let damaged = |error: tile::DecodeError| Error::Damaged {
                what: format!("tile {id} of the checkpoint"),
                reason: error.to_string(),
            };
            tile::decode(&encoded).map(|_| ()).map_err(damaged)
        });
        found.checkpoint_tiles = tiles;
        found.damage.extend(outcome.err().map(|error| error.to_string()));
    }

    /// Tiles that change meanwhile are left out. Where another generation is served meanwhile, nothing is said.
    fn compare(&self, found: &mut Verified) -> Result<(), Error> {
        let generation = self.shared.readable()?;
        let MapProgress { epoch, journaled, .. } = *self.shared.progress.borrow();
        let mut snapshot = self.snapshot(epoch)?;
        let (mut compared, mut damage) = (0, Vec::new());
        for id in generation.ids() {
            let replayed = snapshot.tiles.remove(&id);
            let Some((version, tile)) = generation.tiles.stored(id)?.filter(|(version, _)| *version <= epoch)
            else {
                continue;
            };
            compared += 1;
            if replayed.is_none_or(|replayed| replayed != tile) {
                damage.push(format!("tile {id} in version {version} is not what the journal says"));
            }
        }
        damage.extend(snapshot.tiles.keys().map(|id| format!("tile {id} is missing")));
        if !Arc::ptr_eq(&generation, &self.shared.readable()?) {
            return Err(Error::Rebuilding { folded: epoch, journaled });
        }
        found.damage.extend(damage);
        found.compared = Some(compared);
        Ok(())
    }
}

fn verify_tiles(generation: &Generation, found: &mut Verified) {
    match generation.tiles.check() {
        Ok((catalog, _)) => found.tiles = catalog.all().count() as u64,
        Err(reason) => found.damage.push(format!("the tiles: {reason}")),
    }
}
