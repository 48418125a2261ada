//! What a map cell knows, and how a detection changes it.

use std::collections::BTreeMap;

use crate::batch::{self, Dropped};
use crate::geo::{CELL_M, CELLS_PER_TILE, CellIndex, TileId, Zone};
use crate::odometry::Trajectory;
use crate::scan::{Gate, Mount, Scan};

/// The paper's pessimistic inverse sensor model (Sec. "A Pessimistic Inverse Sensor Model"): a
/// return raises a cell, nothing lowers one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InverseSensorModel {
    /// p(O): belief in a cell before any measurement, and after a scan that did not hit it.
    pub prior: f64,
    /// p^A(O | z): belief in a cell, given only a scan that hit it.
    pub hit: f64,
}

impl Default for InverseSensorModel {
    fn default() -> Self {
        Self { prior: 0.1, hit: 0.2 }
    }
}

impl InverseSensorModel {
    /// Log odds of a cell after one more scan that hit it (eq. binary-bayes).
    #[must_use]
    pub fn update(&self, log_odds_before: f64) -> f64 {
        log_odds(self.hit) - log_odds(self.prior) + log_odds_before
    }

    /// `p(O | z_1:k)` of a cell hit by `hits` scans: eq. binary-bayes, `hits` times, from the prior.
    #[must_use]
    pub fn occupancy(&self, hits: u32) -> f64 {
        let gain = self.update(0.0);
        probability(log_odds(self.prior) + f64::from(hits) * gain)
    }

    /// Evidence to correlate: occupancy with the prior subtracted, 0 where nothing is known.
    ///
    /// Correlating p itself turns the zero-padded box of the window into a bump that locks the
    /// peak to zero shift.
    #[must_use]
    pub fn evidence(&self, hits: u32) -> f64 {
        self.occupancy(hits) - self.prior
    }
}

/// eq. log-odds
fn log_odds(p: f64) -> f64 {
    (p / (1.0 - p)).ln()
}

/// The inverse of eq. log-odds.
fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Sub-cell steps along a cell's side: offsets are kept to 10 cm / 256.
pub const OFFSET_STEPS: u32 = 256;

/// What a map cell knows. Folding is commutative: the same contributions give the same cell in
/// whatever order they come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cell {
    /// Detections in the cell.
    pub hits: u32,
    /// Passes that hit it: one contributor on one day counts once, however often it hit.
    pub passes: u32,
    /// First UTC day it was hit, counted from the Unix epoch.
    pub first_day: u16,
    /// Last UTC day it was hit.
    pub last_day: u16,
    /// Sum over the hits of the offset from the cell's corner, [`OFFSET_STEPS`] to a side (x, y).
    pub offset_sum: [u32; 2],
}

impl Cell {
    /// Mean place of the hits within the cell, 0 to 1 along each side.
    #[must_use]
    pub fn centroid(&self) -> [f64; 2] {
        let mean = |sum: u32| (f64::from(sum) / f64::from(self.hits.max(1)) + 0.5) / f64::from(OFFSET_STEPS);
        self.offset_sum.map(mean)
    }
}

/// One contributor on one day. The contributor is a keyed hash; the key stays with the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pass {
    /// UTC day, counted from the Unix epoch.
    pub day: u16,
    /// Keyed hash of the contributor's pseudonym.
    pub contributor: u64,
}

/// An upload's hits in one cell of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CellHits {
    /// Row-major index in the tile: y * 512 + x, from the south-west corner.
    pub index: u32,
    /// Detections.
    pub hits: u32,
    /// Sum of their offsets, see [`Cell::offset_sum`].
    pub offset_sum: [u32; 2],
}

/// What one upload tells the map: hits by tile and cell, each tile's cells in order of their index.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Contribution {
    /// Cells by tile.
    pub tiles: BTreeMap<TileId, Vec<CellHits>>,
    /// Detections that count, in the zone the positions belong to.
    pub detections: u64,
}

/// Gathers hits of one zone, detection by detection.
#[derive(Debug, Default)]
struct Gatherer {
    tiles: BTreeMap<TileId, BTreeMap<u32, CellHits>>,
}

