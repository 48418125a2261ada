//! A map that is made as the service makes it: uploads are vetted, moved onto the map and folded, or quarantined.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use echofix_core::align::weights::TileWeights;
use echofix_core::datum::Datum;
use echofix_core::evidence::TileEvidence;
use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::{Decay, Ledger, Tile};
use echofix_core::vetting::{
    MapSide, Offsets, Vetted, Vetter, VettingLimits, has_other_contributors, moved_evidence,
};

use super::uploads::VehicleUpload;
use crate::evaluate::map::{MapKey, RadarMap};

/// A map in one zone, made of uploads.
pub struct CrowdMap {
    zone: Zone,
    folded: FoldedMap,
    vetter: Vetter,
    limits: VettingLimits,
}

/// The folded tiles with their ledgers, and the tiles that are prepared for vetting.
#[derive(Default)]
struct FoldedMap {
    tiles: BTreeMap<TileId, Tile>,
    ledgers: BTreeMap<TileId, Ledger>,
    prepared: Mutex<HashMap<TileId, Arc<TileWeights>>>,
}

impl CrowdMap {
    /// An empty map.
    pub fn new(zone: Zone) -> Self {
        Self {
            zone,
            folded: FoldedMap::default(),
            vetter: Vetter::default(),
            limits: VettingLimits::default(),
        }
    }

    /// An independent copy.
    #[must_use]
    pub fn fork(&self) -> Self {
        let FoldedMap { tiles, ledgers, .. } = &self.folded;
        let folded = FoldedMap { tiles: tiles.clone(), ledgers: ledgers.clone(), prepared: Mutex::default() };
        Self { zone: self.zone, folded, vetter: Vetter::default(), limits: self.limits }
    }

    /// The UTM zone of the map.
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Vets an upload, without folding it.
    pub fn vet(&mut self, upload: &VehicleUpload) -> Vetted {
        let cells: Vec<_> =
            upload.delta.tiles.iter().map(|(id, evidence)| (*id, &evidence.cells[..])).collect();
        let others = OthersEvidence { folded: &self.folded, contributor: upload.pass.contributor };
        self.vetter.vet(&cells, &others, &self.limits, Some(upload.sigma))
    }

    /// Vets an upload and folds it. Returns the evidence as it was folded, or `None` when the upload is quarantined.
    pub fn offer(&mut self, upload: &VehicleUpload) -> Option<Vec<(TileId, TileEvidence)>> {
        match self.vet(upload) {
            Vetted::Agrees(offsets) | Vetted::New(offsets) => Some(self.folded.fold(upload, &offsets)),
            Vetted::Quarantined { .. } => None,
        }
    }

    /// The map with all its evidence, published or not.
    pub fn whole(&self, key: MapKey) -> RadarMap {
        RadarMap::of_tiles(key, self.zone, self.folded.tiles.clone())
    }

    /// What is served of a tile, without decay.
    pub fn served_tile(&self, id: TileId, least: u8) -> Option<Tile> {
        self.folded.tiles.get(&id).map(|tile| tile.published(least, None, &Decay::default()))
    }

    /// The tiles that are served: cells with the support of `least` contributors, decayed to `today`, a day counted from the
    /// Unix epoch.
    pub fn published(&self, least: u8, today: Option<u16>) -> BTreeMap<TileId, Tile> {
        let decay = Decay::default();
        let served = |(id, tile): (&TileId, &Tile)| (*id, tile.published(least, today, &decay));
        self.folded.tiles.iter().map(served).filter(|(_, tile)| !tile.is_empty()).collect()
    }
}

impl FoldedMap {
    fn fold(&mut self, upload: &VehicleUpload, offsets: &Offsets) -> Vec<(TileId, TileEvidence)> {
        let mut folded = Vec::new();
        let evidence: Vec<_> = upload.delta.tiles.iter().map(|(id, evidence)| (*id, evidence)).collect();
        for (id, evidence, offset) in moved_evidence(&evidence, offsets) {
            let ledger = self.ledgers.entry(id).or_default();
            self.tiles.entry(id).or_default().fold_moved(
                ledger,
                upload.pass,
                &evidence,
                offset,
                upload.sigma,
            );
            for near in id.with_neighbours() {
                self.prepared.get_mut().unwrap_or_else(PoisonError::into_inner).remove(&near);
            }
            folded.push((id, evidence));
        }
        folded
    }
}

/// The map without the tiles to which only the upload's own contributor has contributed.
struct OthersEvidence<'a> {
    folded: &'a FoldedMap,
    contributor: u64,
}

impl MapSide for OthersEvidence<'_> {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        let FoldedMap { tiles, ledgers, prepared } = self.folded;
        let prepare = || Arc::new(TileWeights::packed(id, |at| tiles.get(&at)));
        let others = has_other_contributors(tiles.get(&id)?, ledgers.get(&id)?, self.contributor);
        let mut prepared = prepared.lock().unwrap_or_else(PoisonError::into_inner);
        others.then(|| Arc::clone(prepared.entry(id).or_insert_with(prepare)))
    }

    fn datum(&self, id: TileId) -> Datum {
        self.folded.tiles.get(&id).map(Tile::datum).unwrap_or_default()
    }
}
