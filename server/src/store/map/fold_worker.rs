//! The thread that folds: records into the served generation, and new generations when a control asks
//! for one.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::attempt::{TilesError, caught};
use super::build::{self, Built};
use super::context::StoreContext;
use super::fold::{FoldedGroup, fold_group};
use super::generation::Generation;
use super::serving::Serving;
use super::vetting::Vetting;
use crate::lanes::{BACKGROUND, lower};
use crate::store::api::{Error, MapStatus};
use crate::store::log::index::NextFold;
use crate::store::log::position::Written;

/// How often an error that stays is logged.
const REMINDER: Duration = Duration::from_mins(1);

/// Where folding stands.
pub(in crate::store) struct FoldWorker {
    /// `None` when there is no generation to fold on.
    pub(in crate::store) on: Option<Arc<Generation>>,
    /// The last control it was made under.
    pub(in crate::store) applied: u64,
    /// The last record it holds.
    pub(in crate::store) folded: u64,
    /// The generation to fold on, which could not be opened for the moment.
    pub(in crate::store) unopened: Option<u64>,
}

/// Folds until the end is called.
pub(in crate::store) fn run(shared: &StoreContext, mut folder: FoldWorker) {
    lower(BACKGROUND);
    let whole = shared.index.newest();
    let (mut logged, mut reminded) = (Instant::now(), None);
    let mut vetting = Vetting::new(shared.settings.policy.vetting);
    loop {
        match folder.step(shared, &mut vetting) {
            Ok(false) => return,
            Ok(true) if folder.on.is_none() => {}
            Ok(true) => {
                if reminded.take().is_some() {
                    tracing::info!(epoch = folder.folded, "folding goes on");
                }
                shared.set_state(MapStatus::Serving);
            }
            Err(reason) => {
                let reason = reason.to_string();
                let told = reminded
                    .as_ref()
                    .is_some_and(|(last, at): &(String, Instant)| *last == reason && at.elapsed() < REMINDER);
                if !told {
                    tracing::error!(reason, "folding failed; trying again");
                    reminded = Some((reason, Instant::now()));
                }
                if shared.served().is_some() {
                    shared.set_state(MapStatus::Stalled);
                }
                shared.beat.rest();
                if !shared.index.pause(shared.settings.retry) {
                    return;
                }
                shared.beat.beat();
                folder.mend(shared);
            }
        }
        if folder.folded < whole && logged.elapsed() > Duration::from_secs(1) {
            tracing::info!(folded = folder.folded, journaled = whole, "folding the journal into tiles");
            logged = Instant::now();
        }
    }
}

impl FoldWorker {
    /// Does what is next, waiting for it. False at the end.
    fn step(&mut self, shared: &StoreContext, vetting: &mut Vetting) -> Result<bool, TilesError> {
        let Some(on) = self.on.clone() else {
            shared.beat.beat();
            return if self.unopened.is_some() { self.open(shared) } else { self.build(shared) };
        };
        shared.beat.rest();
        let next = shared.index.next(self.folded, self.applied);
        shared.beat.beat();
        match next {
            None => Ok(false),
            Some(NextFold::Build) => self.build(shared),
            Some(NextFold::Records(group)) => {
                let newest = group.last().map_or(self.folded, |written| written.number);
                let began = Instant::now();
                let folded = caught(|| fold(shared, &on, &group, newest, vetting));
                shared.note_folded(began.elapsed(), vetting.decided());
                let FoldedGroup { kept_out, up_to } = folded?;
                self.folded = up_to;
                shared.progress.send_modify(|progress| progress.epoch = up_to);
                for record in kept_out {
                    // Nobody needs to listen.
                    let _ = shared.kept_out.send(record);
                }
                Ok(true)
            }
        }
    }

    /// Opens what could not be opened at the start, and serves it.
    fn open(&mut self, shared: &StoreContext) -> Result<bool, TilesError> {
        let Some(number) = self.unopened else { return Ok(true) };
        let publish = shared.settings.policy.publish_contributors;
        match Generation::open(&*shared.backend.tables, number, shared.journal_id, publish) {
            Ok(on) if !on.is_whole(self.applied, &shared.index)? => self.unopened = None,
            Ok(on) => {
                let on = Arc::new(on);
                *self = Self { folded: on.folded(), on: Some(on.clone()), unopened: None, ..*self };
                shared.serve(Some(on));
                shared.progress.send_modify(|progress| progress.epoch = self.folded);
                shared.set_state(MapStatus::Serving);
                tracing::info!(epoch = self.folded, "the tiles are open");
            }
            Err(reason) if reason.may_pass() => return Err(reason),
            Err(reason) => {
                tracing::warn!(%reason, "the tiles cannot be used; folding them anew");
                self.unopened = None;
            }
        }
        Ok(true)
    }

    fn build(&mut self, shared: &StoreContext) -> Result<bool, TilesError> {
        let built = caught(|| build::build(shared)).inspect_err(|_| {
            shared.progress.send_modify(|progress| progress.building = None);
        })?;
        let Some(Built { generation, applied, folded }) = built else { return Ok(false) };
        *self = Self { on: Some(generation), applied, folded, unopened: None };
        Ok(true)
    }

    /// After a failure: some of a group may be folded, and tiles that failed to be written need others in their place. They are
    /// served as they were until there are.
    fn mend(&mut self, shared: &StoreContext) {
        let Some(on) = self.on.clone() else { return };
        self.folded = on.folded();
        if on.tiles.broken().is_none() {
            return;
        }
        match caught(|| build::replace(shared, &on, self.applied)) {
            Ok(fresh) => {
                tracing::info!(
                    epoch = self.folded,
                    "a copy of the tiles is served in place of those that failed"
                );
                self.on = Some(fresh);
            }
            // It is too early; the next step fails again, for the same reason.
            Err(reason) if reason.may_pass() => {}
            Err(reason) => {
                tracing::error!(%reason, "the tiles that failed cannot be copied; folding new ones");
                self.on = None;
            }
        }
    }
}

fn fold(
    shared: &StoreContext,
    on: &Generation,
    group: &[Written],
    newest: u64,
    vetting: &mut Vetting,
) -> Result<FoldedGroup, Error> {
    let (journal, go_on) = ((&shared.journal, shared.settings.write_buffer_tiles), || !shared.index.ended());
    fold_group(journal, &mut Serving { shared, on }, group, newest, (vetting, &go_on))
}