impl Gatherer {
    fn add(&mut self, zone: Zone, point: [f64; 2]) {
        let cell = CellIndex::of(point);
        let tile = TileId::of_cell(zone, cell);
        let first = tile.first_cell();
        let index = (cell.y - first.y) as u32 * CELLS_PER_TILE as u32 + (cell.x - first.x) as u32;
        let steps = |value: f64, cell: i64| {
            let fraction = value / CELL_M - cell as f64;
            ((fraction * f64::from(OFFSET_STEPS)) as u32).min(OFFSET_STEPS - 1)
        };
        let entry = self.tiles.entry(tile).or_default().entry(index).or_insert(CellHits {
            index,
            hits: 0,
            offset_sum: [0, 0],
        });
        entry.hits += 1;
        entry.offset_sum[0] += steps(point[0], cell.x);
        entry.offset_sum[1] += steps(point[1], cell.y);
    }
}

/// Places scans on the map of one zone: `poses` are body poses on the zone's grid and `scale` its
/// point scale factor there.
///
/// # Errors
/// When a scan names an unknown sensor.
pub fn contribute(
    zone: Zone,
    scans: &[Scan],
    mounts: &[Mount],
    poses: &Trajectory,
    scale: f64,
    gate: &Gate,
) -> Result<(Contribution, Dropped), batch::Error> {
    let mut gatherer = Gatherer::default();
    let mut detections = 0;
    let dropped = batch::for_each_kept(scans, mounts, poses, gate, scale, |_, point| {
        gatherer.add(zone, point);
        detections += 1;
    })?;
    let tiles = gatherer.tiles.into_iter().map(|(id, cells)| (id, cells.into_values().collect())).collect();
    Ok((Contribution { tiles, detections }, dropped))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::Pose2;
    use proptest::prelude::*;

    #[test]
    fn one_hit_is_the_papers_p_a_and_each_hit_adds_0_811() {
        let model = InverseSensorModel::default();
        assert!((model.occupancy(0) - 0.1).abs() < 1e-12);
        assert!((model.occupancy(1) - 0.2).abs() < 1e-12);
        assert!((model.update(0.0) - 0.811).abs() < 1e-3);
        // By hand: log odds of 0.1 is -2.197; three hits add 2.433; 1 / (1 + e^-0.236) = 0.5586.
        assert!((model.occupancy(3) - 0.5586).abs() < 1e-3);
        assert!(model.evidence(0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn evidence_grows_with_hits_and_stays_below_one(hits in 0..200_u32) {
            let model = InverseSensorModel::default();
            prop_assert!(model.evidence(hits + 1) >= model.evidence(hits));
            prop_assert!(model.evidence(hits) < 0.9 + 1e-12);
        }

        #[test]
        fn every_detection_lands_in_the_cell_below_it(
            x in 600_000.0..600_200.0_f64, y in 3_300_000.0..3_300_200.0_f64,
        ) {
            let zone = Zone::from_epsg(32614).unwrap();
            let mut gatherer = Gatherer::default();
            gatherer.add(zone, [x, y]);
            let (id, cells) = gatherer.tiles.iter().next().unwrap();
            let hit = cells.values().next().unwrap();
            let [x0, y0] = id.origin();
            let cell = Cell { hits: 1, offset_sum: hit.offset_sum, ..Cell::default() };
            let [fx, fy] = cell.centroid();
            let (cx, cy) = (hit.index % 512, hit.index / 512);
            prop_assert!((x0 + (f64::from(cx) + fx) * CELL_M - x).abs() < CELL_M / 256.0 + 1e-6);
            prop_assert!((y0 + (f64::from(cy) + fy) * CELL_M - y).abs() < CELL_M / 256.0 + 1e-6);
        }
    }

    #[test]
    fn scans_become_cells_with_the_grids_scale_applied() {
        let zone = Zone::from_epsg(32614).unwrap();
        let poses = Trajectory::new(
            (0..3).map(|i| (i * 100_000, Pose2::new(600_000.0 + i as f64, 3_300_000.0, 0.0))),
        )
        .unwrap();
        let scan = Scan {
            time_us: 100_000,
            range_m: vec![40.0, 40.0, 80.0],
            azimuth_rad: vec![0.0; 3],
            ..Scan::default()
        };
        let mounts = [Mount::IDENTITY];
        let place = |scale| {
            contribute(zone, std::slice::from_ref(&scan), &mounts, &poses, scale, &Gate::default()).unwrap()
        };
        let (contribution, dropped) = place(0.9996);
        assert_eq!((contribution.detections, dropped.too_far), (2, 1));
        let (id, cells) = contribution.tiles.first_key_value().unwrap();
        assert_eq!((cells.len(), cells[0].hits), (1, 2));
        // 600001 + 40 * 0.9996 = 600040.984
        let x = id.origin()[0] + f64::from(cells[0].index % 512) * CELL_M;
        assert!((x - 600_040.9).abs() < 1e-6, "{x}");
    }
}
