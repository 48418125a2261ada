//! Is what is stored sound, and is the map what the journal says?

use std::sync::Arc;

use echofix_core::tile;

use super::history::snapshot;
use crate::store::api::{Error, MapProgress, Verified};
use crate::store::log::entry;
use crate::store::map::context::StoreContext;
use crate::store::map::fold::unreadable;
use crate::store::map::generation::Generation;

pub(in crate::store) fn verified(shared: &StoreContext, replay: bool) -> Result<Verified, Error> {
    let mut found = Verified::default();
    verify_journal(shared, &mut found);
    verify_checkpoint(shared, &mut found);
    found.damage.extend(shared.backend.pseudonyms.damage());
    verify_tiles(&*shared.readable()?, &mut found);
    if replay {
        compare(shared, &mut found)?;
    }
    Ok(found)
}

fn verify_journal(shared: &StoreContext, found: &mut Verified) {
    let checkpoint = shared.checkpoint();
    let (mut at, mut reader) = (checkpoint.last, shared.journal.reader());
    let newest = shared.index.newest();
    while at < newest {
        let group = shared.index.records(at, newest);
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

fn verify_checkpoint(shared: &StoreContext, found: &mut Verified) {
    let mut tiles = 0;
    let outcome = shared.checkpoint().visit(&*shared.backend.objects, |id, _, encoded| {
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
fn compare(shared: &StoreContext, found: &mut Verified) -> Result<(), Error> {
    let generation = shared.readable()?;
    let MapProgress { epoch, journaled, .. } = *shared.progress.borrow();
    let mut snapshot = snapshot(shared, epoch)?;
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
    if !Arc::ptr_eq(&generation, &shared.readable()?) {
        return Err(Error::Rebuilding { folded: epoch, journaled });
    }
    found.damage.extend(damage);
    found.compared = Some(compared);
    Ok(())
}

fn verify_tiles(generation: &Generation, found: &mut Verified) {
    match generation.tiles.check() {
        Ok((catalog, _)) => found.tiles = catalog.all().count() as u64,
        Err(reason) => found.damage.push(format!("the tiles: {reason}")),
    }
}
