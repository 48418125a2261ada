//! Who contributed what, of what is not compacted.

use std::collections::{HashMap, HashSet, VecDeque};

use uuid::Uuid;

use crate::store::api::{ContributedUpload, ContributorFigures, Error, Revocation, UploadFate};
use crate::store::log::entry::{Action, Control, RecordKind};
use crate::store::log::exclusion::Exclusion;
use crate::store::log::index::JournalIndex;
use crate::store::map::context::StoreContext;

/// Whether uploads count.
struct Fates {
    kept_out: HashSet<u64>,
    exclusion: Exclusion,
}

impl Fates {
    fn of(shared: &StoreContext) -> Result<Self, Error> {
        let kept_out = shared.readable()?.tiles.quarantined()?;
        let kept_out = kept_out.iter().map(|record| record.number).collect();
        Ok(Self { kept_out, exclusion: shared.index.exclusion(shared.index.newest_control()) })
    }

    fn get(&self, number: u64, kind: RecordKind) -> UploadFate {
        if self.exclusion.excludes(number, kind) {
            UploadFate::TakenBack
        } else if self.kept_out.contains(&number) {
            UploadFate::Quarantined
        } else {
            UploadFate::Counted
        }
    }
}

/// All contributors, in order of their hashes.
pub(in crate::store) fn all(shared: &StoreContext) -> Result<Vec<ContributorFigures>, Error> {
    let fates = Fates::of(shared)?;
    let mut found = HashMap::<u64, ContributorFigures>::new();
    shared.index.visit(|number, day, kind| {
        let RecordKind::Upload { contributor: hash } = kind else { return };
        let figures = found.entry(hash).or_insert(ContributorFigures {
            hash,
            uploads: 0,
            taken_back: 0,
            quarantined: 0,
            first_day: day,
            last_day: day,
            last: number,
            revoked: None,
        });
        figures.uploads += 1;
        // A clock may have been set back.
        figures.first_day = figures.first_day.min(day);
        figures.last_day = figures.last_day.max(day);
        figures.last = number;
        match fates.get(number, kind) {
            UploadFate::TakenBack => figures.taken_back += 1,
            UploadFate::Quarantined => figures.quarantined += 1,
            UploadFate::Counted => {}
        }
    });
    for (hash, revocation) in revocations(&shared.index) {
        if let Some(figures) = found.get_mut(&hash) {
            figures.revoked = Some(revocation);
        }
    }
    let mut all: Vec<_> = found.into_values().collect();
    all.sort_unstable_by_key(|figures| figures.hash);
    Ok(all)
}

/// The revocations of contributors that are in effect, in order.
fn revocations(index: &JournalIndex) -> Vec<(u64, Revocation)> {
    let undone = index.undone();
    let controls = index.controls().into_iter().filter(|(number, _)| !undone.contains_key(number));
    let revocation = |(number, control): (u64, _)| {
        let Control { at_us, action, remark } = control;
        match action {
            Action::RevokeContributor(hash) => Some((hash, Revocation { number, at_us, remark })),
            _ => None,
        }
    };
    controls.filter_map(revocation).collect()
}

/// An upload by its id, and its contributor's hash.
pub(in crate::store) fn upload(
    shared: &StoreContext,
    id: Uuid,
) -> Result<Option<(u64, ContributedUpload)>, Error> {
    let Some((number, day, contributor)) = shared.index.upload(id) else { return Ok(None) };
    let fate = Fates::of(shared)?.get(number, RecordKind::Upload { contributor });
    Ok(Some((contributor, ContributedUpload { number, id: Some(id), day, fate })))
}

/// The newest uploads of a contributor before a record, at most so many, newest first.
pub(in crate::store) fn uploads_of(
    shared: &StoreContext,
    hash: u64,
    before: u64,
    limit: usize,
) -> Result<Vec<ContributedUpload>, Error> {
    let fates = Fates::of(shared)?;
    let mut newest = VecDeque::with_capacity(limit.min(1000) + 1);
    shared.index.visit(|number, day, kind| {
        if number < before && kind == (RecordKind::Upload { contributor: hash }) {
            newest.push_back(ContributedUpload { number, id: None, day, fate: fates.get(number, kind) });
            if newest.len() > limit {
                newest.pop_front();
            }
        }
    });
    let ids = shared.index.ids(&newest.iter().map(|upload| upload.number).collect());
    let named =
        |upload: ContributedUpload| ContributedUpload { id: ids.get(&upload.number).copied(), ..upload };
    Ok(newest.into_iter().rev().map(named).collect())
}
