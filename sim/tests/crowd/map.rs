//! A map as the service makes it: uploads are vetted, moved onto the map and folded.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

use echofix_core::align::weights::TileWeights;
use echofix_core::datum::{Datum, PoseSigma};
use echofix_core::drive::Drive;
use echofix_core::evidence::build::{Chunk, EvidenceLimits, RawUpload, build_evidence};
use echofix_core::evidence::{EvidenceDelta, Pass};
use echofix_core::geo::TileId;
use echofix_core::tile::{Ledger, Tile};
use echofix_core::vetting::{MapSide, Vetted, Vetter, VettingLimits, has_other_contributors, moved_evidence};

/// Poses of an upload: ten seconds of them.
const POSES: usize = 200;

/// What a contributor sends.
pub struct Upload {
    pub contributor: u64,
    pub delta: EvidenceDelta,
    pub sigma: PoseSigma,
}

/// The uploads of a drive.
pub fn uploads(drive: &Drive, contributor: u64) -> Vec<Upload> {
    let mut uploads = Vec::new();
    for poses in drive.reference.chunks(POSES) {
        let at = |time_us: i64| drive.scans.partition_point(|scan| scan.time_us < time_us);
        let scans = drive.scans[at(poses[0].time_us)..at(poses[poses.len() - 1].time_us)].to_vec();
        let chunk = Chunk { poses: poses.to_vec(), scans };
        let raw = RawUpload { mounts: drive.mounts.clone(), chunks: vec![chunk] };
        // A part in which the vehicle stands has nothing to map.
        if let Ok(built) = build_evidence(raw, &EvidenceLimits::default()) {
            uploads.push(Upload { contributor, delta: built.delta, sigma: built.sigma });
        }
    }
    uploads
}

/// The map of some contributors.
#[derive(Default)]
pub struct CrowdMap {
    tiles: BTreeMap<TileId, (Tile, Ledger)>,
    prepared: RefCell<BTreeMap<TileId, Arc<TileWeights>>>,
}

impl CrowdMap {
    /// Vets an upload and folds it, unless it is quarantined.
    pub fn offer(&mut self, upload: &Upload) -> Vetted {
        let vetted = self.vetted(upload);
        let shares: Vec<_> = upload.delta.tiles.iter().map(|(id, evidence)| (*id, evidence)).collect();
        if let Vetted::Agrees(offsets) | Vetted::New(offsets) = &vetted {
            let pass = Pass { day: 20_000, contributor: upload.contributor };
            for (id, evidence, offset) in moved_evidence(&shares, offsets) {
                let (tile, ledger) = self.tiles.entry(id).or_default();
                tile.fold_moved(ledger, pass, &evidence, offset, upload.sigma);
                for near in id.with_neighbours() {
                    self.prepared.get_mut().remove(&near);
                }
            }
        }
        vetted
    }

    /// What vetting makes of an upload.
    pub fn vetted(&self, upload: &Upload) -> Vetted {
        let cells: Vec<_> = upload.delta.tiles.iter().map(|(id, e)| (*id, &e.cells[..])).collect();
        let others = Others { map: self, contributor: upload.contributor };
        Vetter::default().vet(&cells, &others, &VettingLimits::default(), Some(upload.sigma))
    }

    /// A tile, ready to be aligned against.
    pub fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        self.tiles.get(&id)?;
        let prepare = || Arc::new(TileWeights::new(id, |at| self.tiles.get(&at).map(|(tile, _)| tile)));
        Some(Arc::clone(self.prepared.borrow_mut().entry(id).or_insert_with(prepare)))
    }
}

/// The map as a contributor's upload is compared with it.
struct Others<'a> {
    map: &'a CrowdMap,
    contributor: u64,
}

impl MapSide for Others<'_> {
    fn weights(&self, id: TileId) -> Option<Arc<TileWeights>> {
        let (tile, ledger) = self.map.tiles.get(&id)?;
        has_other_contributors(tile, ledger, self.contributor).then(|| self.map.weights(id)).flatten()
    }

    fn datum(&self, id: TileId) -> Datum {
        self.map.tiles.get(&id).map(|(tile, _)| tile.datum()).unwrap_or_default()
    }
}
