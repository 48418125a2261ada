//! An upload is held against the map that exists before it is folded.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use echofix_core::align::weights::TileWeights;
use echofix_core::datum::{Datum, Offset};
use echofix_core::evidence::{Contribution, Share};
use echofix_core::geo::{TILE_M, TileId, Zone};
use echofix_core::vetting::alarm::QuarantinedUpload as Entry;
use echofix_core::vetting::{
    Limits, MapSide, Offsets, Reason, Vetted, Vetter, has_other_contributors, moved_evidence,
};

use super::canvas::{Canvas, Folded};
use super::{Error, Upload};

/// Prepared tiles that are kept for the next upload, which likely comes from near by: a quarter of a
/// megabyte each.
const PREPARED: usize = 256;

/// An upload that was kept out of the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quarantined {
    /// Number of its record.
    pub number: u64,
    /// Why.
    pub reason: Reason,
    /// Where it was, whose it was, and how far off.
    pub upload: Entry,
}

/// What becomes of an upload.
pub(super) enum Outcome {
    /// It counts: its shares, moved onto the map, each with what moved it at its tile's centre.
    Counts(Vec<(TileId, Share, Offset)>),
    /// It does not.
    Quarantined(Quarantined),
}

/// What vetting keeps between uploads.
pub(super) struct Vetting {
    /// Without limits nothing is vetted.
    limits: Option<Limits>,
    vetter: Vetter,
    prepared: HashMap<(TileId, [u64; 9]), Arc<TileWeights>>,
}

impl Vetting {
    pub(super) fn new(limits: Option<Limits>) -> Self {
        Self { limits, vetter: Vetter::default(), prepared: HashMap::new() }
    }

    /// Holds an upload against what others told of its place.
    pub(super) fn vet(
        &mut self,
        canvas: &mut Canvas<'_>,
        number: u64,
        upload: &Upload,
    ) -> Result<Outcome, Error> {
        let zones = by_zone(&upload.contribution);
        let Some(limits) = self.limits else {
            let as_it_came = zones.values().flat_map(|shares| moved_evidence(shares, &Offsets::default()));
            return Ok(Outcome::Counts(as_it_came.collect()));
        };
        let mut counts = Vec::new();
        for (zone, shares) in zones {
            let contributor = upload.pass.contributor;
            let others = Others {
                contributor,
                within: RefCell::new(Within { canvas, prepared: &mut self.prepared, failed: None }),
            };
            let cells: Vec<_> = shares.iter().map(|(id, share)| (*id, &share.cells[..])).collect();
            let vetted = self.vetter.vet(&cells, &others, &limits);
            if let Some(error) = others.within.into_inner().failed {
                return Err(error);
            }
            match vetted {
                Vetted::Agrees(offsets) | Vetted::New(offsets) => {
                    counts.extend(moved_evidence(&shares, &offsets));
                }
                Vetted::Quarantined { reason, offset } => {
                    let (place, day) = (middle(&shares), upload.pass.day);
                    let upload = Entry { zone, place, offset, contributor, day };
                    return Ok(Outcome::Quarantined(Quarantined { number, reason, upload }));
                }
            }
        }
        Ok(Outcome::Counts(counts))
    }
}

fn by_zone(contribution: &Contribution) -> BTreeMap<Zone, Vec<(TileId, &Share)>> {
    let mut zones: BTreeMap<Zone, Vec<_>> = BTreeMap::new();
    for (id, share) in &contribution.tiles {
        zones.entry(id.zone).or_default().push((*id, share));
    }
    zones
}

/// Map metres of the middle of the tiles, each counting by its cells.
fn middle(shares: &[(TileId, &Share)]) -> [f64; 2] {
    let cells: usize = shares.iter().map(|(_, share)| share.cells.len()).sum();
    let weighted = |axis: usize| {
        let at =
            |(id, share): &(TileId, &Share)| (id.origin()[axis] + 0.5 * TILE_M) * share.cells.len() as f64;
        shares.iter().map(at).sum::<f64>() / cells.max(1) as f64
    };
    [weighted(0), weighted(1)]
}

/// The map without what only the upload's own contributor told.
struct Others<'a, 'b> {
    contributor: u64,
    within: RefCell<Within<'a, 'b>>,
}

struct Within<'a, 'b> {
    canvas: &'a mut Canvas<'b>,
    prepared: &'a mut HashMap<(TileId, [u64; 9]), Arc<TileWeights>>,
    /// The first tile that could not be read: what came of it must not be used.
    failed: Option<Error>,
}

impl MapSide for Others<'_, '_> {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        let mut within = self.within.borrow_mut();
        let weights = within.weights(id, self.contributor);
        within.noted(weights).flatten()
    }

    fn datum(&self, id: TileId) -> Datum {
        let mut within = self.within.borrow_mut();
        let datum = within.canvas.get(id).map(|folded| folded.tile.datum());
        within.noted(datum).unwrap_or_default()
    }
}

impl Within<'_, '_> {
    fn weights(&mut self, id: TileId, contributor: u64) -> Result<Option<Arc<TileWeights>>, Error> {
        let Folded { tile, ledger, .. } = self.canvas.get(id)?;
        if !has_other_contributors(tile, ledger, contributor) {
            return Ok(None);
        }
        let near = id.with_neighbours();
        let mut versions = [0; 9];
        for (version, id) in versions.iter_mut().zip(near) {
            *version = self.canvas.get(id)?.version;
        }
        if let Some(known) = self.prepared.get(&(id, versions)) {
            return Ok(Some(Arc::clone(known)));
        }
        let weights =
            Arc::new(TileWeights::new(id, |at| self.canvas.looked_at(at).map(|folded| &folded.tile)));
        if self.prepared.len() >= PREPARED {
            self.prepared.clear();
        }
        self.prepared.insert((id, versions), Arc::clone(&weights));
        Ok(Some(weights))
    }

    fn noted<T>(&mut self, outcome: Result<T, Error>) -> Option<T> {
        outcome.map_err(|error| self.failed.get_or_insert(error)).ok()
    }
}
