//! A new generation of tiles, made beside the one that is served.
//!
//! 1. What is to be compacted is folded into a new checkpoint: written, synced, renamed.
//! 2. The checkpoint and the journal after it are folded, without what the controls exclude, into a new
//!    directory.
//! 3. Tiles whose bytes are as they were keep their version; the others get the control's number.
//! 4. The manifest names the new generation: from here on a restart serves it.
//! 5. It is served, and then what is no longer needed is deleted: the old generation, the old checkpoint, the
//!    compacted segments.
//!
//! A crash before step 4 leaves the old state and some files that the next start removes; one after it
//! leaves only deletions to be done.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use echofix_core::tile::Ledger;

use super::checkpoint::Checkpoint;
use super::context::StoreContext;
use super::fold::{CountedRecords, replay};
use super::generation::Generation;
use super::manifest::Manifest;
use super::serving;
use super::vetting::Vetting;
use crate::store::api::{Building, Error, MapStatus};
use crate::store::backend::tables::{TableId, TableUse};

/// The generation that came of it.
pub(in crate::store) struct Built {
    pub(in crate::store) generation: Arc<Generation>,
    /// The last control it was made under.
    pub(in crate::store) applied: u64,
    /// The last record it holds.
    pub(in crate::store) folded: u64,
}

/// Makes a generation under the newest control and serves it. `None` when the end was called.
pub(in crate::store) fn build(shared: &StoreContext) -> Result<Option<Built>, Error> {
    let applied = shared.index.newest_control();
    let mut reporter = BuildReporter::new(shared, applied);
    let Some(checkpoint) = compacted_checkpoint(shared, applied, &mut reporter)? else { return Ok(None) };
    let fresh = created(shared, TableUse::Served)?;
    let outcome = fill(shared, &fresh, &checkpoint, applied, &mut reporter);
    let Some(folded) = outcome.inspect_err(|_| fresh.retire())? else {
        fresh.retire();
        return Ok(None);
    };
    let generation = publish_and_serve(shared, fresh, applied, folded)?;
    if let Err(error) = discard_compacted(shared, checkpoint) {
        tracing::error!(%error, "compacted records could not be deleted; the next start does");
    }
    tracing::info!(epoch = folded, control = applied, "a new generation of the map is served");
    Ok(Some(Built { generation, applied, folded }))
}

/// A new, empty generation.
fn created(shared: &StoreContext, used: TableUse) -> Result<Generation, Error> {
    let tables = &*shared.backend.tables;
    let id = TableId { used, number: tables.next_number()? };
    Generation::create(tables, id, shared.journal_id, shared.settings.policy.publish_contributors)
}

/// Names a generation in the manifest, serves it, and lets the one before go.
fn publish_and_serve(
    shared: &StoreContext,
    fresh: Generation,
    applied: u64,
    folded: u64,
) -> Result<Arc<Generation>, Error> {
    let (journal, lineage, policy) = (shared.journal_id, shared.lineage, shared.settings.policy.digest());
    Manifest { journal, generation: fresh.number, applied, lineage, policy }
        .write(&*shared.backend.manifests)?;
    serving::prepare(shared, &fresh, BTreeMap::new());
    let generation = Arc::new(fresh);
    let before = shared.serve(Some(generation.clone()));
    shared.progress.send_modify(|progress| {
        progress.epoch = folded;
        progress.state = MapStatus::Serving;
        progress.building = None;
    });
    if let Some(before) = before {
        before.retire();
    }
    Ok(generation)
}

/// Makes a generation of what another one shows, which takes no more writes: its tiles, as they are, without folding
/// anything.
pub(in crate::store) fn replace(
    shared: &StoreContext,
    failed: &Generation,
    applied: u64,
) -> Result<Arc<Generation>, Error> {
    failed.tiles.table().room_for(failed.catalog().totals(0, 0).bytes)?;
    let fresh = created(shared, TableUse::Served)?;
    let filled = fresh.copy(failed).and_then(|()| fresh.complete(shared.journal_id));
    filled.and_then(|()| fresh.tiles.table().flush()).inspect_err(|_| fresh.retire())?;
    publish_and_serve(shared, fresh, applied, failed.folded())
}

/// Deletes what a checkpoint stands for.
pub(in crate::store) fn discard_compacted(
    shared: &StoreContext,
    checkpoint: Checkpoint,
) -> Result<(), Error> {
    let mut current = shared.checkpoint_mut();
    let last = checkpoint.last;
    shared.compacted_uploads.store(checkpoint.uploads, Ordering::Relaxed);
    *current = checkpoint;
    shared.index.truncate(last);
    shared.journal.delete_up_to(last)?;
    current.remove_others(&*shared.backend.objects, shared.journal_id)
}

