//! The map's past: what happened, how it looked, what changed.

use std::collections::{BTreeMap, HashSet};

use echofix_core::tile;

use crate::store::api::{Decision, Error, EventKind, HistoryEvent, Remark, Snapshot};
use crate::store::log::entry::{Action, RecordKind};
use crate::store::log::exclusion::Exclusion;
use crate::store::map::context::StoreContext;
use crate::store::map::fold::{CountedRecords, replay};
use crate::store::map::vetting::Vetting;
use crate::store::map::write_buffer::{Folded, InMemory};

pub(in crate::store) fn events(shared: &StoreContext, limit: usize) -> Vec<HistoryEvent> {
    let _base = shared.checkpoint();
    let index = &shared.index;
    let exclusion = index.exclusion(index.newest_control());
    let controls: BTreeMap<_, _> = index.controls().into_iter().collect();
    let mut runs = Runs::default();
    index.visit(|number, day, kind| runs.add(number, day, kind, exclusion.excludes(number, kind)));
    let skipped = runs.events.len().saturating_sub(limit);
    let mut events = runs.events.split_off(skipped);
    let undone = index.undone();
    for event in &mut events {
        let is_control = matches!(event.what, EventKind::Control { .. });
        // Only the index knows what a control is about.
        if let Some(control) = controls.get(&event.first).filter(|_| is_control) {
            event.what = EventKind::Control {
                at_us: control.at_us,
                decision: decided(control.action),
                takes_back: index.effect(event.first, control.action),
                remark: control.remark.clone(),
                undone_by: undone.get(&event.first).copied(),
            };
        }
    }
    events.reverse();
    events
}

pub(in crate::store) fn snapshot(shared: &StoreContext, epoch: u64) -> Result<Snapshot, Error> {
    in_journal(shared, epoch)?;
    let tiles = folded(shared, epoch, &shared.index.exclusion(epoch))?;
    Ok(Snapshot { epoch, tiles: tiles.into_iter().map(|(id, folded)| (id, folded.tile)).collect() })
}

/// The map of checkpoint and journal up to an epoch, without what is excluded.
pub(super) fn folded(shared: &StoreContext, epoch: u64, exclusion: &Exclusion) -> Result<InMemory, Error> {
    // No record that is read here goes meanwhile.
    let checkpoint = shared.checkpoint();
    in_journal(shared, epoch)?;
    let index = &shared.index;
    let mut map = InMemory::new();
    checkpoint.visit(&*shared.backend.objects, |id, version, encoded| {
        let damaged = |error: tile::DecodeError| Error::Damaged {
            what: format!("tile {id} of the checkpoint"),
            reason: error.to_string(),
        };
        map.insert(
            id,
            Folded { version, tile: tile::decode(&encoded).map_err(damaged)?, ..Folded::default() },
        );
        Ok(())
    })?;
    let mut vetting = Vetting::new(shared.settings.policy.vetting);
    let records = CountedRecords {
        journal: &shared.journal,
        index,
        exclusion,
        buffer_tiles: shared.settings.write_buffer_tiles,
    };
    let go_on = |_| !index.ended();
    replay(&records, &mut map, checkpoint.last, epoch, &mut vetting, go_on)?;
    if index.ended() {
        return Err(Error::Stopped("the store is being closed".to_owned()));
    }
    Ok(map)
}

/// The oldest and the newest epoch that a map can be had of.
pub(in crate::store) fn epochs(shared: &StoreContext) -> (u64, u64) {
    (shared.index.compacted().max(shared.index.before()), shared.index.newest())
}

/// Is this the epoch of a map that can be had?
pub(in crate::store) fn in_journal(shared: &StoreContext, epoch: u64) -> Result<(), Error> {
    let (oldest, newest) = epochs(shared);
    if (oldest..=newest).contains(&epoch) {
        return Ok(());
    }
    let reason = format!("epoch {epoch} cannot be had: the journal goes from {oldest} to {newest}");
    Err(Error::Unknown(reason))
}

fn decided(action: Action) -> Decision {
    match action {
        Action::RevokeContributor(hash) => Decision::RevokeContributor(hash),
        Action::RevokeUpload(id) => Decision::RevokeUpload(id),
        Action::Rollback(epoch) => Decision::Rollback(epoch),
        Action::Undo(number) => Decision::Undo(number),
        Action::Compact(last) => Decision::Compact(last),
    }
}

/// Gathers records of one kind that follow each other.
#[derive(Default)]
struct Runs {
    events: Vec<HistoryEvent>,
    contributors: HashSet<u64>,
}

impl Runs {
    fn add(&mut self, number: u64, day: u16, kind: RecordKind, excluded: bool) {
        let excluded = u64::from(excluded);
        match (self.events.last_mut().filter(|event| event.day == day), kind) {
            (
                Some(HistoryEvent {
                    last,
                    what: EventKind::Uploads { uploads, contributors, taken_back },
                    ..
                }),
                RecordKind::Upload { contributor },
            ) => {
                self.contributors.insert(contributor);
                *contributors = self.contributors.len() as u64;
                (*last, *uploads, *taken_back) = (number, *uploads + 1, *taken_back + excluded);
            }
            (
                Some(HistoryEvent { last, what: EventKind::Import { file, tiles, taken_back }, .. }),
                RecordKind::Import { file: of },
            ) if *file == of => {
                (*last, *tiles, *taken_back) = (number, *tiles + 1, *taken_back + excluded);
            }
            (_, kind) => {
                let what = match kind {
                    RecordKind::Upload { contributor } => {
                        self.contributors = HashSet::from([contributor]);
                        EventKind::Uploads { uploads: 1, contributors: 1, taken_back: excluded }
                    }
                    RecordKind::Import { file } => EventKind::Import { file, tiles: 1, taken_back: excluded },
                    RecordKind::Control => EventKind::Control {
                        at_us: 0,
                        decision: Decision::Compact(0),
                        takes_back: 0,
                        remark: Remark::default(),
                        undone_by: None,
                    },
                };
                self.events.push(HistoryEvent { first: number, last: number, day, what });
            }
        }
    }
}
