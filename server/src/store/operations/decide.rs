//! What operators propose: whether it can be decided, and what it would change.

use std::collections::HashSet;

use crate::store::api::{Contributor, Error, Preview, Proposal, Remark, Snapshot};
use crate::store::log::entry::{Action, Control, RecordKind};
use crate::store::log::exclusion::Exclusion;
use crate::store::map::context::StoreContext;
use crate::store::operations::history;

/// The control that a proposal comes to; `None` when there is nothing to compact.
pub(in crate::store) fn action(shared: &StoreContext, proposal: &Proposal) -> Result<Option<Action>, Error> {
    let (index, compacted) = (&shared.index, shared.index.compacted());
    Ok(Some(match proposal {
        Proposal::RevokeContributor(of) => {
            let contributor = match of {
                Contributor::Pseudonym(name) => shared.backend.pseudonyms.hash(name),
                Contributor::Hash(hash) => *hash,
            };
            if !index.any_after(compacted, RecordKind::Upload { contributor }) {
                return Err(unknown("this contributor has uploaded nothing that is not compacted"));
            }
            Action::RevokeContributor(contributor)
        }
        Proposal::RevokeUpload(id) => {
            let an_upload = index.find(*id).is_some_and(|written| written.number > compacted);
            if !an_upload && !index.any_after(compacted, RecordKind::Import { file: *id }) {
                return Err(unknown(format!(
                    "no upload or imported file {id} that is not compacted is known"
                )));
            }
            Action::RevokeUpload(*id)
        }
        Proposal::Rollback(epoch) => {
            history::in_journal(shared, *epoch)?;
            Action::Rollback(*epoch)
        }
        Proposal::Undo(number) => undoing(shared, *number, compacted)?,
        Proposal::Compact(before_day) => {
            // Before tomorrow is all that came until now.
            let tomorrow = shared.settings.clock.today().saturating_add(1);
            if *before_day > tomorrow {
                return Err(Error::Unusable("the day lies in the future; tomorrow is the latest".to_owned()));
            }
            let last = index.last_before(*before_day).filter(|last| *last > compacted);
            return Ok(last.map(Action::Compact));
        }
    }))
}

/// Undoes a decision, if all that it took back is still there.
fn undoing(shared: &StoreContext, number: u64, compacted: u64) -> Result<Action, Error> {
    let Some((control, in_effect)) = shared.index.control(number) else {
        return Err(unknown(format!(
            "record {number} is no decision that could be undone; the history lists them, and what is compacted cannot be \
             brought back"
        )));
    };
    if !in_effect {
        return Err(unknown(format!("decision {number} is undone already")));
    }
    let gone = match control.action {
        Action::Compact(_) => true,
        Action::Rollback(epoch) => epoch < compacted,
        _ => number <= compacted,
    };
    if gone || shared.index.effect(number, control.action) == 0 {
        return Err(unknown(format!(
            "decision {number} cannot be undone: what it took back is compacted, or there was nothing"
        )));
    }
    Ok(Action::Undo(number))
}

fn unknown(reason: impl Into<String>) -> Error {
    Error::Unknown(reason.into())
}

/// What a proposal would change. The caller holds nothing: what comes meanwhile is not in it.
pub(in crate::store) fn preview(shared: &StoreContext, proposal: &Proposal) -> Result<Preview, Error> {
    let Some(action) = action(shared, proposal)? else { return Ok(Preview::default()) };
    let index = &shared.index;
    if let Action::Compact(last) = action {
        let compacted = index.uploads_within(index.compacted(), last);
        return Ok(Preview { compacted, ..Preview::default() });
    }
    let epoch = index.newest();
    let now = index.exclusion(epoch);
    let then = index.exclusion_with(Control { at_us: 0, action, remark: Remark::default() });
    let mut preview = counted(shared, &now, &then, epoch);
    preview.tiles = at(shared, epoch, &now)?.diff(&at(shared, epoch, &then)?);
    Ok(preview)
}

fn at(shared: &StoreContext, epoch: u64, exclusion: &Exclusion) -> Result<Snapshot, Error> {
    let folded = history::folded(shared, epoch, exclusion)?;
    Ok(Snapshot { epoch, tiles: folded.into_iter().map(|(id, folded)| (id, folded.tile)).collect() })
}

/// The records up to an epoch that count under one exclusion and not under the other.
fn counted(shared: &StoreContext, now: &Exclusion, then: &Exclusion, epoch: u64) -> Preview {
    let compacted = shared.index.compacted();
    let (mut preview, mut contributors) = (Preview::default(), HashSet::new());
    shared.index.visit(|number, _, kind| {
        let (before, after) = (now.excludes(number, kind), then.excludes(number, kind));
        if before == after || number > epoch || number <= compacted {
            return;
        }
        match kind {
            RecordKind::Upload { contributor } => {
                contributors.insert(contributor);
                *(if after { &mut preview.uploads_out } else { &mut preview.uploads_back }) += 1;
            }
            RecordKind::Import { .. } => {
                *(if after { &mut preview.imports_out } else { &mut preview.imports_back }) += 1;
            }
            RecordKind::Control => {}
        }
    });
    preview.contributors = contributors.len() as u64;
    preview
}
