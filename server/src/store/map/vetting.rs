//! Vetting: an upload is compared with the map before it is folded.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use echofix_core::align::weights::TileWeights;
use echofix_core::datum::{Datum, Offset};
use echofix_core::evidence::{EvidenceDelta, TileEvidence};
use echofix_core::geo::{TileId, Zone};
use echofix_core::point::MapPoint;
use echofix_core::vetting::alarm::QuarantinedUpload;
use echofix_core::vetting::{
    MapSide, Offsets, Vetted, Vetter, VettingLimits, has_other_contributors, moved_evidence,
};

use super::write_buffer::{Folded, WriteBuffer};
use crate::store::api::{Error, FoldingFigures, QuarantinedRecord, UploadRecord};

/// Prepared tiles that are cached for the next upload, which likely comes from near by: some hundred kilobytes each.
const PREPARED: usize = 256;

/// What becomes of an upload.
pub(super) enum VettingOutcome {
    /// It counts: its tile evidence, moved onto the map, each with what moved it at its tile's centre.
    Counts(Vec<(TileId, TileEvidence, Offset)>),
    /// It does not.
    Quarantined(QuarantinedRecord),
}

/// Buffers and prepared tiles that pass from one upload to the next.
pub(in crate::store) struct Vetting {
    /// Without limits nothing is vetted.
    limits: Option<VettingLimits>,
    vetter: Vetter,
    prepared: HashMap<(TileId, [u64; 9]), Arc<TileWeights>>,
    decided: FoldingFigures,
}

impl Vetting {
    pub(in crate::store) fn new(limits: Option<VettingLimits>) -> Self {
        Self {
            limits,
            vetter: Vetter::default(),
            prepared: HashMap::new(),
            decided: FoldingFigures::default(),
        }
    }

    /// What it has decided so far; no time is in it.
    pub(super) fn decided(&self) -> FoldingFigures {
        self.decided
    }

    /// Compares an upload with what others contributed where it lies.
    pub(super) fn vet(
        &mut self,
        buffer: &mut WriteBuffer<'_>,
        number: u64,
        upload: &UploadRecord,
    ) -> Result<VettingOutcome, Error> {
        let zones = by_zone(&upload.contribution);
        let Some(limits) = self.limits else {
            let as_it_came = zones
                .values()
                .flat_map(|evidence_by_tile| moved_evidence(evidence_by_tile, &Offsets::default()));
            self.decided.not_vetted += 1;
            return Ok(VettingOutcome::Counts(as_it_came.collect()));
        };
        let (mut counts, mut agrees) = (Vec::new(), false);
        for (zone, evidence_by_tile) in zones {
            let contributor = upload.pass.contributor;
            let others = OthersMap {
                contributor,
                within: RefCell::new(OthersMapState { buffer, prepared: &mut self.prepared, failed: None }),
            };
            let cells: Vec<_> =
                evidence_by_tile.iter().map(|(id, evidence)| (*id, &evidence.cells[..])).collect();
            let vetted = self.vetter.vet(&cells, &others, &limits, upload.declared);
            if let Some(error) = others.within.into_inner().failed {
                return Err(error);
            }
            agrees |= matches!(vetted, Vetted::Agrees(_));
            match vetted {
                Vetted::Agrees(offsets) | Vetted::New(offsets) => {
                    counts.extend(moved_evidence(&evidence_by_tile, &offsets));
                }
                Vetted::Quarantined { reason, offset } => {
                    self.decided.quarantined += 1;
                    let (position, day) = (middle(&evidence_by_tile), upload.pass.day);
                    let upload = QuarantinedUpload { zone, position, offset, contributor, day };
                    return Ok(VettingOutcome::Quarantined(QuarantinedRecord { number, reason, upload }));
                }
            }
        }
        *if agrees { &mut self.decided.agree } else { &mut self.decided.new } += 1;
        Ok(VettingOutcome::Counts(counts))
    }
}

fn by_zone(contribution: &EvidenceDelta) -> BTreeMap<Zone, Vec<(TileId, &TileEvidence)>> {
    let mut zones: BTreeMap<Zone, Vec<_>> = BTreeMap::new();
    for (id, evidence) in &contribution.tiles {
        zones.entry(id.zone).or_default().push((*id, evidence));
    }
    zones
}

/// The middle of the tiles, each counting by its cells.
fn middle(evidence_by_tile: &[(TileId, &TileEvidence)]) -> MapPoint {
    let cells: usize = evidence_by_tile.iter().map(|(_, evidence)| evidence.cells.len()).sum();
    let weighted = |along: fn(MapPoint) -> f64| {
        let at = |(id, evidence): &(TileId, &TileEvidence)| along(id.centre()) * evidence.cells.len() as f64;
        evidence_by_tile.iter().map(at).sum::<f64>() / cells.max(1) as f64
    };
    MapPoint::new(weighted(|p| p.x_m), weighted(|p| p.y_m))
}

/// The map without what only the upload's own contributor contributed.
struct OthersMap<'a, 'b> {
    contributor: u64,
    within: RefCell<OthersMapState<'a, 'b>>,
}

struct OthersMapState<'a, 'b> {
    buffer: &'a mut WriteBuffer<'b>,
    prepared: &'a mut HashMap<(TileId, [u64; 9]), Arc<TileWeights>>,
    /// The first tile that could not be read: what came of it must not be used.
    failed: Option<Error>,
}

impl MapSide for OthersMap<'_, '_> {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        let mut within = self.within.borrow_mut();
        let weights = within.weights(id, self.contributor);
        within.noted(weights).flatten()
    }

    fn datum(&self, id: TileId) -> Datum {
        let mut within = self.within.borrow_mut();
        let datum = within.buffer.get(id).map(|folded| folded.tile.datum());
        within.noted(datum).unwrap_or_default()
    }
}

impl OthersMapState<'_, '_> {
    fn weights(&mut self, id: TileId, contributor: u64) -> Result<Option<Arc<TileWeights>>, Error> {
        let Folded { tile, ledger, .. } = self.buffer.get(id)?;
        if !has_other_contributors(tile, ledger, contributor) {
            return Ok(None);
        }
        let near = id.with_neighbours();
        let mut versions = [0; 9];
        for (version, id) in versions.iter_mut().zip(near) {
            *version = self.buffer.get(id)?.version;
        }
        if let Some(known) = self.prepared.get(&(id, versions)) {
            return Ok(Some(Arc::clone(known)));
        }
        let weights =
            Arc::new(TileWeights::new(id, |at| self.buffer.looked_at(at).map(|folded| &folded.tile)));
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