/// Folds checkpoint and journal into an empty generation. Returns the last record it holds; `None` when the
/// end was called.
fn fill(
    shared: &StoreContext,
    fresh: &Generation,
    checkpoint: &Checkpoint,
    applied: u64,
    reporter: &mut BuildReporter<'_>,
) -> Result<Option<u64>, Error> {
    let (index, journal) = (&shared.index, &shared.journal);
    let mut vetting = Vetting::new(shared.settings.policy.vetting);
    fresh.load(&*shared.backend.objects, checkpoint)?;
    let exclusion = &index.exclusion(applied);
    let records =
        CountedRecords { journal, index, exclusion, buffer_tiles: shared.settings.write_buffer_tiles };
    let mut folded = checkpoint.last;
    loop {
        // A later control takes a generation of its own.
        let end = index.control_after(applied).map_or_else(|| index.newest(), |next| next - 1);
        if folded >= end {
            break;
        }
        folded = replay(&records, &mut &*fresh, folded, end, &mut vetting, |at| reporter.at(at))?;
        if index.ended() {
            return Ok(None);
        }
    }
    set_versions(fresh, shared.served().as_deref(), applied, folded)?;
    fresh.complete(shared.journal_id)?;
    fresh.tiles.table().flush()?;
    Ok(Some(folded))
}

/// A version stands for the same bytes wherever it was handed out: tiles that are as they were keep it,
/// all others take the control's number.
fn set_versions(
    fresh: &Generation,
    before: Option<&Generation>,
    applied: u64,
    folded: u64,
) -> Result<(), Error> {
    fresh.change_all(folded, |id, tile| {
        let same = match before {
            Some(before) => {
                // One that cannot be read any more cannot be compared: its tile takes a number that it never had.
                let (old, new) = (before.tiles.raw(id).ok().flatten(), fresh.tiles.raw(id)?);
                old.zip(new).filter(|((_, old), (_, new))| old == new).map(|((version, _), _)| version)
            }
            None => None,
        };
        let version = same.unwrap_or_else(|| tile.version.max(applied));
        Ok(std::mem::replace(&mut tile.version, version) != version)
    })
}

/// The checkpoint that the controls up to `applied` ask for; made if need be. `None` when the end was called.
fn compacted_checkpoint(
    shared: &StoreContext,
    applied: u64,
    reporter: &mut BuildReporter<'_>,
) -> Result<Option<Checkpoint>, Error> {
    let (objects, index) = (&*shared.backend.objects, &shared.index);
    let checkpoint = Checkpoint::newest(objects, shared.journal_id)?;
    if checkpoint.last < index.before() {
        return Err(uncovered(index.before(), checkpoint.last));
    }
    let mut compactions = index.compactions_beyond(checkpoint.last);
    compactions.retain(|(number, _)| *number <= applied);
    let Some((_, newest)) = compactions.last().copied() else { return Ok(Some(checkpoint)) };
    let scratch = created(shared, TableUse::Scratch)?;
    // Its ledgers must not stay on disk.
    scratch.retire();
    scratch.load(objects, &checkpoint)?;
    let (mut folded, journal) = (checkpoint.last, &shared.journal);
    let mut vetting = Vetting::new(shared.settings.policy.vetting);
    for (number, last) in compactions {
        // What was decided after a compaction does not change what was compacted.
        let exclusion = &index.exclusion(number);
        let records =
            CountedRecords { journal, index, exclusion, buffer_tiles: shared.settings.write_buffer_tiles };
        folded = replay(&records, &mut &scratch, folded, last, &mut vetting, |at| reporter.at(at))?;
        if index.ended() {
            return Ok(None);
        }
        scratch.change_all(folded, |_, tile| {
            tile.ledger = Ledger::default();
            Ok(true)
        })?;
    }
    let uploads = checkpoint.uploads + index.uploads_within(checkpoint.last, newest);
    let lost = || Error::Damaged { what: "the scratch tiles".to_owned(), reason: "one is gone".to_owned() };
    let checkpoint = Checkpoint::write(objects, shared.journal_id, (newest, uploads), &scratch.ids(), |id| {
        scratch.tiles.raw(id)?.ok_or_else(lost)
    });
    checkpoint.map(Some)
}

/// Compacted records are gone and what stood for them, too.
pub(in crate::store) fn uncovered(before: u64, checkpoint: u64) -> Error {
    Error::Damaged {
        what: "the checkpoint".to_owned(),
        reason: format!(
            "the journal begins after record {before} but the newest sound checkpoint ends at {checkpoint}. Restore the \
             file base-{before} or a later one from a backup"
        ),
    }
}

/// Tells how far the building is.
struct BuildReporter<'a> {
    shared: &'a StoreContext,
    control: u64,
    last: Option<Instant>,
}

impl<'a> BuildReporter<'a> {
    fn new(shared: &'a StoreContext, control: u64) -> Self {
        Self { shared, control, last: None }
    }

    /// Called with the last record folded; false when the end was called.
    fn at(&mut self, folded: u64) -> bool {
        self.shared.beat.beat();
        let of = self.shared.index.newest();
        self.shared.progress.send_modify(|progress| {
            progress.building = Some(Building { folded, of, control: self.control });
            if progress.state == MapStatus::Rebuilding {
                progress.epoch = folded;
            }
        });
        if self.last.is_none_or(|last| last.elapsed() > Duration::from_secs(1)) {
            tracing::info!(folded, of, control = self.control, "folding a new generation of the map");
            self.last = Some(Instant::now());
        }
        !self.shared.index.ended()
    }
}
