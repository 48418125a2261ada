//! What a start goes on with: the generation that the manifest names, if it is this journal's and sound.

use std::sync::Arc;

use uuid::Uuid;

use super::checkpoint::Checkpoint;
use super::fold_worker::FoldWorker;
use super::generation::Generation;
use super::manifest::{Found, Manifest};
use super::policy::Policy;
use crate::store::api::{Error, io_error};
use crate::store::backend::Backend;
use crate::store::backend::tables::{TableId, TableUse};
use crate::store::log::index::JournalIndex;

/// The map's lineage, and where folding goes on. What is not needed for it any more is removed, or set aside.
pub(in crate::store) fn resume(
    backend: &Backend,
    (policy, lineage): (&Policy, Option<u64>),
    journal: Uuid,
    index: &JournalIndex,
) -> Result<(u64, FoldWorker), Error> {
    let manifest = manifest_of(backend, policy, journal)?;
    let sound = manifest.is_some();
    let lineage = match &manifest {
        Some(manifest) if manifest.policy == policy.digest() && lineage.is_none() => manifest.lineage,
        _ => match lineage {
            Some(shared) => shared,
            None => getrandom::u64().map_err(|error| io_error("drawing a lineage")(error.into()))?,
        },
    };
    let mut worker = opened(backend, policy, manifest, index)?;
    if worker.on.is_none() && worker.unopened.is_none() && index.newest() == 0 {
        worker.on = Some(first(backend, policy, journal, lineage)?);
    }
    let served = worker.on.as_ref().map(|generation| generation.number).or(worker.unopened);
    backend.tables.clean(journal, served, sound)?;
    Ok((lineage, worker))
}

/// The manifest, if it is of this journal. Any other is set aside: it may be what a restored journal lacks.
fn manifest_of(backend: &Backend, policy: &Policy, journal: Uuid) -> Result<Option<Manifest>, Error> {
    match Manifest::read(&*backend.manifests, policy)? {
        Found::None => Ok(None),
        Found::Sound(manifest) if manifest.journal == journal => Ok(Some(manifest)),
        Found::Sound(_) => backend.manifests.set_aside("a manifest of another journal").map(|()| None),
        Found::Damaged => backend.manifests.set_aside("a damaged manifest").map(|()| None),
    }
}

/// Opens the generation that the manifest names. One that is damaged or gone is made anew.
fn opened(
    backend: &Backend,
    in_force: &Policy,
    manifest: Option<Manifest>,
    index: &JournalIndex,
) -> Result<FoldWorker, Error> {
    let nothing = FoldWorker { on: None, applied: 0, folded: index.before(), unopened: None };
    let Some(Manifest { generation: number, applied, journal, policy, .. }) = manifest else {
        return Ok(nothing);
    };
    match Generation::open(&*backend.tables, number, journal, in_force.publish_contributors) {
        Ok(on) if !on.is_whole(applied, index)? => Ok(nothing),
        Ok(_) if policy != in_force.digest() => {
            tracing::warn!("what counts and what is served was configured anew; folding the tiles anew");
            Ok(nothing)
        }
        Ok(on) => {
            let folded = on.folded();
            Ok(FoldWorker { on: Some(Arc::new(on)), applied, folded, unopened: None })
        }
        // The disk or the system refuses, which says nothing of the tiles.
        Err(reason) if reason.may_pass() && policy == in_force.digest() => {
            tracing::warn!(%reason, "the tiles cannot be opened for the moment; trying again");
            Ok(FoldWorker { applied, unopened: Some(number), ..nothing })
        }
        Err(reason) => {
            tracing::warn!(%reason, "the tiles cannot be used; folding them anew");
            Ok(nothing)
        }
    }
}

/// The empty generation of a new journal.
fn first(backend: &Backend, policy: &Policy, journal: Uuid, lineage: u64) -> Result<Arc<Generation>, Error> {
    let id = TableId { used: TableUse::Served, number: backend.tables.next_number()? };
    let generation = Generation::create(&*backend.tables, id, journal, policy.publish_contributors)?;
    generation.load(&*backend.objects, &Checkpoint::default())?;
    generation.complete(journal)?;
    let manifest = Manifest { journal, generation: id.number, applied: 0, lineage, policy: policy.digest() };
    manifest.write(&*backend.manifests)?;
    Ok(Arc::new(generation))
}
